# SPDX-License-Identifier: GPL-3.0-or-later
"""Patches of a mesh around faces that want mending: which nodes they have, and ways to lay them out."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from . import triples
from .balls import Index, enclosing_balls
from .mesh import Float, Int, Surface


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """The part of a mesh that mending can touch, with all that its faces may come to cross.

    Attributes
    ----------
    nodes, faces : (k,), (j,) int32
        Rows in the whole mesh, ascending.
    corners : (j, 3) int32
        Corners of the faces as rows of `nodes`.
    may : (k,) bool
        Nodes that may move.
    whole : (j,) bool
        Faces whose corners have all their faces here, so that folds can be told.
    far : float
        How far a node may go.
    edge : float
        Mean edge of the whole mesh, and
    count : int
        its nodes.
    """

    nodes: Int
    faces: Int
    corners: Int
    may: np.ndarray
    whole: np.ndarray
    far: float
    edge: float
    count: int

    @classmethod
    def around(cls, wanting: Int, moved: Surface, may: np.ndarray, reach: int, far: float) -> Part:
        """The part within `reach` edges of the faces that want mending, whose nodes may go `far`."""
        inside = patch(moved, wanting, reach)
        wide = patch(moved, wanting, reach + 1)
        moving = triples.some((inside & may).take(moved.faces))
        centre, radius = enclosing_balls(moved.corners)
        edge, used = moved.mean_edge, np.flatnonzero(moving)
        near = triples.some(wide.take(moved.faces))
        if len(used):
            # a face may go so far, and grow by twice that
            limit = radius + radius[used].max() + 3.0 * far
            away = cKDTree(centre[used]).query(centre, distance_upper_bound=float(limit.max()) * 1.01)[0]
            near |= away <= limit
        faces = np.flatnonzero(near).astype(np.int32)
        nodes, corners = triples.renumbered(moved.faces[faces], len(moved.vertices))
        whole = triples.every(wide.take(moved.faces[faces]))
        return cls(nodes, faces, corners, (inside & may)[nodes], whole, far, edge, len(moved.vertices))

    def of(self, surface: Surface) -> Surface:
        """The part of the mesh at some positions."""
        return Surface(surface.vertices[self.nodes], self.corners)

    def carried(self, positions: Float, mended: Float) -> Float:
        """Return all positions (n, 3), those of the part (k, 3) being `mended`."""
        out = positions.copy()
        out[self.nodes] = mended
        return out


def patch(surface: Surface, faces: Int, rings: int) -> np.ndarray:
    """True (n,) for the nodes within `rings` edges of the faces, their own corners being the first."""
    inside = np.zeros(len(surface.vertices), dtype=bool)
    inside[surface.faces[faces].ravel()] = True
    for _ in range(rings - 1):
        inside |= surface.adjacency @ inside.astype(float) > 0
    return inside


def faces_at(surface: Surface, nodes: Int) -> Index:
    """Faces (k,) at some nodes (of any shape), ascending; at the cost of these."""
    order, first = surface.corner_order
    nodes = np.unique(nodes)
    start, count = first[nodes], first[nodes + 1] - first[nodes]
    rows = np.arange(count.sum()) + np.repeat(start - (np.cumsum(count) - count), count)
    return np.unique(order[rows]).astype(np.int64)


@dataclasses.dataclass(frozen=True, eq=False)
class Hanging:
    """Nodes of a mesh as patches, each hanging together.

    Attributes
    ----------
    faces : (j, 3) int32
        Of the mesh.
    label : (k,) int32
        Number of the patch that each node is in, or `count`.
    count : int
        How many there are.
    """

    faces: Int
    label: Int
    count: int

    @classmethod
    def of(cls, surface: Surface, inside: np.ndarray) -> Hanging:
        """The patches of the nodes `inside` (k,)."""
        nodes = np.flatnonzero(inside)
        count, label = csgraph.connected_components(surface.adjacency[nodes][:, nodes], directed=False)
        out = np.full(len(inside), count, dtype=np.int32)
        out[nodes] = label
        return cls(surface.faces, out, int(count))

    def better(self, before: Float, after: Float) -> np.ndarray:
        """True (k,) for the nodes of patches that are less bad than before, by all corners of faces (j,)."""
        rows = np.flatnonzero(before != after)
        change = np.repeat(after[rows] - before[rows], 3)
        fewer = np.bincount(self.label[self.faces[rows]].ravel(), change, self.count + 1) < -1e-9
        fewer[self.count] = True
        return np.asarray(fewer[self.label])

    def small(self, movement: Float, most: float, far: float) -> np.ndarray:
        """True (k,) for the nodes of patches that have no more than so many, and that move no farther."""
        size = np.bincount(self.label, minlength=self.count + 1)
        farthest = np.zeros(self.count + 1)
        np.maximum.at(farthest, self.label, movement)
        small = (size <= most) & (farthest <= far)
        small[self.count] = True
        return np.asarray(small[self.label])

    def all_of(self, some: np.ndarray) -> np.ndarray:
        """True (k,) for all nodes of the patches that have some nodes (k,)."""
        found = np.zeros(self.count + 1, dtype=bool)
        found[self.label[some]] = True
        found[self.count] = False
        return np.asarray(found[self.label])

    def of_faces(self, faces: Int) -> Int:
        """Number of the patch that some faces (r,) reach into, or `count`."""
        return np.asarray(triples.least(self.label[self.faces[faces]]))


def evened(surface: Surface, positions: Float, nodes: Int, rounds: int) -> Float:
    """Move nodes, all being at positions (n, 3), towards the mean of their neighbours, all weighing alike."""
    rows = surface.adjacency[nodes]
    rows = sparse.diags(1.0 / np.maximum(np.asarray(rows.sum(axis=1)).ravel(), 1.0)) @ rows
    out = positions.copy()
    for _ in range(rounds):
        out[nodes] = 0.5 * (out[nodes] + rows @ out)
    return out


def turned(moved: Surface, faces: Int, side: int, share: float) -> Float:
    """Turn faces that lie on their backs over one of their sides; return positions (n, 3).

    The new height over it is `share` of the old one.
    """
    corners = moved.faces[faces]
    place = moved.vertices[corners]
    up = triples.unit(moved.vertex_normals[corners].sum(axis=1))
    back = np.flatnonzero(triples.dot(moved.face_normals[faces], up) < 0)
    corners, place, up = corners[back], place[back], up[back]
    across = triples.unit(triples.cross(up, place[:, side] - place[:, side - 1]))
    away = np.einsum("pkc,pc->pk", place - place.mean(axis=1, keepdims=True), across)
    out = moved.vertices.copy()
    out[corners] = place - (1.0 + share) * away[:, :, None] * across[:, None]
    return out
