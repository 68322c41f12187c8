# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals that stand in a mesh file, carried along when the file's vertices move."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .mesh import Float, Int, triangulate
from .triples import unit


def carried(
    normals: Float, owner: NDArray[np.integer], before: Float, after: Float, sizes: Int, corners: Int
) -> Float:
    """Return normals for moved vertices: the mean of the polygons that use each, on the side it was on.

    Parameters
    ----------
    normals : (k, 3) float64
        As given for the positions `before`.
    owner : (c,) int
        For each polygon corner the normal that it uses, or -1.
    before, after : (n, 3) float64
        Vertex positions.
    sizes, corners : (p,), (c,) int
        The polygons.

    Returns
    -------
    (k, 3) float64
        Unit normals; those that no polygon with an area uses are returned as given.
    """
    old = unit(_sums(before, owner, len(normals), sizes, corners))
    new = unit(_sums(after, owner, len(normals), sizes, corners))
    side = np.sign(np.einsum("ij,ij->i", old, normals))
    known = (np.abs(side) == 1) & new.any(axis=1)
    return np.where(known[:, None], side[:, None] * new, normals)


def _sums(vertices: Float, owner: NDArray[np.integer], count: int, sizes: Int, corners: Int) -> Float:
    """Sum the area vectors of the polygons at the corners of each owner."""
    triangles, polygon = triangulate(sizes, corners)
    size = np.abs(vertices).max(initial=0.0) or 1.0  # squares of huge or tiny lengths have no room
    a, b, c = np.moveaxis((vertices / size)[triangles], 1, 0)
    cross = np.cross(b - a, c - a)
    polygon_of_corner = np.repeat(np.arange(len(sizes)), sizes)[owner >= 0]
    owner = owner[owner >= 0]
    out = np.empty((count, 3))
    for axis in range(3):
        area = np.bincount(polygon, cross[:, axis], minlength=len(sizes))
        out[:, axis] = np.bincount(owner, area[polygon_of_corner], minlength=count)
    return out
