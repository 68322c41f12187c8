# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh numbered along a curve that fills space (Morton 1966): what is near in space is near in memory.

Searches are faster so, a little for most files and by a fifth for one in random order, and as fast for any.
"""

from __future__ import annotations

import numpy as np

from . import triples
from .cleaning import Cleaned
from .mesh import Float, Int, Surface

BITS = 21  # of each axis: three of them fill 63 bits

_SPREAD = (  # shift by, keep: two zero bits come to follow each
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def ordered(cleaned: Cleaned, places: Float) -> tuple[Cleaned, Int]:
    """Number a surface's vertices along the curve, and its faces by their vertices.

    Parameters
    ----------
    cleaned : Cleaned
        Of n vertices.
    places : (n, 3) float64
        Where they are, in whatever pose.

    Returns
    -------
    Cleaned
    (n,) int32
        Which number each of its vertices had before.
    """
    order = along_curve(places)
    place = np.full(len(order) + 1, -1, dtype=np.int32)  # the last for vertices that have none
    place[order] = np.arange(len(order), dtype=np.int32)
    faces = place.take(cleaned.surface.faces)
    rows = np.argsort(triples.least(faces), kind="stable")
    out = Cleaned(
        Surface(cleaned.surface.vertices.take(order, axis=0), faces.take(rows, axis=0)),
        place[cleaned.vertex_map],
        cleaned.face_map[rows],
        cleaned.notes,
    )
    return out, order


def numbered(surface: Surface) -> Surface:
    """Return a surface with its vertices numbered along the curve, and its faces by their vertices."""
    every = np.arange(max(len(surface.vertices), len(surface.faces)), dtype=np.int32)
    same = Cleaned(surface, every[: len(surface.vertices)], every[: len(surface.faces)], ())
    return ordered(same, surface.vertices)[0].surface


def along_curve(points: Float) -> Int:
    """Return the indices (n,) of finite points (n, 3), n > 0, in their order along the curve."""
    low, high = triples.box(points)
    size = float((high - low).max())
    cell = (points - low) * ((2**BITS - 1) / size if size > 0 else 0.0)
    code = np.zeros(len(points), dtype=np.uint64)
    for axis in range(3):
        bits = cell[:, axis].astype(np.uint64)
        for shift, mask in _SPREAD:
            bits |= bits << np.uint64(shift)
            bits &= np.uint64(mask)
        code |= bits << np.uint64(axis)
    return np.argsort(code, kind="stable").astype(np.int32)
