# SPDX-License-Identifier: GPL-3.0-or-later
"""Which points of a regular grid lie in which flat triangles: for pictures, and for volumes by columns."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .mesh import Float, Int

CELLS = 100_000  # grid points tried at a time: temporaries that stay in a processor's cache
SIZES = np.array([1, 2, 3, 4, 6, 8, 12, 16] + [2**k for k in range(5, 31)])
"""Sides of the grids on which triangles of like size are tried together."""


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
    kind = np.searchsorted(SIZES, extent[hit])
    key = kind[:, 0] * 64 + kind[:, 1]
    order = np.argsort(key, kind="stable")
    ends = np.flatnonzero(np.diff(key[order], append=-1)) + 1  # no key is -1
    for alike in np.split(order, ends[:-1]):
        if not len(alike):
            continue  # no triangle is on the grid
        members = hit[alike]
        across, down = (int(SIZES[k]) for k in kind[alike[0]])
        step = max(CELLS // (across * down), 1)
        for start in range(0, len(members), step):
            faces = members[start : start + step]
            yield from _tried(
                corners[faces], area[faces], low[faces], high[faces], faces, across, down, width
            )


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
    """Try triangles (k, 3, 2) on grids of `down` rows from their lower corners `low`.

    A share is twice the area of a point and two corners, a difference of two products. Where a corner has
    part in both factors, the product goes by column or by row alone.
    """
    column = low[:, 0, None, None] + np.arange(across)
    row = low[:, 1, None, None] + np.arange(down)[:, None]
    x, y = column + 0.5, row + 0.5
    ax, ay, bx, by, cx, cy = (corners[:, k, d, None, None] for k in range(3) for d in range(2))
    sign = np.sign(area)[:, None, None]
    one: Float = (sign * (bx - x)) * (cy - y) - (sign * (by - y)) * (cx - x)
    two: Float = (sign * (x - ax)) * (cy - ay) - (sign * (y - ay)) * (cx - ax)
    three: Float = (sign * (bx - ax)) * (y - ay) - (sign * (by - ay)) * (x - ax)
    within = (column <= high[:, 0, None, None]) & (row <= high[:, 1, None, None])
    kept = np.flatnonzero(within & (one >= 0) & (two >= 0) & (three >= 0))
    if not len(kept):
        return
    which, place = np.divmod(kept, across * down)
    dy, dx = np.divmod(place, across)
    shares: Float = np.column_stack((one.ravel()[kept], two.ravel()[kept], three.ravel()[kept]))
    shares /= np.abs(area[which])[:, None]
    yield (low[which, 1] + dy) * width + low[which, 0] + dx, faces[which].astype(np.int32), shares
