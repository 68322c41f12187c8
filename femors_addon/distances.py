# SPDX-License-Identifier: GPL-3.0-or-later
"""Signed distances of one body's vertices to another: exact where they are small, and of the deepest.

The nearest corner of a surface is at most sqrt(d^2 + L^2 / 3) away, with L its longest side (see
`nearest`): one search through its corners bounds the distance d of every vertex. Vertices that are near
are measured exactly, against the part of the surface that they can reach. Those that are far need a
sign only, and have it from their neighbours: an edge that is shorter than an end's distance cannot
cross. The closest point to a node at the centre of a ball would have to be looked for among all faces.
"""

from __future__ import annotations

import dataclasses
import threading

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from . import triples
from .bodies import Solid
from .cached import cached_property
from .crew import in_blocks
from .cutouts import Region
from .mesh import Float, Surface, edge_matrix
from .nearest import SurfaceIndex

FIRST = 8  # deep vertices that are measured first, to tell which others may be deeper
DEEPER = 1e-3  # of the depth: what counts as deeper, for a vertex that is far inside

Mask = NDArray[np.bool_]


class Target:
    """A body that others are measured against; its search structures are made when they are asked for."""

    def __init__(self, solid: Solid) -> None:
        self.solid, self.surface = solid, solid.surface.bare()
        self._corners: cKDTree | None = None
        self._index: SurfaceIndex | None = None
        self._lock = threading.Lock()  # pairs may be measured at once

    @property
    def index(self) -> SurfaceIndex:
        """Search structure of all faces."""
        with self._lock:
            if self._index is None:
                self._index = SurfaceIndex(self.surface)
            return self._index

    @cached_property
    def longest(self) -> float:
        """Length of the longest side of a face."""
        return float(np.sqrt(triples.longest_squared(self.surface.corners).max()))

    def corner(self, points: Float) -> tuple[Float, NDArray[np.int64]]:
        """Return (distance (p,) of the nearest vertex, (p,) which)."""
        with self._lock:
            if self._corners is None:
                self._corners = cKDTree(self.surface.vertices, balanced_tree=False)
        tree = self._corners
        found = in_blocks(lambda block: tree.query(points[block]), len(points))
        far, which = (np.concatenate(column) for column in zip(*found, strict=True))
        return far, which

    def near(self, points: Float) -> Float:
        """Return exact signed distances (p,) of points that are all near the surface."""
        if not len(points):
            return np.zeros(0)
        return self.signed(points, float(self.corner(points)[0].max()))[0]

    def signed(self, points: Float, reach: float = np.inf) -> tuple[Float, Float]:
        """Return exact signed distances (p,) and pseudonormals (p, 3); no point is farther than `reach`."""
        index = None
        if np.isfinite(reach) and not self.solid.open_edges:
            low, high = triples.box(points)
            wide = reach * (1.0 + 1e-9)  # a distance is rounded
            part = Region.of(self.surface, low - wide, high + wide).surface
            if 2 * len(part.faces) < len(
                self.surface.faces
            ):  # whatever is there: bits must not go by the order
                index = SurfaceIndex(part)
        chosen = index or self.index

        def measured(block: slice) -> tuple[Float, Float]:
            found = chosen.closest(points[block])
            normal = chosen.pseudonormals(found)
            side = np.einsum("ij,ij->i", points[block] - found.point, normal)
            inside = (side < 0) & ~self.solid.on_border(found)
            return np.where(inside, -found.distance, found.distance), normal

        signed, normal = zip(*in_blocks(measured, len(points)), strict=True)
        return np.concatenate(signed), np.concatenate(normal)


@dataclasses.dataclass(frozen=True, eq=False)
class Distances:
    """Of the vertices of one body within reach of another's box.

    Attributes
    ----------
    rows : (k,) int64
        The vertices.
    signed : (k,) float64
        Distances, negative inside. Exact below the reach, outside and inside; farther outside no less
        than the reach; farther inside the least of all is the depth, exact or less by a thousandth.
    wrong : (k,) bool
        Whether a vertex inside would leave along its own normal, by the wrong side.
    bound : (n,) float64
        No signed distance of any vertex of the body is smaller.
    apart : (n,) float64
        No distance of any vertex of the body from the other's surface is smaller.
    """

    rows: NDArray[np.int64]
    signed: Float
    wrong: Mask
    bound: Float
    apart: Float


def distances(surface: Surface, other: Target, reach: float, exact: bool = False) -> Distances:
    """Measure the vertices of a surface within `reach` of the other's box.

    With `exact` all vertices inside are measured, not just the near and the deepest.
    """
    points = surface.vertices
    low, high = other.surface.bounds
    apart = triples.length(np.maximum(np.maximum(low - points, points - high), 0.0))  # from its box
    rows = np.flatnonzero(apart <= reach)
    bound = apart.copy()
    if not len(rows):
        return Distances(rows, np.zeros(0), np.zeros(0, dtype=bool), bound, apart)
    points = points[rows]
    most, corner = other.corner(points)
    fewest = np.sqrt(np.maximum(most**2 - other.longest**2 / 3.0, 0.0)) * (1.0 - 1e-12)
    near = fewest <= reach
    if other.solid.open_edges:  # beside an open border neighbours may be on either side
        near[:] = True
    signed = most.copy()
    way = other.surface.vertices[corner] - points  # out of the body, for those inside
    close = np.flatnonzero(near)
    if len(close):
        signed[close], way[close] = other.signed(points[close], float(most[close].max()))
    apart[rows] = np.where(near, np.abs(signed), fewest)
    if len(close) < len(rows):
        inside = _sides(surface, other, rows, near, signed, apart)
        deep = np.flatnonzero(inside & ~near)
        signed[deep] = -fewest[deep]
        _measure_deepest(other, points, deep, most, signed, exact)
        bound[rows] = np.where(near, signed, np.where(inside, -most, fewest))
    else:
        bound[rows] = signed
    wrong = np.einsum("ij,ij->i", surface.vertex_normals[rows], way) > 0
    return Distances(rows, signed, wrong, bound, apart)


def _sides(
    surface: Surface, other: Target, rows: NDArray[np.int64], near: Mask, signed: Float, apart: Float
) -> Mask:
    """Whether the vertices `rows` are inside: the near ones as measured, the others as their neighbours.

    Vertices that are no rows are outside, beyond the other's box.
    """
    count = len(surface.vertices)
    far = np.zeros(count, dtype=bool)
    far[rows[~near]] = True
    edges = surface.edges[far[surface.edges[:, 0]] | far[surface.edges[:, 1]]]
    one, two = edges.T
    safe = triples.length(surface.vertices[one] - surface.vertices[two]) < np.maximum(apart[one], apart[two])
    matrix = edge_matrix(edges[safe], count)
    pieces, piece = csgraph.connected_components(matrix, directed=False)
    within = np.zeros(pieces, dtype=bool)
    told = np.zeros(pieces, dtype=bool)
    beyond = np.ones(count, dtype=bool)
    beyond[rows] = False
    told[piece[beyond]] = True
    mine = piece[rows]
    told[mine[near]] = True
    within[mine[near & (signed < 0)]] = True
    asked = np.flatnonzero(~told[mine])
    if len(asked):  # of each piece that nothing is known of, the vertex that is easiest to measure
        order = asked[np.lexsort((signed[asked], mine[asked]))]
        first = order[np.append(True, np.diff(mine[order]) > 0)]
        exact, _ = other.signed(surface.vertices[rows[first]], float(signed[first].max()))
        within[mine[first]] = exact < 0
    inside: Mask = np.where(near, signed < 0, within[mine])
    return inside


def _measure_deepest(
    other: Target, points: Float, deep: NDArray[np.int64], most: Float, signed: Float, exact: bool
) -> None:
    """Put exact distances of the vertices `deep`, far inside, in `signed`: of those that may be deepest."""
    deep = deep[np.argsort(-most[deep], kind="stable")]
    start, size = 0, FIRST
    while start < len(deep):
        block = deep[start : start + size]
        if not exact:
            block = block[most[block] > (1.0 + DEEPER) * -float(signed.min())]
            if not len(block):
                return
        signed[block] = np.minimum(other.signed(points[block], float(most[block].max()))[0], 0.0)
        start, size = start + size, 2 * size
