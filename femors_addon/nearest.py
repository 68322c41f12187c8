# SPDX-License-Identifier: GPL-3.0-or-later
"""Closest point on a triangulated surface: exact, certified, and signed."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from . import triples
from .crew import blockwise, over
from .mesh import Float, Int, Surface
from .progress import Progress, part, silent
from .triangles import Triangles

FIRST_NEIGHBOURS = 6  # vertices
BLOCK_PAIRS = 64_000  # point-triangle pairs at a time: what they need stays in the processor's cache


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

    Faces are found through their corners. Where the closest point q of a face to p lies inside the
    face or an edge, p - q is at right angles to it, so that its nearest corner is no farther than
    sqrt(d^2 + L^2 / 3) with L the face's longest edge, however far p is. Once all vertices within
    that reach have been seen the closest face is certain. Vertices are kept in one KD-tree per octave
    of L, so that one large face does not loosen the bound of a million small ones.
    """

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        corners = surface.corners
        self._triangles = Triangles.of(corners)
        self._faces_at, self._first = surface.corner_order
        count = np.diff(self._first)
        longest = np.zeros(len(surface.vertices))
        side = np.sqrt(triples.longest_squared(corners))
        np.maximum.at(longest, surface.faces.ravel(), np.repeat(side, 3))
        self._slack = longest**2 / 3.0
        used = np.flatnonzero(count)
        base = max(1.6 * float(np.median(longest[used])), 1e-300)
        octave = np.maximum(np.ceil(np.log2(np.maximum(longest[used], base) / base)), 0).astype(int)
        self._classes: list[tuple[cKDTree, Int, float]] = []
        for level in np.unique(octave):
            members = used[octave == level].astype(np.int32)
            tree = cKDTree(surface.vertices[members], balanced_tree=False)
            self._classes.append((tree, members, float(self._slack[members].max())))

    def closest(self, points: ArrayLike, progress: Progress = silent) -> Closest:
        """Return the exact closest points to points (p, 3), all finite."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        count = len(points)
        best = np.full(count, np.inf)
        face = np.zeros(count, dtype=np.int32)
        bary = np.zeros((count, 3))
        share = 1.0 / max(len(self._classes), 1)
        for number, (tree, members, slack) in enumerate(self._classes):
            reporter = part(progress, number * share, (number + 1) * share)
            self._search(points, tree, members, slack, (best, face, bary), reporter)
        point = weighted(self.surface.vertices, self.surface, face, bary)
        return Closest(triples.length(points - point), point, face, bary)

    def _search(
        self,
        points: Float,
        tree: cKDTree,
        members: Int,
        slack: float,
        found: tuple[Float, Int, Float],
        progress: Progress,
    ) -> None:
        """Improve `found` (squared distance, face, barycentric) by the faces at one class of vertices."""
        open_points, seen = np.arange(len(points)), 0
        k = min(FIRST_NEIGHBOURS, len(members))

        def look(block: Int) -> Int:
            return self._look(points, block, tree, members, slack, found, seen, k)

        while len(open_points):
            parts, still = blocks(open_points, max(BLOCK_PAIRS // (6 * k), 1)), []
            for rest in over(look, parts):
                progress(1.0 - len(open_points) / max(len(points), 1), "closest points")
                still.append(rest)
            if k == len(members):
                return
            open_points, seen = np.concatenate(still), k
            k = min(2 * k, len(members))

    def _look(
        self,
        points: Float,
        block: Int,
        tree: cKDTree,
        members: Int,
        slack: float,
        found: tuple[Float, Int, Float],
        seen: int,
        k: int,
    ) -> Int:
        """Try the faces at the k nearest vertices for a block of points; return those still not certain."""
        best = found[0]
        far, order = tree.query(points[block], k=k)
        far, order = far.reshape(len(block), k) ** 2, order.reshape(len(block), k)
        # the nearest vertex bounds what the others must beat
        if not seen:
            first = members[order[:, 0]]
            close = far[:, 0] <= best[block] + self._slack[first]
            self._improve(points, block[close], first[close], None, found)
        if k > 1:
            start = max(seen, 1)
            vertex = members[order[:, start:]]
            close = far[:, start:] <= best[block][:, None] + self._slack[vertex]
            pick = np.nonzero(close)[0]
            # the faces at the nearest vertex have been tried
            self._improve(points, block[pick], vertex[close], members[order[pick, 0]], found)
        rest: Int = block[far[:, -1] <= best[block] + slack]
        return rest

    def _improve(
        self, points: Float, row: Int, vertex: Int, tried: Int | None, found: tuple[Float, Int, Float]
    ) -> None:
        """Try the faces at vertex[i], but for those at tried[i], for point row[i]; rows ascend."""
        best, face, bary = found
        if not len(row):
            return
        count = self._first[vertex + 1] - self._first[vertex]
        total = np.cumsum(count)
        part = total // (4 * BLOCK_PAIRS)
        if part[-1] > part[0]:  # a hub of very many faces
            for one in np.split(np.arange(len(row)), np.flatnonzero(np.diff(part)) + 1):
                self._improve(points, row[one], vertex[one], None if tried is None else tried[one], found)
            return
        offset = np.arange(total[-1]) + np.repeat(self._first[vertex] - total + count, count)
        ids = self._faces_at[offset]
        row = np.repeat(row, count)
        p = points.take(row, axis=0)
        if tried is not None:
            corner, tried = self.surface.faces.take(ids, axis=0), np.repeat(tried, count)
            fresh = (corner[:, 0] != tried) & (corner[:, 1] != tried) & (corner[:, 2] != tried)
            fresh &= self._triangles.within(p, ids, np.sqrt(best[row]))
            row, ids, p = row[fresh], ids[fresh], p[fresh]
            if not len(row):
                return
        distance, v, w = self._triangles.closest(p, ids)
        start = np.flatnonzero(np.concatenate(([True], row[1:] != row[:-1])))
        lowest = np.minimum.reduceat(distance, start)
        hit = np.flatnonzero(distance == np.repeat(lowest, np.diff(start, append=len(row))))
        winner = hit[np.concatenate(([True], row[hit[1:]] != row[hit[:-1]]))]  # the first of equals
        winner = winner[distance[winner] < best[row[winner]]]
        row, v, w = row[winner], v[winner], w[winner]
        best[row], face[row] = distance[winner], ids[winner]
        bary[row] = np.column_stack((1.0 - v - w, v, w))

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
        normal = surface.face_normals[found.face]
        flat = zero[:, 0] | zero[:, 1] | zero[:, 2]
        at = np.flatnonzero(flat)
        count = zero[at].sum(axis=1)
        on_edge, on_vertex = at[count == 1], at[count == 2]
        if len(on_edge):
            side = (np.argmax(zero[on_edge], axis=1) + 1) % 3  # the half-edge opposite the zero weight
            corners = surface.faces[found.face[on_edge]]
            ends = np.take_along_axis(corners, np.column_stack((side, (side + 1) % 3)), axis=1)
            normal[on_edge] = self._edge_normals(ends)
        if len(on_vertex):
            corner = np.argmin(zero[on_vertex], axis=1)
            vertex, which = triples.renumbered(
                surface.faces[found.face[on_vertex], corner], len(surface.vertices)
            )
            normal[on_vertex] = self._angle_normals(vertex)[which]
        return normal

    def _around(self, vertex: Int) -> tuple[Int, Int]:
        """Return ((k,) rows of the vertices (p,), ascending, (k,) the faces at each, ascending)."""
        count = self._first[vertex + 1] - self._first[vertex]
        row = np.repeat(np.arange(len(vertex)), count)
        offset = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        return row, self._faces_at[np.repeat(self._first[vertex], count) + offset]

    def _edge_normals(self, ends: Int) -> Float:
        """Return the normalised sum (p, 3) of the normals of the faces at edges (p, 2)."""
        row, face = self._around(ends[:, 0])
        here = triples.some(self.surface.faces[face] == ends[row, 1:])
        row, normal = row[here], self.surface.face_normals[face[here]]
        return triples.unit(np.column_stack([np.bincount(row, normal[:, i], len(ends)) for i in range(3)]))

    def _angle_normals(self, vertex: Int) -> Float:
        """Return the angle-weighted normals (p, 3) of vertices (p,)."""
        surface, total = self.surface, np.zeros((len(vertex), 3))
        row, face = self._around(vertex)
        for i in range(3):
            mine = surface.faces[face, i] == vertex[row]
            here, at = row[mine], face[mine]
            corners = surface.vertices.take(surface.faces[at], axis=0)
            one, two = (
                triples.unit(corners[:, i - 2] - corners[:, i]),
                triples.unit(corners[:, i - 1] - corners[:, i]),
            )
            angle = np.arccos(np.clip(np.einsum("ij,ij->i", one, two), -1.0, 1.0))
            weighted = surface.face_normals[at] * angle[:, None]
            for axis in range(3):
                total[:, axis] += np.bincount(here, weighted[:, axis], len(vertex))
        return triples.unit(total)


def weighted(values: Float, surface: Surface, face: Int, barycentric: Float) -> Float:
    """Interpolate the vertices' values (n, 3) on faces (p,), the corners weighing (p, 3)."""

    def of(block: slice) -> Float:
        corners = values.take(surface.faces.take(face[block], axis=0), axis=0)
        return np.einsum("pk,pkc->pc", barycentric[block], corners)

    return blockwise(of, len(face))


def blocks(indices: Int, size: int) -> list[Int]:
    """Cut an index array into consecutive parts of at most `size`."""
    return [indices[start : start + size] for start in range(0, len(indices), size)]
