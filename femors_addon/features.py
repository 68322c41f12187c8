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

from .mesh import Float, Int, Surface, edge_matrix
from .nearest import Closest, SurfaceIndex

SHARP = 45.0  # degrees between the normals of the faces at a feature edge of the source
SOFTER = 30.0  # the same on the target: a line must not end where its angle passes the limit
LONG = 30  # edges that a line has at least: shorter ones are noise, or facets of a coarse mesh
REACH = 0.75  # mean edges: how far a node goes to a line


def feature_edges(surface: Surface, sharp: float = SHARP) -> Int:
    """Return the edges (k, 2) of the surface's feature lines.

    An edge is sharp where its two faces' normals are more than `sharp` degrees apart; it counts
    where at least `LONG` such edges hang together.
    """
    faces, edges = surface.edge_faces
    one, two = (surface.face_normals[faces[:, i]] for i in range(2))
    edges = edges[np.einsum("ij,ij->i", one, two) < np.cos(np.radians(sharp))]
    if len(edges) < LONG:
        return edges[:0]
    n = len(surface.vertices)
    _, line = csgraph.connected_components(edge_matrix(edges, n), directed=False)
    long = np.bincount(line[edges[:, 0]], minlength=n) >= LONG
    return edges[long[line[edges[:, 0]]]]


@dataclasses.dataclass(frozen=True, eq=False)
class FeatureLines:
    """The source's nodes on feature lines, and the target's lines that they may go to.

    Attributes
    ----------
    nodes : (k,) int32
        Empty where one of the two has no lines.
    lines : SurfaceIndex or None
        Search structure over the target's feature edges.
    reach : float
        Distance beyond which a line is none of a node's business.
    """

    nodes: Int
    lines: SurfaceIndex | None
    reach: float

    @classmethod
    def between(cls, source: Surface, target: Surface) -> FeatureLines:
        """Find the lines of both; the source may be anywhere, for angles alone tell its lines."""
        reach = REACH * max(source.mean_edge, target.mean_edge)
        ours, theirs = feature_edges(source), feature_edges(target, SOFTER)
        if not len(ours) or not len(theirs):
            return cls(np.zeros(0, np.int32), None, reach)
        segments = Surface(target.vertices, theirs[:, [0, 1, 1]])
        return cls(np.unique(ours).astype(np.int32), SurfaceIndex(segments), reach)

    def onto(self, positions: Float) -> tuple[Int, Float]:
        """Return which nodes (j,) at positions (n, 3) have a line within reach, and where on it (j, 3)."""
        if self.lines is None:
            return self.nodes[:0], np.zeros((0, 3))
        found: Closest = self.lines.closest(positions[self.nodes])
        near = found.distance < self.reach
        return self.nodes[near], found.point[near]
