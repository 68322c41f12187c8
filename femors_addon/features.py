# SPDX-License-Identifier: GPL-3.0-or-later
"""Feature lines: the rims and ridges of a surface, which a morph lays onto each other.

Where two faces meet at a sharp edge, as at the rim of a cartilage, the closest point of a node on the
rim may lie on either side of it; the element there would be flattened. Nodes on a feature line of the
source go to the closest point of the target's feature lines instead.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from . import triples
from .correspond import FACING
from .mesh import Float, Int, Surface, edge_matrix
from .nearest import Closest, SurfaceIndex

SHARP = 45.0  # degrees between the normals of the faces at a feature edge of the source
SOFTER = 30.0  # the same on the target: a line must not end where its angle passes the limit
LONG = 30  # edges that a line has at least: shorter ones are noise, or facets of a coarse mesh
REACH = 0.75  # mean edges: how far a node goes to a line
AROUND = (
    16  # edges of lines that are looked at, where the closest one faces another way: within reach few lie
)


def feature_edges(surface: Surface, sharp: float = SHARP) -> tuple[Int, Int]:
    """Return the edges (k, 2) of the surface's feature lines, and the two faces (k, 2) of each.

    An edge is sharp where its two faces' normals are more than `sharp` degrees apart; it counts
    where at least `LONG` such edges hang together.
    """
    faces, edges = surface.edge_faces
    one, two = (surface.face_normals[faces[:, i]] for i in range(2))
    bent = np.einsum("ij,ij->i", one, two) < np.cos(np.radians(sharp))
    faces, edges = faces[bent], edges[bent]
    if len(edges) < LONG:
        return edges[:0], faces[:0]
    n = len(surface.vertices)
    _, line = csgraph.connected_components(edge_matrix(edges, n), directed=False)
    long = np.bincount(line[edges[:, 0]], minlength=n) >= LONG
    long = long[line[edges[:, 0]]]
    return edges[long], faces[long]


def _facing(surface: Surface, faces: Int) -> Float:
    """Direction (k, 3) that each edge points to: the mean of the normals of its two faces (k, 2)."""
    return triples.unit(surface.face_normals[faces].sum(axis=1))


@dataclasses.dataclass(frozen=True, eq=False)
class FeatureLines:
    """The source's nodes on feature lines, and the target's lines that they may go to.

    Attributes
    ----------
    nodes : (k,) int32
        Empty where one of the two has no lines.
    edges, faces : (l, 2) int32
        The source's feature edges, as places in `nodes`, and the faces of each.
    lines : SurfaceIndex or None
        Search structure over the target's feature edges.
    facing : (m, 3) float64
        Directions that these point to.
    reach : float
        Distance beyond which a line is none of a node's business.
    """

    nodes: Int
    edges: Int
    faces: Int
    lines: SurfaceIndex | None
    facing: Float
    reach: float

    @classmethod
    def between(cls, source: Surface, target: Surface) -> FeatureLines:
        """Find the lines of both; the source may be anywhere, for angles alone tell its lines."""
        reach = REACH * max(source.mean_edge, target.mean_edge)
        (ours, our_faces), (theirs, their_faces) = feature_edges(source), feature_edges(target, SOFTER)
        if not len(ours) or not len(theirs):
            none = np.zeros((0, 2), np.int32)
            return cls(none[:, 0], none, none, None, np.zeros((0, 3)), reach)
        segments = Surface(target.vertices, theirs[:, [0, 1, 1]])
        nodes, places = np.unique(ours, return_inverse=True)
        places = places.reshape(-1, 2).astype(np.int32)
        facing = _facing(target, their_faces)
        return cls(nodes.astype(np.int32), places, our_faces, SurfaceIndex(segments), facing, reach)

    def onto(self, surface: Surface) -> tuple[Int, Float]:
        """Return which nodes (j,) of the moved source have a line within reach, and where on it (j, 3)."""
        if self.lines is None:
            return self.nodes[:0], np.zeros((0, 3))
        positions = surface.vertices[self.nodes]
        own = np.zeros_like(positions)
        for column in self.edges.T:
            np.add.at(own, column, _facing(surface, self.faces))
        own = triples.unit(own)
        found: Closest = self.lines.closest(positions)
        distance, point = found.distance.copy(), found.point
        other = np.flatnonzero(
            (distance < self.reach) & (triples.dot(own, self.facing[found.face]) <= FACING)
        )
        if len(other):
            distance[other], point[other] = self._compatible(positions[other], own[other])
        near = distance < self.reach
        return self.nodes[near], point[near]

    def _compatible(self, points: Float, own: Float) -> tuple[Float, Float]:
        """Return distances (k,) to, and points (k, 3) on, the closest edges that face as the nodes do."""
        assert self.lines is not None
        start, end, _ = self.lines.surface.corners.transpose(1, 0, 2)
        count = min(AROUND, len(start))
        _, hit = cKDTree(0.5 * (start + end)).query(points, count)
        hit = hit.reshape(len(points), count)
        side = end[hit] - start[hit]
        along = np.einsum("pkc,pkc->pk", points[:, None] - start[hit], side)
        along = np.clip(along / np.maximum(np.einsum("pkc,pkc->pk", side, side), 1e-300), 0.0, 1.0)
        place = start[hit] + along[:, :, None] * side
        distance = np.linalg.norm(place - points[:, None], axis=2)
        distance[np.einsum("pc,pkc->pk", own, self.facing[hit]) <= FACING] = np.inf
        row, best = np.arange(len(points)), distance.argmin(axis=1)
        return distance[row, best], place[row, best]
