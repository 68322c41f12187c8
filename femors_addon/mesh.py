# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces as arrays: normals, edges, triangulation, and the cleaning that the maths needs."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse import csgraph

from . import triples
from .cached import cached_property
from .progress import FemorsError
from .triples import Float

Int = NDArray[np.int32]

TOPOLOGY = ("edges", "edge_faces", "border", "components", "adjacency", "vertex_faces", "corner_order")
PROBES = 12  # vertices of a component that are looked at to tell whether it lies in another
FLAT = 1e-10  # of its area to the power 1.5: a component of less volume has no inside

MERGED = "merged for the maths"
"""How a note ends that is no warning: any STL file has each vertex several times."""


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
                f"{int(bad.sum())} of {len(bad)} vertices have coordinates that are not finite "
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

    @cached_property
    def face_cross(self) -> Float:
        """(m, 3) face normals scaled by twice the area."""
        a, b, c = (self.vertices.take(corner, axis=0) for corner in self.faces.T)
        return triples.cross(b - a, c - a)

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

    @cached_property
    def mean_edge(self) -> float:
        """Mean length of the edges."""
        a, b = self.vertices[self.edges[:, 0]], self.vertices[self.edges[:, 1]]
        return float(triples.length(a - b).mean()) if len(a) else 0.0

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
    def border(self) -> NDArray[np.bool_]:
        """(n,) true for the vertices on an open border (an edge with one face only)."""
        return self._sides()[2]

    def _sides(self) -> tuple[Int, tuple[Int, Int], NDArray[np.bool_]]:
        """Sort the faces' sides once, and keep all that it tells: edges, edge_faces, border."""
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
        found = edges, (pairs, edges[shared]), border
        for name, value in zip(("edges", "edge_faces", "border"), found, strict=True):
            self.__dict__.setdefault(name, value)
        return found

    @cached_property
    def components(self) -> Int:
        """(m,) the component of each face: faces hang together by edges with two faces."""
        graph = edge_matrix(self.edge_faces[0], len(self.faces))
        return csgraph.connected_components(graph, directed=False)[1].astype(np.int32)

    @cached_property
    def adjacency(self) -> sparse.csr_matrix:
        """(n, n) symmetric 0/1 matrix of the edges."""
        return edge_matrix(self.edges, len(self.vertices))

    @cached_property
    def corner_order(self) -> tuple[Int, Int]:
        """((3 m,) faces in the order of their vertices, (n + 1,) where each vertex's faces begin)."""
        corner = self.faces.ravel()
        order = (np.argsort(corner, kind="stable") // 3).astype(np.int32)
        count = np.bincount(corner, minlength=len(self.vertices))
        return order, np.concatenate(([0], np.cumsum(count)))

    @cached_property
    def vertex_faces(self) -> sparse.csr_matrix:
        """(n, m) 0/1 matrix: the faces at each vertex."""
        m = len(self.faces)
        columns = np.repeat(np.arange(m), 3)
        ones = np.ones(3 * m)
        return sparse.csr_matrix((ones, (self.faces.ravel(), columns)), shape=(len(self.vertices), m))


def edge_matrix(edges: Int, n: int) -> sparse.csr_matrix:
    """Return the symmetric (n, n) 0/1 matrix of undirected edges (e, 2)."""
    ones = np.ones(len(edges))
    half = sparse.csr_matrix((ones, (edges[:, 0], edges[:, 1])), shape=(n, n))
    return (half + half.T).tocsr()


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
    sizes = np.asarray(sizes, dtype=np.int64).ravel()
    corners = np.asarray(corners, dtype=np.int64).ravel()
    start = np.cumsum(sizes) - sizes
    count = np.maximum(sizes - 2, 0)
    polygon = np.repeat(np.arange(len(sizes)), count)
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    base = start[polygon]
    triangles = np.column_stack((corners[base], corners[base + step + 1], corners[base + step + 2]))
    return triangles.reshape(-1, 3).astype(np.int32), polygon.astype(np.int32)


@dataclasses.dataclass(frozen=True, eq=False)
class Cleaned:
    """A surface fit for the maths, and the way back to the mesh that it was made from.

    Attributes
    ----------
    surface : Surface
        Merged, without degenerate or duplicate faces and unreferenced vertices, oriented outward.
    vertex_map : (n,) int32
        For each original vertex its index in `surface`, or -1 where no face used it.
    face_map : (k,) int32
        For each face of `surface` the original triangle.
    notes : tuple of str
        What was mended, in words.
    """

    surface: Surface
    vertex_map: Int
    face_map: Int
    notes: tuple[str, ...]


def clean(vertices: ArrayLike, triangles: ArrayLike, name: str = "mesh") -> Cleaned:
    """Merge, deduplicate and orient a triangle mesh; the input is left as it is.

    Vertices at equal coordinates are merged; a triangle soup that shares no vertex even so (an
    ASCII file with rounded numbers, say) is merged at a millionth of its size. Winding is made
    consistent and outward component by component; a closed shell inside another points inward.

    Raises
    ------
    FemorsError
        No faces, fewer than four vertices, no extent in some direction, non-finite coordinates.
    """
    raw = _named(name, vertices, triangles)
    notes: list[str] = []
    merged, vertex_map = _merge(raw)
    faces = merged[raw.faces] if len(raw.faces) else raw.faces
    faces, face_map = _proper_faces(faces, raw.vertices[vertex_map], notes)
    if len(faces) < 4:
        raise FemorsError(f"{name}: {len(faces)} usable face(s) are not a surface; at least 4 are needed")
    used, compact = np.unique(faces, return_inverse=True)
    faces = compact.reshape(-1, 3).astype(np.int32)
    positions = raw.vertices[vertex_map[used]]
    _check_extent(positions, name)
    lookup = np.full(len(vertex_map), -1, dtype=np.int32)
    lookup[used] = np.arange(len(used), dtype=np.int32)
    to_clean = lookup[merged]
    shared = int((np.bincount(to_clean[to_clean >= 0], minlength=len(used)) > 1).sum())
    if shared:
        notes.append(f"{shared} vertices stood twice or more and were merged for the maths")
    unused = int((to_clean < 0).sum())
    if unused:
        notes.append(f"{unused} vertices belong to no face")
    surface, turned = oriented(Surface(positions, faces))
    if turned:
        notes.append(f"{turned} of {len(faces)} faces were wound inward and turned for the maths")
    return Cleaned(surface, to_clean, face_map, tuple(f"{name}: {note}" for note in notes))


def _named(name: str, vertices: ArrayLike, triangles: ArrayLike) -> Surface:
    try:
        surface = Surface(np.asarray(vertices), np.asarray(triangles))
    except FemorsError as error:
        raise FemorsError(f"{name}: {error}") from None
    if len(surface.faces) == 0:
        raise FemorsError(f"{name}: has no faces; a surface mesh is needed")
    return surface


def _merge(surface: Surface) -> tuple[Int, Int]:
    """Return (for each vertex its merged index, for each merged vertex one original index)."""
    first, inverse = unique_rows(surface.vertices)
    if len(first) == 3 * len(surface.faces) and len(surface.faces) > 1:
        from scipy.spatial import cKDTree

        pairs = cKDTree(surface.vertices[first]).query_pairs(1e-6 * surface.diagonal, output_type="ndarray")
        graph = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(first),) * 2)
        _, group = csgraph.connected_components(graph, directed=False)
        inverse = group[inverse]
    # number merged vertices by their first appearance: file order survives the merge
    _, first, inverse = np.unique(inverse, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(order), dtype=np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    return rank[inverse.ravel()], first[order].astype(np.int32)


def unique_rows(rows: NDArray) -> tuple[NDArray, NDArray]:
    """Return (for each different row its first index, for each row which of these it is).

    As ``numpy.unique(axis=0)``, in a fraction of the time, and other threads can run meanwhile.
    """
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    new = np.ones(len(rows), dtype=bool)
    new[1:] = False
    for axis in range(rows.shape[1]):
        new[1:] |= ordered[1:, axis] != ordered[:-1, axis]
    inverse = np.empty(len(rows), dtype=np.int64)
    inverse[order] = np.cumsum(new) - 1
    return order[new], inverse


def _proper_faces(faces: Int, positions: Float, notes: list[str]) -> tuple[Int, Int]:
    """Drop faces with a repeated vertex, of no area, or standing twice."""
    a, b, c = faces.T
    corners = positions[faces]
    area = triples.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    longest = triples.longest_squared(corners)
    proper = (a != b) & (b != c) & (c != a)
    proper &= triples.dot(area, area) > (1e-12 * longest) ** 2
    keep = np.flatnonzero(proper)
    first, _ = unique_rows(np.sort(faces[keep], axis=1))
    kept = keep[np.sort(first)]
    if len(keep) < len(faces):
        notes.append(f"{len(faces) - len(keep)} faces have no area and were left out of the maths")
    if len(kept) < len(keep):
        notes.append(f"{len(keep) - len(kept)} faces stand twice and were counted once")
    return faces[kept], kept.astype(np.int32)


def _check_extent(positions: Float, name: str) -> None:
    centred = positions - positions.mean(axis=0)
    scale = np.abs(centred).max()
    if not scale > 0:
        raise FemorsError(f"{name}: all vertices are at one point")
    singular = np.linalg.svd((centred / scale), compute_uv=False)
    if len(singular) < 3 or singular[2] < 1e-6 * singular[0]:
        raise FemorsError(f"{name}: all vertices lie in one plane; a surface with depth is needed")


def oriented(surface: Surface) -> tuple[Surface, int]:
    """Wind faces consistently and outward; return the surface and how many faces were turned."""
    flip, component = _consistent(surface)
    faces = np.where(flip[:, None], surface.faces[:, ::-1], surface.faces)
    volume = _component_volumes(surface.vertices, faces, component)
    inside = _nesting(surface.vertices, faces, component, volume)
    # a flat flap has no inside; rounding alone must not turn it
    area = np.bincount(component, triples.length(surface.face_cross))
    wrong = np.abs(volume) > FLAT * area**1.5
    wrong &= (volume < 0) != (inside % 2 == 1)
    turn = flip != wrong[component]
    if not turn.any():
        return surface, 0
    return Surface(surface.vertices, np.where(turn[:, None], surface.faces[:, ::-1], surface.faces)), int(
        turn.sum()
    )


def _consistent(surface: Surface) -> tuple[NDArray[np.bool_], Int]:
    """Walk a spanning tree of the faces; return (face to flip, component of the face)."""
    m = len(surface.faces)
    (faces, edge) = surface.edge_faces
    half = surface.faces[:, [[0, 1], [1, 2], [2, 0]]]

    def forward(face: Int) -> NDArray[np.bool_]:
        return triples.some((half[face, :, 0] == edge[:, :1]) & (half[face, :, 1] == edge[:, 1:]))

    disagree = forward(faces[:, 0]) == forward(faces[:, 1])
    component = surface.components
    flip = np.zeros(m, dtype=bool)
    if disagree.any():
        # one node more, joined to a face of each component: a single walk comes to them all
        roots = np.unique(component, return_index=True)[1]
        # two faces that share several edges (twins) are joined by one of them: sparse entries add up
        single = np.unique(faces[:, 0].astype(np.int64) * m + faces[:, 1], return_index=True)[1]
        row = np.concatenate((faces[single, 0], np.full(len(roots), m)))
        column = np.concatenate((faces[single, 1], roots))
        value = np.concatenate((disagree[single] + 1.0, np.ones(len(roots))))
        sign = sparse.csr_matrix((value, (row, column)), shape=(m + 1, m + 1))
        sign = (sign + sign.T).tocsr()
        order, before = csgraph.breadth_first_order(sign, m, directed=False)
        order = order[1:]
        step = np.asarray(sign[order, before[order]]).ravel() > 1.5
        turned = np.zeros(m + 1, dtype=bool)
        for face, parent, odd in zip(order, before[order], step, strict=True):
            turned[face] = turned[parent] != odd
        flip = turned[:m]
    return flip, component


def _component_volumes(vertices: Float, faces: Int, component: Int) -> Float:
    """Signed volume of each component about its own centroid (so that open shells have one too)."""
    corners = vertices[faces]
    count = np.bincount(component)
    centre = np.column_stack(
        [np.bincount(component, triples.total(corners[:, :, k]) / 3.0) / count for k in range(3)]
    )
    a, b, c = np.moveaxis(corners - centre[component][:, None, :], 1, 0)
    return np.bincount(component, triples.dot(a, triples.cross(b, c))) / 6.0


def _nesting(vertices: Float, faces: Int, component: Int, volume: Float) -> Int:
    """How many closed components each component lies in (of the 32 largest; others count none).

    A component that crosses another is not in it: `PROBES` of its vertices, far from each other in the
    file, all have to be.
    """
    depth = np.zeros(len(volume), dtype=np.int32)
    if len(volume) == 1:
        return depth
    largest = np.argsort(-np.abs(volume), kind="stable")[:32]
    shells = [vertices[faces[component == shell]] for shell in largest]
    low, high = (np.array([reach(shell, axis=(0, 1)) for shell in shells]) for reach in (np.min, np.max))
    probes = []
    for shell in shells:
        corners = shell.reshape(-1, 3)
        probes.append(corners[np.linspace(0, len(corners) - 1, PROBES).astype(int)])
    for at, shell in enumerate(shells):
        inner = np.flatnonzero(((low > low[at]) & (high < high[at])).all(axis=1))
        for probe in range(PROBES):  # the first tells most of those that are not inside
            points = np.array([probes[i][probe] for i in inner]).reshape(-1, 3)
            inner = inner[np.abs(winding_number(shell, points)) > 0.9]
        depth[largest[inner]] += 1
    return depth


def winding_number(corners: Float, points: Float) -> Float:
    """Generalized winding number of triangles (m, 3, 3) about points (k, 3), by solid angles.

    Van Oosterom & Strackee (1983); 1 inside an outward closed surface, 0 outside.
    """
    out = np.empty(len(points))
    for i, point in enumerate(points):
        a, b, c = np.moveaxis(corners - point, 1, 0)
        la, lb, lc = (triples.length(v) for v in (a, b, c))
        top = triples.dot(a, triples.cross(b, c))
        ab, bc, ca = (triples.dot(u, v) for u, v in ((a, b), (b, c), (c, a)))
        out[i] = np.arctan2(top, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2 * np.pi)
    return out
