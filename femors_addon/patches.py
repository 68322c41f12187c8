# SPDX-License-Identifier: GPL-3.0-or-later
"""Patches of a mesh around faces that want mending: which nodes they have, and ways to lay them out."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from . import triples
from .balls import enclosing_balls
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


def patch(surface: Surface, faces: Int, rings: int) -> np.ndarray:
    """True (n,) for the nodes within `rings` edges of the faces, their own corners being the first."""
    inside = np.zeros(len(surface.vertices), dtype=bool)
    inside[surface.faces[faces].ravel()] = True
    for _ in range(rings - 1):
        inside |= surface.adjacency @ inside.astype(float) > 0
    return inside


def hanging(surface: Surface, inside: np.ndarray) -> tuple[Int, int]:
    """Number (n,) of the patch that each node is in, and how many there are; the last stands for none."""
    nodes = np.flatnonzero(inside)
    count, label = csgraph.connected_components(surface.adjacency[nodes][:, nodes], directed=False)
    out = np.full(len(inside), count, dtype=np.int32)
    out[nodes] = label
    return out, int(count)


def better(surface: Surface, inside: np.ndarray, before: Float, after: Float) -> np.ndarray:
    """True (n,) for the nodes of patches, each hanging together, that are less bad than before."""
    label, count = hanging(surface, inside)

    def tally(badness: Float) -> Float:
        counted = np.bincount(label[surface.faces].ravel(), np.repeat(badness, 3), count + 1)
        return np.asarray(counted, dtype=float)

    fewer = tally(after) < tally(before) - 1e-9
    fewer[count] = True
    return np.asarray(fewer[label])


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
