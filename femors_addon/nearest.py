# SPDX-License-Identifier: GPL-3.0-or-later
"""Closest point on a triangulated surface: exact, certified, and signed."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from .mesh import Float, Int, Surface, unit
from .progress import Progress, silent

FIRST_NEIGHBOURS = 6
BLOCK_PAIRS = 250_000  # point-triangle pairs at a time: about 50 MB of temporaries


@dataclasses.dataclass(frozen=True, eq=False)
class Closest:
    """Closest points on a surface.

    Attributes
    ----------
    distance : (p,) float64
        Unsigned distance, in the unit of the coordinates.
    point : (p, 3) float64
        Closest point of the surface.
    face : (p,) int32
        A face that holds it.
    barycentric : (p, 3) float64
        Its weights at the face's corners, in [0, 1], summing to one.
    """

    distance: Float
    point: Float
    face: Int
    barycentric: Float


class SurfaceIndex:
    """Search structure over the faces of a surface, built once and asked often.

    Faces are kept in one KD-tree of centroids per octave of size, so that one large face does not
    loosen the bound of a million small ones. A candidate is certain once no face whose centroid has
    not been seen can reach closer: its distance is at least that of the last centroid seen, less the
    largest radius of its class.
    """

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        centroid = surface.corners.mean(axis=1)
        radius = np.linalg.norm(surface.corners - centroid[:, None], axis=2).max(axis=1)
        smallest = max(float(np.median(radius)), np.finfo(float).tiny)
        octave = np.maximum(np.ceil(np.log2(np.maximum(radius, smallest) / smallest)), 0).astype(int)
        self._classes: list[tuple[cKDTree, Int, float]] = []
        for level in np.unique(octave):
            members = np.flatnonzero(octave == level).astype(np.int32)
            tree = cKDTree(centroid[members], balanced_tree=False)
            self._classes.append((tree, members, float(radius[members].max())))

    def closest(self, points: ArrayLike, progress: Progress = silent) -> Closest:
        """Return the exact closest points to points (p, 3), all finite."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        count = len(points)
        best = np.full(count, np.inf)
        face = np.zeros(count, dtype=np.int32)
        bary = np.zeros((count, 3))
        for tree, members, radius in self._classes:
            self._search(points, tree, members, radius, (best, face, bary), progress)
        corners = self.surface.corners[face]
        return Closest(np.sqrt(best), np.einsum("pk,pkc->pc", bary, corners), face, bary)

    def _search(
        self,
        points: Float,
        tree: cKDTree,
        members: Int,
        radius: float,
        found: tuple[Float, Int, Float],
        progress: Progress,
    ) -> None:
        """Improve `found` (squared distance, face, barycentric) by the faces of one size class."""
        best, face, bary = found
        open_points, seen = np.arange(len(points)), 0
        k = min(FIRST_NEIGHBOURS, len(members))
        while len(open_points):
            still = []
            for block in blocks(open_points, max(BLOCK_PAIRS // k, 1)):
                progress(1.0 - len(open_points) / max(len(points), 1), "closest points")
                far, order = tree.query(points[block], k=k)
                far, order = far.reshape(len(block), k), order.reshape(len(block), k)
                reach = np.sqrt(best[block])
                # a class whose nearest centroid is out of reach cannot improve anything
                worth = far[:, seen] - radius <= reach
                rows = np.flatnonzero(worth)
                ids = members[order[rows, seen:]]
                pick, column = np.nonzero(far[rows, seen:] - radius <= reach[rows, None])
                self._improve(points, block[rows[pick]], ids[pick, column], best, face, bary)
                done = ~worth | (far[:, -1] - radius > np.sqrt(best[block]))
                still.append(block[~done])
            if k == len(members):
                return
            open_points, seen = np.concatenate(still), k
            k = min(4 * k, len(members))

    def _improve(self, points: Float, row: Int, ids: Int, best: Float, face: Int, bary: Float) -> None:
        """Try the pairs (point row[i], face ids[i]), rows ascending; keep what is closer."""
        if not len(row):
            return
        a, b, c = (self.surface.vertices[self.surface.faces[ids, i]] for i in range(3))
        weights = closest_barycentric(points[row], a, b, c)
        delta = weights[:, :1] * a + weights[:, 1:2] * b + weights[:, 2:] * c - points[row]
        distance = np.einsum("ij,ij->i", delta, delta)
        start = np.flatnonzero(np.concatenate(([True], row[1:] != row[:-1])))
        lowest = np.minimum.reduceat(distance, start)
        group = np.cumsum(np.concatenate(([0], row[1:] != row[:-1])))
        hit = np.flatnonzero(distance == lowest[group])
        winner = hit[np.unique(group[hit], return_index=True)[1]]
        winner = winner[distance[winner] < best[row[winner]]]
        best[row[winner]], face[row[winner]], bary[row[winner]] = distance[winner], ids[winner], weights[winner]

    # --- sign ---------------------------------------------------------------------------------
    def signed(self, points: ArrayLike, progress: Progress = silent) -> Float:
        """Return signed distances (p,), negative inside an outward-oriented surface."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        found = self.closest(points, progress)
        normal = self.pseudonormals(found)
        side = np.einsum("ij,ij->i", points - found.point, normal)
        return np.where(side < 0, -found.distance, found.distance)

    def pseudonormals(self, found: Closest) -> Float:
        """Return the outward pseudonormal (p, 3) at each closest point.

        Baerentzen & Aanaes (2005): the face's normal inside a face, the sum of two on an edge, the
        angle-weighted sum at a vertex; the sign it gives is right wherever the surface is closed.
        """
        surface, zero = self.surface, found.barycentric <= 1e-12
        normal = surface.face_normals[found.face].copy()
        on_edge = np.flatnonzero(zero.sum(axis=1) == 1)
        if len(on_edge):
            side = (np.argmax(zero[on_edge], axis=1) + 1) % 3  # the half-edge opposite the zero weight
            normal[on_edge] = self._edge_normals[found.face[on_edge], side]
        on_vertex = np.flatnonzero(zero.sum(axis=1) == 2)
        if len(on_vertex):
            corner = np.argmin(zero[on_vertex], axis=1)
            normal[on_vertex] = self._angle_normals[surface.faces[found.face[on_vertex], corner]]
        return normal

    @cached_property
    def _edge_normals(self) -> Float:
        """(m, 3, 3): for the half-edge from corner j to j + 1 of each face, the sum of the normals there."""
        surface = self.surface
        half = np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
        _, edge = np.unique(half[:, 0] * len(surface.vertices) + half[:, 1], return_inverse=True)
        edge = edge.ravel()
        repeated = np.repeat(surface.face_normals, 3, axis=0)
        total = np.column_stack([np.bincount(edge, repeated[:, axis]) for axis in range(3)])
        return unit(total)[edge].reshape(-1, 3, 3)

    @cached_property
    def _angle_normals(self) -> Float:
        """(n, 3) angle-weighted vertex normals."""
        surface = self.surface
        total = np.zeros_like(surface.vertices)
        for i in range(3):
            here = surface.corners[:, i]
            one, two = unit(surface.corners[:, i - 2] - here), unit(surface.corners[:, i - 1] - here)
            angle = np.arccos(np.clip(np.einsum("ij,ij->i", one, two), -1.0, 1.0))
            weighted = surface.face_normals * angle[:, None]
            for axis in range(3):
                total[:, axis] += np.bincount(surface.faces[:, i], weighted[:, axis], minlength=len(total))
        return unit(total)


def blocks(indices: Int, size: int) -> list[Int]:
    """Cut an index array into consecutive parts of at most `size`."""
    return [indices[start : start + size] for start in range(0, len(indices), size)]


def closest_barycentric(p: Float, a: Float, b: Float, c: Float) -> Float:
    """Barycentric weights (q, 3) of the closest point to p on triangles (a, b, c), each (q, 3).

    By Voronoi regions of vertices, edges and face: Ericson, Real-Time Collision Detection (2005),
    section 5.1.5; his symbols are kept. Degenerate triangles give a point of their longest edge.
    """
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    ab2, ac2, abac = _dot(ab, ab), _dot(ac, ac), _dot(ab, ac)
    d3, d4 = d1 - ab2, d2 - abac
    d5, d6 = d1 - abac, d2 - ac2
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    total = va + vb + vc
    with np.errstate(divide="ignore", invalid="ignore"):
        v, w = vb / total, vc / total
        inner = (va > 0) & (vb > 0) & (vc > 0)
        out = np.where(inner[:, None], np.column_stack((1.0 - v - w, v, w)), 0.0)
    outer = np.flatnonzero(~inner)
    if len(outer):
        out[outer] = _on_border(ap[outer], ab[outer], ac[outer])
    return out


def _on_border(ap: Float, ab: Float, ac: Float) -> Float:
    """Weights of the closest point on a triangle's three edges, positions relative to corner a."""
    best = np.full(len(ap), np.inf)
    out = np.zeros((len(ap), 3))
    origin = np.zeros_like(ab)
    for start, along, i, j in ((origin, ab, 0, 1), (ab, ac - ab, 1, 2), (ac, -ac, 2, 0)):
        length = _dot(along, along)
        t = np.divide(_dot(ap - start, along), length, out=np.zeros(len(ap)), where=length > 0)
        t = np.clip(t, 0.0, 1.0)
        delta = start + t[:, None] * along - ap
        distance = _dot(delta, delta)
        rows = np.flatnonzero(distance < best)
        best[rows] = distance[rows]
        out[rows] = 0.0
        out[rows, i], out[rows, j] = 1.0 - t[rows], t[rows]
    return out


def _dot(a: Float, b: Float) -> Float:
    return np.einsum("ij,ij->i", a, b)
