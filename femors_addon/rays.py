# SPDX-License-Identifier: GPL-3.0-or-later
"""Where straight lines first meet a surface."""

from __future__ import annotations

import numpy as np

from . import triples
from .balls import enclosing_balls
from .mesh import Float, Surface

TOGETHER = 2_000_000  # pairs of ray and face looked at together: about 50 MB


def first_hits(start: Float, way: Float, length: float, surface: Surface) -> Float:
    """Return how far (k,) rays go until they meet a face; infinite where that is farther than `length`.

    Parameters
    ----------
    start : (k, 3)
        To miss the face that a ray begins on, let it begin a little off.
    way : (k, 3)
        Unit vectors.
    """
    out = np.full(len(start), np.inf)
    centre, radius = enclosing_balls(surface.corners)
    middle = start.mean(axis=0) if len(start) else np.zeros(3)
    centre -= middle  # squares of large coordinates would leave no digits
    step = max(TOGETHER // max(len(radius), 1), 1)
    for low in range(0, len(start), step):
        rays = slice(low, low + step)
        here = start[rays] - middle
        along = way[rays] @ centre.T - triples.dot(way[rays], here)[:, None]
        apart = triples.squared(here)[:, None] - 2.0 * here @ centre.T + triples.squared(centre)
        reach = radius + 1e-6 * length
        near = (apart - along**2 <= reach**2) & (along >= -reach) & (along <= length + reach)
        row, face = np.nonzero(near)
        t = _met(start[rays][row], length * way[rays][row], surface, face)
        np.minimum.at(out, low + row, t * length)
    return out


def _met(start: Float, along: Float, surface: Surface, face: np.ndarray) -> Float:
    """Return where (p,) on a segment, from 0 to 1, it goes through the face beside it; else infinite."""
    corners = surface.corners[face] - start[:, None]
    normal = surface.face_normals[face]
    here = -triples.dot(corners[:, 0], normal)
    there = here + triples.dot(along, normal)
    # the faces at an edge see the same numbers: nothing slips through between them
    sides = [triples.dot(along, triples.cross(corners[:, i], corners[:, (i + 1) % 3])) for i in range(3)]
    through = (np.minimum.reduce(sides) >= 0) | (np.maximum.reduce(sides) <= 0)
    through &= (here > 0) != (there > 0)
    t = np.full(len(face), np.inf)
    np.divide(here, here - there, out=t, where=through & (here != there))
    return t
