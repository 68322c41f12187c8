# SPDX-License-Identifier: GPL-3.0-or-later
"""Which points of a regular grid lie in which flat triangles: for pictures, and for volumes by columns."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .mesh import Float, Int

CELLS = 1_500_000  # grid points tried at a time: about 100 MB of temporaries


def fragments(corners: Float, width: int, height: int) -> Iterator[tuple[Int, Int, Float]]:
    """Yield grid points in triangles: (index row * width + column, triangle, barycentric (k, 3)).

    Parameters
    ----------
    corners : (m, 3, 2) array
        Corners in units of the grid; its points stand at whole numbers and a half.
    width, height : int
        Points in a row, and rows.
    """
    limit = np.array([width, height]) - 1
    low = np.clip(np.ceil(corners.min(axis=1) - 0.5), 0, limit + 1).astype(np.int64)
    high = np.clip(np.floor(corners.max(axis=1) - 0.5), -1, limit).astype(np.int64)
    extent = high - low + 1
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    hit = np.flatnonzero((extent > 0).all(axis=1) & (area != 0))
    # triangles of like size are tried together, on a grid that is large enough for all of them
    octave = np.ceil(np.log2(np.maximum(extent[hit], 1))).astype(np.int64)
    key = octave[:, 0] * 64 + octave[:, 1]
    for value in np.unique(key):
        across, down = 2 ** (value // 64), 2 ** (value % 64)
        members = hit[key == value]
        step = max(int(CELLS // (across * down)), 1)
        for start in range(0, len(members), step):
            yield from _tried(corners, area, low, high, members[start : start + step], across, down, width)


def _tried(
    corners: Float,
    area: Float,
    low: Int,
    high: Int,
    faces: Int,
    across: int,
    down: int,
    width: int,
) -> Iterator[tuple[Int, Int, Float]]:
    dy, dx = np.divmod(np.arange(across * down), across)
    x, y = low[faces, :1] + dx, low[faces, 1:] + dy
    inside = (x <= high[faces, :1]) & (y <= high[faces, 1:])
    row, cell = np.nonzero(inside)
    x, y, face = x[row, cell], y[row, cell], faces[row]
    point = np.column_stack((x, y)) + 0.5
    a, b, c = (corners[face, k] for k in range(3))
    share = np.column_stack((_twice(point, b, c), _twice(a, point, c), _twice(a, b, point)))
    share /= area[face][:, None]
    kept = (share >= 0).all(axis=1)
    if kept.any():
        yield (y * width + x)[kept], face[kept].astype(np.int32), share[kept]


def _twice(a: Float, b: Float, c: Float) -> Float:
    """Twice the signed area of triangles (k, 2)."""
    out: Float = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    return out
