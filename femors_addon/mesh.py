# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces as arrays: normals, areas, edges, neighbours; and polygons cut into triangles."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse import csgraph

from . import triples
from .cached import cached_property
from .crew import blockwise
from .progress import FemorsError
from .triples import Float

Int = NDArray[np.int32]
Single = NDArray[np.float32]

EDGES = 100_000  # of which pieces are found at a time: some 15 ms

TOPOLOGY = (
    "edges",
    "edge_faces",
    "opposed_edges",
    "border",
    "components",
    "closed",
    "adjacency",
    "vertex_faces",
    "corner_order",
)


def frozen(array: ArrayLike, dtype: type, columns: int) -> NDArray:
    """Return a read-only, contiguous (n, columns) array of the dtype; what is so already is not copied."""
    given = np.asarray(array)
    owned = given.base is None and not given.flags.writeable and given.flags.c_contiguous
    if owned and given.dtype == dtype and given.shape[1:] == (columns,):
        return given
    out: NDArray = np.array(given, dtype=dtype, order="C")
    if out.shape[1:] != (columns,):
        out = out.reshape(-1, columns)
    out.setflags(write=False)
    return out


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """A triangulated surface.

    Parameters
    ----------
    vertices : (n, 3) float64
        Positions, in the user's unit of length; must be finite.
    faces : (m, 3) int32
        Vertex indices of each triangle, counter-clockwise seen from outside.

    Raises
    ------
    FemorsError
        Coordinates that are not finite, or a face that names a vertex that is not there.
    """

    vertices: Float
    faces: Int

    def __post_init__(self) -> None:
        for name, what in (
            ("vertices", "(n, 3) positions"),
            ("faces", "(m, 3) vertex indices; triangulate()"),
        ):
            given = np.asarray(getattr(self, name))
            if given.size and (given.ndim != 2 or given.shape[1] != 3):
                raise FemorsError(f"{name} must be {what}, not an array of shape {given.shape}")
        if np.asarray(self.faces).size and not np.issubdtype(np.asarray(self.faces).dtype, np.integer):
            raise FemorsError("faces must be whole numbers: indices of vertices")
        object.__setattr__(self, "vertices", frozen(self.vertices, np.float64, 3))
        object.__setattr__(self, "faces", frozen(self.faces, np.int32, 3))
        if not np.isfinite(self.vertices).all():
            bad = ~triples.every(np.isfinite(self.vertices))
            raise FemorsError(
                f"{int(bad.sum())} of {len(bad)} vertices with coordinates that are not finite "
                f"(first: vertex {int(np.argmax(bad))}); repair or delete them"
            )
        if len(self.faces) and (self.faces.min() < 0 or self.faces.max() >= len(self.vertices)):
            raise FemorsError("a face names a vertex that the mesh does not have")

    def moved(self, vertices: ArrayLike) -> Surface:
        """Return the same faces at other vertex positions (n, 3); topology caches are shared."""
        other = Surface(np.asarray(vertices), self.faces)
        for name in TOPOLOGY:
            if name in self.__dict__:
                other.__dict__[name] = self.__dict__[name]
        return other

    def bare(self) -> Surface:
        """Return the surface with nothing remembered but its edges and border: large ones take memory."""
        other = Surface(self.vertices, self.faces)
        other.__dict__.update(
            {name: self.__dict__[name] for name in ("edges", "border") if name in self.__dict__}
        )
        return other

    # --- geometry -----------------------------------------------------------------------------
    @property
    def corners(self) -> Float:
        """(m, 3, 3) the corner positions of each face: taken anew each time, for they are large."""
        return self.vertices.take(self.faces, axis=0)

    def told(self, by_corners: Callable[[Float, Float, Float], NDArray]) -> NDArray:
        """Return what is told (m, ...) of each face by its three corners, (k, 3) each of some at a time."""

        def of(block: slice) -> NDArray:
            return by_corners(*(self.vertices.take(corner, axis=0) for corner in self.faces[block].T))

        return blockwise(of, len(self.faces))

    @cached_property
    def face_cross(self) -> Float:
        """(m, 3) face normals scaled by twice the area."""
        return self.told(triples.crossed)

    @cached_property
    def face_areas(self) -> Float:
        """(m,) areas."""
        return 0.5 * triples.length(self.face_cross)

    @cached_property
    def face_normals(self) -> Float:
        """(m, 3) unit normals; zero for degenerate faces."""
        return triples.unit(self.face_cross)

    @cached_property
    def vertex_normals(self) -> Float:
        """(n, 3) area-weighted unit normals; zero where no face is."""
        return triples.unit(self.vertex_faces @ self.face_cross)

    @cached_property
    def facing(self) -> Float:
        """(m,) cosine between each face's normal and the mean of the normals at its corners."""
        around, own = self.vertex_normals, self.face_normals

        def of(block: slice) -> Float:
            mean = triples.unit(triples.total(around.take(self.faces[block], axis=0)))
            return np.einsum("ij,ij->i", own[block], mean)

        return blockwise(of, len(self.faces))

    @cached_property
    def bounds(self) -> tuple[Float, Float]:
        """Lowest and highest corner of the axis-aligned bounding box; the origin where no vertex is."""
        if not len(self.vertices):
            return np.zeros(3), np.zeros(3)
        return triples.box(self.vertices)

    @cached_property
    def diagonal(self) -> float:
        """Length of the bounding box's diagonal."""
        low, high = self.bounds
        return float(np.linalg.norm(high - low))

    @property
    def edge_lengths(self) -> Float:
        """(e,) the lengths of the edges: taken anew each time."""

        def of(block: slice) -> Float:
            a, b = (self.vertices.take(end, axis=0) for end in self.edges[block].T)
            return triples.length(a - b)

        return blockwise(of, len(self.edges))

    @cached_property
    def mean_edge(self) -> float:
        """Mean length of the edges."""
        lengths = self.edge_lengths
        return float(lengths.mean()) if len(lengths) else 0.0

    @cached_property
    def volume(self) -> float:
        """Signed volume (divergence theorem about the centroid); positive for outward normals."""
        if not len(self.faces):
            return 0.0
        a, b, c = np.moveaxis(self.corners - self.vertices.mean(axis=0), 1, 0)
        return float(triples.dot(a, triples.cross(b, c)).sum() / 6.0)

    # --- topology -----------------------------------------------------------------------------
    @cached_property
    def edges(self) -> Int:
        """(e, 2) unique undirected edges, lower index first, in lexicographic order."""
        return self._sides()[0]

    @cached_property
    def edge_faces(self) -> tuple[Int, Int]:
        """((k, 2) face pairs, (k, 2) vertex pairs) of the edges shared by exactly two faces."""
        return self._sides()[1]

    @cached_property
    def opposed_edges(self) -> NDArray[np.bool_]:
        """(k,) true for the edges of `edge_faces` whose two faces run along them the same way."""
        return self._sides()[3]

    @cached_property
    def border(self) -> NDArray[np.bool_]:
        """(n,) true for the vertices on an open border (an edge with one face only)."""
        return self._sides()[2]

    def _sides(self) -> tuple[Int, tuple[Int, Int], NDArray[np.bool_], NDArray[np.bool_]]:
        """Sort the faces' sides once, and keep the four properties that it tells."""
        n = max(len(self.vertices), 1)
        one, two = self.faces.ravel(), self.faces[:, [1, 2, 0]].ravel()
        keys = np.minimum(one, two).astype(np.int64) * n + np.maximum(one, two)
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        first = np.flatnonzero(np.concatenate((np.ones(min(len(keys), 1), bool), keys[1:] != keys[:-1])))
        count = np.diff(first, append=len(keys))
        edges = np.column_stack(np.divmod(keys[first], n)).astype(np.int32)
        shared = count == 2
        left, right = order[first[shared]], order[first[shared] + 1]
        pairs = np.column_stack((left // 3, right // 3)).astype(np.int32)
        border = np.zeros(len(self.vertices), dtype=bool)
        border[edges[count == 1].ravel()] = True
        upward = one < two
        found = edges, (pairs, edges[shared]), border, upward[left] == upward[right]
        for name, value in zip(("edges", "edge_faces", "border", "opposed_edges"), found, strict=True):
            self.__dict__.setdefault(name, value)
        return found

    @cached_property
    def components(self) -> Int:
        """(m,) the component of each face: faces hang together by edges with two faces."""
        return connected(self.edge_faces[0], len(self.faces))

    @cached_property
    def closed(self) -> NDArray[np.bool_]:
        """True for each of the `components` whose faces all have three neighbours."""
        shared = np.bincount(self.edge_faces[0].ravel(), minlength=len(self.faces))
        parts = int(self.components.max(initial=-1)) + 1
        return np.asarray(np.bincount(self.components, shared != 3, minlength=parts) == 0)

    @cached_property
    def adjacency(self) -> sparse.csr_matrix:
        """(n, n) symmetric 0/1 matrix of the edges."""
        return edge_matrix(self.edges, len(self.vertices))

    @cached_property
    def corner_order(self) -> tuple[Int, Int]:
        """((3 m,) faces in the order of their vertices, (n + 1,) where each vertex's faces begin)."""
        around = self.vertex_faces
        return around.indices, around.indptr.astype(np.int64)

    @cached_property
    def vertex_faces(self) -> sparse.csr_matrix:
        """(n, m) 0/1 matrix: the faces at each vertex, ascending."""
        corners, shape = self.faces.ravel(), (len(self.vertices), len(self.faces))
        first = np.arange(0, len(corners) + 1, 3, dtype=np.int32)
        # SciPy sorts by counting here: a tenth of the time of a sort
        return sparse.csc_matrix((np.ones(len(corners)), corners, first), shape=shape).tocsr()


def edge_matrix(edges: Int, n: int) -> sparse.csr_matrix:
    """Return the symmetric (n, n) 0/1 matrix of undirected edges (e, 2)."""
    ones = np.ones(len(edges))
    half = sparse.csr_matrix((ones, (edges[:, 0], edges[:, 1])), shape=(n, n))
    return (half + half.T).tocsr()


def connected(edges: Int, n: int) -> Int:
    """Return for each of n nodes which connected piece it is in (n,), by edges (e, 2); in the order of nodes.

    SciPy holds the interpreter while it looks, so it is asked about some edges at a time.
    """
    first = np.arange(n, dtype=np.int32)  # of the nodes known to be in the same piece
    for start in range(0, len(edges), EDGES):
        ends = first[edges[start : start + EDGES]]
        nodes, local = triples.renumbered(ends[ends[:, 0] != ends[:, 1]], n)
        if len(nodes):
            piece = csgraph.connected_components(edge_matrix(local, len(nodes)), directed=False)[1]
            now = np.arange(n, dtype=np.int32)
            now[nodes] = nodes[np.unique(piece, return_index=True)[1]][piece]
            first = now[first]
    return triples.renumbered(first, n)[1]


def triangulate(sizes: ArrayLike, corners: ArrayLike) -> tuple[Int, Int]:
    """Split polygons into triangle fans from their first corner.

    Parameters
    ----------
    sizes : (p,) int
        Number of corners of each polygon; those with fewer than three give no triangle.
    corners : (sum(sizes),) int
        The polygons' vertex indices, one after the other.

    Returns
    -------
    triangles : (m, 3) int32
        A quad (a, b, c, d) becomes (a, b, c) and (a, c, d), always on this diagonal.
    polygon : (m,) int32
        The polygon that each triangle comes from.
    """
    sizes = np.asarray(sizes).ravel()
    if 3 * len(sizes) == np.size(corners) and (sizes == 3).all():
        triangles = np.array(corners, dtype=np.int32).reshape(-1, 3)
        return triangles, np.arange(len(triangles), dtype=np.int32)
    sizes, corners = sizes.astype(np.int64), np.asarray(corners, dtype=np.int64).ravel()
    start = np.cumsum(sizes) - sizes
    count = np.maximum(sizes - 2, 0)
    polygon = np.repeat(np.arange(len(sizes)), count)
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    base = start[polygon]
    triangles = np.column_stack((corners[base], corners[base + step + 1], corners[base + step + 2]))
    return triangles.reshape(-1, 3).astype(np.int32), polygon.astype(np.int32)
