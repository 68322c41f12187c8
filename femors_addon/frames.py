# SPDX-License-Identifier: GPL-3.0-or-later
"""How a surface is deformed at each of its places: gradients, stretch, and a smooth map made of them.

The map is a partition of unity of first-order pieces (Shepard's interpolation with nodal functions,
Franke & Nielson 1980): near a centre y_i it is x_i + F_i (p - y_i), with F_i the deformation gradient
of the surface there, and between centres a weighted mean of these. A point keeps its offset and turns
with the surface; a weighted mean of displacements alone would leave the offset as it was.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.spatial import cKDTree

from .crew import over
from .mesh import Float, Surface
from .progress import Progress, silent

NEIGHBOURS = 96  # centres that a point looks at
THINNING = 1.5  # cells in a spread: how dense the centres of a level are
FEWEST = 48  # centres of the coarsest level
BLOCK = 2048  # points at a time: 20 MB of temporaries


def face_gradients(before: Surface, after: Surface) -> Float:
    """Return (m, 3, 3): in each face's plane its deformation gradient; normals go to normals, unstretched."""
    frames = []
    for surface in (before, after):
        a, b, c = np.moveaxis(surface.corners, 1, 0)
        frames.append(np.stack((b - a, c - a, surface.face_normals), axis=2))
    flat = np.abs(np.linalg.det(frames[0])) <= 1e-12 * before.face_areas.max(initial=1e-300)
    frames[0][flat] = frames[1][flat] = np.eye(3)
    return np.asarray(frames[1] @ np.linalg.inv(frames[0]))


def vertex_gradients(before: Surface, after: Surface) -> Float:
    """Return (n, 3, 3) around each vertex the mean by area of `face_gradients`."""
    faces, count = before.faces, len(before.vertices)
    if not len(faces):
        return np.tile(np.eye(3), (count, 1, 1))
    area = before.face_areas
    parts = (face_gradients(before, after) * area[:, None, None]).reshape(-1, 9)
    weight = np.bincount(faces.ravel(), np.repeat(area, 3), count)
    total = np.column_stack(
        [np.bincount(faces.ravel(), np.repeat(parts[:, k], 3), count) for k in range(9)]
    ).reshape(-1, 3, 3)
    out = total / np.where(weight > 0, weight, 1.0)[:, None, None]
    out[weight <= 0] = np.eye(3)
    return out


def principal_stretches(before: Surface, after: Surface) -> Float:
    """Return (m, 2) the largest and the smallest stretch in each face's plane; NaN where it has no area."""
    corners = before.corners, after.corners
    one, two = (corner[:, 1] - corner[:, 0] for corner in corners)
    side, other = (corner[:, 2] - corner[:, 0] for corner in corners)
    length = np.linalg.norm(one, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        # the face laid flat: its first side along an axis
        along = np.einsum("ij,ij->i", side, one) / length
        across = np.sqrt(np.maximum(np.einsum("ij,ij->i", side, side) - along**2, 0.0))
        first = two / length[:, None]
        second = (other - along[:, None] * first) / across[:, None]
    a, b, c = (np.einsum("ij,ij->i", u, v) for u, v in ((first, first), (first, second), (second, second)))
    middle, half = (a + c) / 2.0, np.sqrt(((a - c) / 2.0) ** 2 + b**2)
    out = np.sqrt(np.maximum(np.column_stack((middle + half, middle - half)), 0.0))
    out[~np.isfinite(out).all(axis=1)] = np.nan
    return out


@dataclasses.dataclass(frozen=True, eq=False)
class _Level:
    """Centres of one spread."""

    spread: float
    centres: Float  # (k, 3)
    images: Float  # (k, 3)
    gradients: Float  # (k, 3, 3)
    weights: Float  # (k,)
    tree: cKDTree


class SmoothMap:
    """A smooth map of space that follows a deformed surface; the farther a point, the smoother.

    Parameters
    ----------
    before, after : Surface
        The same faces at two sets of positions; without faces, the pieces are translations.
    spread : float
        Distance at which a centre's weight beside the nearest one's is a half, at the surface.
    """

    def __init__(self, before: Surface, after: Surface, spread: float) -> None:
        centres, images = before.vertices, after.vertices
        gradients, weights = vertex_gradients(before, after), np.ones(len(centres))
        self.levels = [_Level(spread, centres, images, gradients, weights, cKDTree(centres))]
        area = np.ones(len(centres))
        if len(before.faces):
            area = np.bincount(before.faces.ravel(), np.repeat(before.face_areas, 3), len(centres)) + 1e-300
        while len(self.levels[-1].centres) > FEWEST:
            spread *= 2.0
            self.levels.append(_thinned(centres, images, gradients, area, spread))

    def __call__(self, points: Float, distance: Float, share: float, progress: Progress = silent) -> Float:
        """Return where points (p, 3) go.

        Parameters
        ----------
        distance : (p,)
            Of each point from the surface.
        share : float
            Of the distance that the spread measures, where that is more than the spread at the surface.
        """
        out = np.empty_like(points)
        level = np.log2(np.maximum(share * distance / self.levels[0].spread, 1.0))
        level = np.minimum(level, len(self.levels) - 1)

        def carry(start: int) -> int:
            rows = slice(start, start + BLOCK)
            out[rows] = self._block(points[rows], level[rows])
            return start

        for start in over(carry, range(0, len(points), BLOCK)):
            progress(start / max(len(points), 1), "carrying points")
        return out

    def _block(self, points: Float, level: Float) -> Float:
        """Mix the two levels around each point's own, so that the map has no steps."""
        out = np.zeros_like(points)
        low = np.minimum(level.astype(int), max(len(self.levels) - 2, 0))
        for number in np.unique(low):
            rows = np.flatnonzero(low == number)
            rest = level[rows] - number
            out[rows] += (1.0 - rest)[:, None] * _mean(self.levels[number], points[rows])
            upper = rest > 0
            if upper.any():
                out[rows[upper]] += rest[upper, None] * _mean(self.levels[number + 1], points[rows[upper]])
        return out


def _thinned(centres: Float, images: Float, gradients: Float, area: Float, spread: float) -> _Level:
    """One centre for all in a cell: their mean by area."""
    cell = np.floor((centres - centres.min(axis=0)) * (THINNING / spread)).astype(np.int64)
    _, group = np.unique(cell, axis=0, return_inverse=True)
    group = group.ravel()
    total = np.bincount(group, area)

    def mean(values: Float) -> Float:
        flat = values.reshape(len(values), -1)
        sums = [np.bincount(group, area * flat[:, k]) / total for k in range(flat.shape[1])]
        return np.column_stack(sums).reshape(-1, *values.shape[1:])

    # the pieces' mean at the mean centre, to first order
    where = mean(centres)
    shifted = images + np.einsum("nij,nj->ni", gradients, where[group] - centres)
    return _Level(spread, where, mean(shifted), mean(gradients), total / total.max(), cKDTree(where))


def _mean(level: _Level, points: Float) -> Float:
    """Weighted mean (p, 3) of the pieces of the nearest centres."""
    k = min(NEIGHBOURS, len(level.centres))
    distance, near = level.tree.query(points, k=k)
    distance, near = distance.reshape(len(points), k), near.reshape(len(points), k)
    square = (distance / level.spread) ** 2
    weights = np.exp(-math.log(2.0) * (square - square[:, :1]))
    if k < len(level.centres):  # what comes into sight next comes with no weight: no steps
        weights = weights - weights[:, -1:]
        weights[:, 0] = np.maximum(weights[:, 0], 1e-12)  # all equally far
    weights *= level.weights[near]
    weights /= weights.sum(axis=1, keepdims=True)
    apart = points[:, None, :] - level.centres[near]
    pieces = level.images[near] + np.einsum("pkij,pkj->pki", level.gradients[near], apart)
    return np.asarray(np.einsum("pk,pki->pi", weights, pieces))


def ramp(value: Float, start: float, stop: float) -> Float:
    """Return 1 below `start`, 0 above `stop`, and a smooth passage between (two derivatives)."""
    t = np.clip((np.asarray(value) - start) / (stop - start), 0.0, 1.0)
    return 1.0 - t**3 * (t * (6.0 * t - 15.0) + 10.0)
