# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions of a source, as weights of its vertices, on a target's own mesh.

Each vertex of the target takes the weight of the carried source's surface where it is closest. Where the
target's vertices are too sparse for that (a region that lies between them has none), each instead
takes its share of the region, so that the weighted area is the same.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from .limits import require_nodes
from .mesh import Float, Surface
from .nearest import SurfaceIndex
from .progress import FemorsError, Progress, part, silent

MEMORY_LEAST, MEMORY_NODE = 5e6, 600.0  # bytes: what this was measured to take, and per node of both
APART = 0.02  # of the size: a vertex of the target that is farther from the carried source gets nothing
BESIDE = 0.1  # of the size: so far a region's points may be from the face that they are handed to
LOST = 0.02  # share of its area by which a region may change before its shares are handed out
FINEST = 12  # parts that an edge of the source is cut into, at most


@dataclasses.dataclass(frozen=True, eq=False)
class Region:
    """A region on a target.

    Attributes
    ----------
    weights : (m,) float64
        Of the target's vertices, 0 to 1.
    area, goal : float
        Weighted area on the target, and of the region carried as a mesh.
    centroid_error : float
        Distance between the weighted centroids of the two.
    """

    weights: Float
    area: float
    goal: float
    centroid_error: float

    @property
    def area_error(self) -> float:
        """Relative error of the area; NaN where the region has none."""
        return self.area / self.goal - 1.0 if self.goal > 0 else np.nan


class RegionMap:
    """The way of regions from a carried source to a target, worked out once for all of them.

    Parameters
    ----------
    carried : Surface
        The source's own mesh (n vertices), where the field has carried it.
    target : Surface
        The target's own mesh (m vertices); one without a face gets no weight.
    """

    def __init__(self, carried: Surface, target: Surface, progress: Progress = silent) -> None:
        nodes = len(carried.vertices) + len(target.vertices)
        require_nodes(nodes, "carrying regions", MEMORY_LEAST, MEMORY_NODE)
        self.carried, self.target = carried, target
        self._index = SurfaceIndex(target)
        used = np.unique(target.faces)
        found = SurfaceIndex(carried).closest(target.vertices[used], progress)
        near = found.distance <= APART * carried.diagonal
        self._rows, self._corners = used[near], carried.faces[found.face[near]]
        self._bary = found.barycentric[near]
        self._lumped = _lumped(target)

    def region(self, weights: Float, progress: Progress = silent) -> Region:
        """Return a region given by weights (n,) of the source's vertices, from 0 to 1.

        Raises
        ------
        FemorsError
            Not as many weights as vertices, or none above 0.
        """
        weights = np.asarray(weights, dtype=np.float64)
        if weights.shape != (len(self.carried.vertices),):
            raise FemorsError(f"{len(weights)} weights for {len(self.carried.vertices)} vertices")
        if not (weights > 0).any():
            raise FemorsError("has no vertex with a weight")
        goal, centre = _moments(self.carried, weights)
        direct = np.zeros(len(self.target.vertices))
        direct[self._rows] = np.einsum("pk,pk->p", weights[self._corners], self._bary)
        direct[direct < 1e-9] = 0.0
        best = self._measured(direct, goal, centre)
        if goal > 0 and not abs(best.area_error) <= LOST:
            shared = self._measured(self._shares(weights, part(progress, 0.0, 1.0)), goal, centre)
            if abs(shared.area_error) < abs(best.area_error) or not direct.any():
                best = shared
        if not best.weights.any():  # no area of its own: a line of vertices, or beside the target
            heavy = np.flatnonzero(weights > 0)
            near = self._index.closest(self.carried.vertices[heavy])
            corner = self.target.faces[near.face, np.argmax(near.barycentric, axis=1)]
            alone = np.zeros(len(self.target.vertices))
            np.maximum.at(alone, corner, weights[heavy])
            best = self._measured(alone, goal, centre)
        return best

    def _measured(self, weights: Float, goal: float, centre: Float) -> Region:
        area, there = _moments(self.target, weights)
        error = float(np.linalg.norm(there - centre)) if area > 0 and goal > 0 else np.nan
        return Region(weights, area, goal, error)

    def _shares(self, weights: Float, progress: Progress) -> Float:
        """Hand out the region, point by point of a fine sampling, to the corners of the face it lies on."""
        surface = self.carried
        faces = np.flatnonzero((weights[surface.faces] > 0).any(axis=1))
        fine = int(np.ceil(3.0 * surface.mean_edge / max(self.target.mean_edge, 1e-300)))
        bary = _sampling(min(max(fine, 2), FINEST))
        corners = surface.vertices.take(surface.faces[faces], axis=0)
        points = np.einsum("sk,fkc->fsc", bary, corners).reshape(-1, 3)
        value = (weights[surface.faces[faces]] @ bary.T).ravel()
        mass = value * np.repeat(surface.face_areas[faces] / len(bary), len(bary))
        found = self._index.closest(points, progress)
        near = found.distance <= BESIDE * surface.diagonal
        total = np.bincount(
            self.target.faces[found.face[near]].ravel(),
            (mass[near, None] * found.barycentric[near]).ravel(),
            len(self.target.vertices),
        )
        return np.clip(total / np.where(self._lumped > 0, self._lumped, np.inf), 0.0, weights.max())


def _lumped(surface: Surface) -> Float:
    """Area that belongs to each vertex (n,)."""
    shares = np.repeat(surface.face_areas / 3.0, 3)
    return np.asarray(np.bincount(surface.faces.ravel(), shares, len(surface.vertices)), dtype=np.float64)


def _moments(surface: Surface, weights: Float) -> tuple[float, Float]:
    """Return the integral of the weights over the surface, and their centroid."""
    at = weights[surface.faces]
    area = surface.face_areas * at.mean(axis=1)
    total = float(area.sum())
    # of a linear weight over a triangle, exactly: corner i counts (2 w_i + w_j + w_k) / 12
    share = surface.face_areas[:, None] * (at + at.sum(axis=1, keepdims=True)) / 12.0
    centre = np.einsum("fk,fkc->c", share, surface.corners)
    return total, centre / total if total > 0 else np.full(3, np.nan)


def _sampling(count: int) -> Float:
    """Centroids (count^2, 3), barycentric, of a triangle cut into as many equal ones."""
    out = []
    for i in range(count):
        for j in range(count - i):
            out.append((i + 1 / 3, j + 1 / 3))
            if j < count - i - 1:
                out.append((i + 2 / 3, j + 2 / 3))
    points = np.array(out) / count
    return np.column_stack((points, 1.0 - points.sum(axis=1)))
