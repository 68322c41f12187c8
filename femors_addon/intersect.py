# SPDX-License-Identifier: GPL-3.0-or-later
"""Where triangulated surfaces cross: edges that pierce faces, within one surface or between two.

Two triangles in general position cross exactly when an edge of one pierces the other. Within one
surface an edge is not tested against faces at its own ends: a pair of faces with one common corner is
decided by the edges opposite that corner, and a pair with a common edge cannot cross (one folded flat
onto the other is what `quality.flipped_faces` looks for).

Touching is not crossing: each face needs corners on both sides of the other's plane, and the edge its
ends, off it by more than the rounding of the arithmetic (`ROUNDING`). Coplanar overlap, a corner or an
edge that rests on a face, bodies in exact contact only touch; a face without area crosses nothing.
Otherwise the outline of a face belongs to it, and the two faces at an edge evaluate the same numbers
with opposite signs, so that nothing slips through between neighbours.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from . import triples
from .limits import in_threads
from .mesh import Float, Int, Surface
from .progress import Progress, silent

Index = NDArray[np.int64]

BLOCK_PAIRS, BLOCK_FACES = 300_000, 32_000
"""Pairs of faces searched together: about 15 MB; and faces, at most."""

AT_ONCE = 64_000
"""Pairs of faces looked at together: what they need stays in the processor's cache."""

ROUNDING = 16 * np.finfo(np.float64).eps
"""Heights over a plane below this share of the largest coordinate (and more for slender faces) are zero."""


@dataclasses.dataclass(frozen=True, eq=False)
class Piercings:
    """Edges of one surface that go through faces of another (or of the same).

    Attributes
    ----------
    edge : (k,) int32
        Row of `Surface.edges` of the first surface, ascending.
    face : (k,) int32
        Face of the second surface.
    t : (k,) float64
        Where along the edge, 0 at its first vertex and 1 at its second.
    """

    edge: Int
    face: Int
    t: Float

    def points(self, surface: Surface) -> Float:
        """Return the points of piercing (k, 3); `surface` is the one that the edges belong to."""
        ends = surface.vertices[surface.edges[self.edge]]
        return ends[:, 0] + self.t[:, None] * (ends[:, 1] - ends[:, 0])


def piercings(a: Surface, b: Surface) -> Piercings:
    """Find every edge of `a` that pierces a face of `b`; ``b is a`` tests a surface against itself."""
    planes_a, planes_b = Planes.of(a, b)

    def test(search: _Search) -> list[tuple[Int, Index, Float]]:
        out = []
        for pairs in search.candidates():
            f, g, f_over_g, g_over_f = straddling(planes_a, pairs[0], planes_b, pairs[1])
            row, ends, t = pierced(planes_a, f, planes_b, g, f_over_g, a is b)
            out.append((ends, g[row], t))
            if a is b:
                row, ends, t = pierced(planes_a, g, planes_a, f, g_over_f, True)
                out.append((ends, f[row], t))
        return out

    found = [(np.empty((0, 2), dtype=np.int32), np.empty(0, dtype=np.int64), np.empty(0))]
    for some in in_threads(test, _searches(a, b)):
        found += some
    ends, face, t = (np.concatenate(column) for column in zip(*found, strict=True))
    n = len(a.vertices)
    keys = a.edges[:, 0].astype(np.int64) * n + a.edges[:, 1]
    edge = np.searchsorted(keys, ends[:, 0].astype(np.int64) * n + ends[:, 1])
    # each face at the edge has found it
    _, first = np.unique(edge * len(b.faces) + face, return_index=True)
    return Piercings(edge[first].astype(np.int32), face[first].astype(np.int32), t[first])


def crossings(a: Surface, b: Surface, progress: Progress = silent) -> Int:
    """Return the pairs (k, 2) int32 (face of `a`, face of `b`) that cross, in lexicographic order.

    Only what lies where the bounding boxes overlap is looked at. With ``b is a`` each pair is given
    once, lower index first.
    """
    planes_a, planes_b = Planes.of(a, b)

    def test(search: _Search) -> Index:
        out = [np.empty((0, 2), dtype=np.int64)]
        for pairs in search.candidates():
            f, g, f_over_g, g_over_f = straddling(planes_a, pairs[0], planes_b, pairs[1])
            rows = pierced(planes_a, f, planes_b, g, f_over_g, a is b)[0]
            back = pierced(planes_b, g, planes_a, f, g_over_f, a is b)[0]
            rows = np.concatenate((rows, back))
            out.append(np.column_stack((f[rows], g[rows])))
        return np.concatenate(out)

    found = [np.empty((0, 2), dtype=np.int64)]
    for some in in_threads(test, _searches(a, b)):
        progress(0.5, "crossing faces")
        found.append(some)
    pairs = np.concatenate(found)
    if a is b:
        pairs.sort(axis=1)
    keys = np.unique(pairs[:, 0] * len(b.faces) + pairs[:, 1])
    return np.column_stack(np.divmod(keys, max(len(b.faces), 1))).astype(np.int32)


def self_intersections(surface: Surface, progress: Progress = silent) -> Int:
    """Return the pairs (k, 2) int32 of faces of a surface that cross, lower index first, in order."""
    return crossings(surface, surface, progress)


# --- the test ---------------------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True, eq=False)
class Planes:
    """Faces as planes, with the height (m,) below which a point counts as lying in each."""

    faces: Int
    vertices: Float
    corners: Float
    planes: Float  # (m, 6) first corner and unit normal
    tolerance: Float

    @classmethod
    def of(cls, *surfaces: Surface) -> list[Planes]:
        scale = max((float(np.abs(s.vertices).max()) for s in surfaces if len(s.vertices)), default=0.0)
        out: list[Planes] = []
        for s in surfaces:
            if out and s is surfaces[0]:
                out.append(out[0])
                continue
            corners = s.corners
            longest = triples.longest_squared(corners)
            area = 2.0 * s.face_areas
            # a face without area has no plane: nothing is ever off it
            tolerance = np.full(len(area), np.inf)
            np.divide(ROUNDING * scale * longest, area, out=tolerance, where=area > 0)
            planes = np.concatenate((corners[:, 0], s.face_normals), axis=1)
            out.append(cls(s.faces, s.vertices, corners, planes, tolerance))
        return out


def straddling(one: Planes, f: Index, two: Planes, g: Index) -> tuple[Index, Index, Float, Float]:
    """Keep the pairs (f, g) of faces that each have corners on both sides of the other's plane.

    Returns (f, g, heights (k, 3) of the corners of f over g, heights (k, 3) of those of g over f).
    """
    over = _heights(one, f, two, g)
    rows = np.flatnonzero(_both_sides(over, two.tolerance[g]))
    f, g = f[rows], g[rows]
    back = _heights(two, g, one, f)
    kept = np.flatnonzero(_both_sides(back, one.tolerance[f]))
    forth = np.column_stack([height[rows[kept]] for height in over])
    return f[kept], g[kept], forth, np.column_stack([height[kept] for height in back])


def _heights(one: Planes, f: Index, two: Planes, g: Index) -> list[Float]:
    """Heights of the three corners of each face f over the plane of the face g beside it."""
    points = np.ascontiguousarray(one.corners.reshape(-1, 9).take(f, axis=0).T)
    x, y, z, nx, ny, nz = np.ascontiguousarray(two.planes.take(g, axis=0).T)
    return [(points[k] - x) * nx + (points[k + 1] - y) * ny + (points[k + 2] - z) * nz for k in (0, 3, 6)]


def _both_sides(heights: list[Float], tolerance: Float) -> NDArray[np.bool_]:
    return (np.minimum.reduce(heights) < -tolerance) & (np.maximum.reduce(heights) > tolerance)


def pierced(
    one: Planes, f: Index, two: Planes, g: Index, height: Float, same: bool
) -> tuple[Index, Int, Float]:
    """Test the edges of each face f, its corners at heights (p, 3), against the face g beside it.

    Returns (row of the pair, (k, 2) vertices of the edge, t along it) of the edges that pierce.
    """
    tolerance = two.tolerance[g, None]
    above, below = height > tolerance, height < -tolerance
    row, side = np.nonzero((above & below[:, [1, 2, 0]]) | (below & above[:, [1, 2, 0]]))
    start, stop = height[row, side], height[row, (side + 1) % 3]
    ends = np.column_stack((one.faces[f[row], side], one.faces[f[row], (side + 1) % 3]))
    # both faces at the edge have to see the very same numbers: lower vertex first
    swap = ends[:, 0] > ends[:, 1]
    ends[swap] = ends[swap, ::-1]
    t = np.where(swap, stop, start) / np.where(swap, stop - start, start - stop)
    u = one.vertices[ends[:, 0]]
    along, corners = one.vertices[ends[:, 1]] - u, two.corners[g[row]] - u[:, None]
    # signed volumes of (edge, side of the face): exactly negated when seen from the face beyond the side
    volumes = [triples.dot(along, triples.cross(corners[:, i], corners[:, (i + 1) % 3])) for i in range(3)]
    inside = (np.min(volumes, axis=0) >= 0) | (np.max(volumes, axis=0) <= 0)
    if same:
        inside &= ~(two.faces[g[row]][:, :, None] == ends[:, None, :]).any(axis=(1, 2))
    return row[inside], ends[inside], t[inside]


# --- candidates -------------------------------------------------------------------------------------
def _searches(a: Surface, b: Surface) -> Iterator[_Search]:
    """Yield the parts of the search for pairs (face of a, face of b) whose enclosing balls overlap.

    Balls are searched octave of size by octave of size, so that one large face does not widen the
    search of a million small ones. With ``b is a`` each pair is met once.
    """
    faces_a, faces_b = np.arange(len(a.faces)), np.arange(len(b.faces))
    if len(faces_a) and len(faces_b) and a is not b:
        low, high = np.maximum(a.bounds[0], b.bounds[0]), np.minimum(a.bounds[1], b.bounds[1])
        faces_a, faces_b = _within(a.corners, low, high), _within(b.corners, low, high)
    if not len(faces_a) or not len(faces_b):
        return
    classes_a = size_classes(a, faces_a)
    classes_b = classes_a if a is b else size_classes(b, faces_b)
    for i, one in enumerate(classes_a):
        for two in classes_b[i:] if a is b else classes_b:
            if one is two:
                yield from _meetings(one)
            else:
                yield from (_Search(one, two, part, slice(None)) for part in _parts(one, two))


def _within(corners: Float, low: Float, high: Float) -> Index:
    """Indices of the faces (m, 3, 3) whose bounding box reaches into a box."""
    return np.flatnonzero(
        triples.every((triples.least(corners) <= high) & (triples.greatest(corners) >= low))
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Balls:
    """Enclosing balls of about one size: tree of their centres, radii, and the face of each."""

    tree: cKDTree
    radius: Float
    face: Index


@dataclasses.dataclass(frozen=True, eq=False)
class _Search:
    """Some balls of one class against some of another, by their places in the order of their trees.

    The same places of the same class: each pair of them once.
    """

    one: Balls
    two: Balls
    part: slice
    other: slice

    def candidates(self) -> Iterator[tuple[Index, Index]]:
        """Yield pairs (face, face) of balls that overlap, `AT_ONCE` at a time."""
        one, two = self.one, self.two
        reach = _reach(one, two)
        f, g = one.tree.indices[self.part], two.tree.indices[self.other]
        if one is two and self.part == self.other:
            centre = one.tree.data[f]
            pairs = cKDTree(centre, balanced_tree=False).query_pairs(reach, output_type="ndarray")
            first, second = pairs[:, 0], pairs[:, 1]
            apart = triples.squared(centre.take(first, axis=0) - centre.take(second, axis=0))
            yield from self._near(f[first], f[second], np.sqrt(apart))
            return
        g = _beside(two, g, triples.box(one.tree.data[f]), reach)
        if len(g):
            f = _beside(one, f, triples.box(two.tree.data[g]), reach)
        if len(f) and len(g):
            here, there = (cKDTree(b.tree.data[at], balanced_tree=False) for b, at in ((one, f), (two, g)))
            pairs = here.sparse_distance_matrix(there, reach, output_type="ndarray")
            yield from self._near(f[pairs["i"]], g[pairs["j"]], pairs["v"])

    def _near(self, f: Index, g: Index, apart: Float) -> Iterator[tuple[Index, Index]]:
        """Yield the faces of the balls (f, g), so far apart, that overlap."""
        near = np.flatnonzero(apart <= (self.one.radius[f] + self.two.radius[g]) * (1 + 1e-9))
        f, g = self.one.face[f[near]], self.two.face[g[near]]
        for start in range(0, len(f), AT_ONCE):
            yield f[start : start + AT_ONCE], g[start : start + AT_ONCE]


def _beside(balls: Balls, some: Index, box: tuple[Float, Float], reach: float) -> Index:
    """Keep those of some balls whose centres are within reach of a box."""
    centre = balls.tree.data.take(some, axis=0)
    close = triples.every(centre >= box[0] - reach)
    close &= triples.every(centre <= box[1] + reach)
    return some[close]


def _meetings(balls: Balls) -> Iterator[_Search]:
    """Search a class in itself: each part, and each two parts that are near each other."""
    parts, reach = _parts(balls, balls), _reach(balls, balls)
    boxes = [triples.box(balls.tree.data[balls.tree.indices[part]]) for part in parts]
    low, high = (np.array(corners) for corners in zip(*boxes, strict=True))
    for i, part in enumerate(parts):
        yield _Search(balls, balls, part, part)
        near = triples.every(low[i + 1 :] <= high[i] + reach) & triples.every(high[i + 1 :] >= low[i] - reach)
        for j in np.flatnonzero(near) + i + 1:
            yield _Search(balls, balls, part, parts[j])


def _reach(one: Balls, two: Balls) -> float:
    """Distance between centres beyond which no two balls of these overlap."""
    return float(one.radius.max() + two.radius.max()) * (1 + 1e-9)


def _parts(one: Balls, two: Balls) -> list[slice]:
    """Cut the search of one class against another into parts of some `BLOCK_PAIRS` or `BLOCK_FACES`."""
    order, stride = one.tree.indices, 32
    sample = two.tree.query_ball_point(one.tree.data[order[::stride]], _reach(one, two), return_length=True)
    cost = np.maximum(np.asarray(sample) / BLOCK_PAIRS, 1.0 / BLOCK_FACES)
    block = np.cumsum(cost * stride).astype(np.int64)
    cuts = [0, *((np.flatnonzero(np.diff(block)) + 1) * stride).tolist(), len(order)]
    return [slice(start, stop) for start, stop in itertools.pairwise(cuts)]


def size_classes(surface: Surface, faces: Index) -> list[Balls]:
    """Sort the enclosing balls of some faces by octaves of size."""
    centre, radius, owner = _pieces(surface.vertices.take(surface.faces[faces], axis=0), faces)
    # below a thousandth of the usual size all are one class, and most of an even mesh are of one
    smallest = max(float(np.median(radius)) * 1.25 * 2.0**-10, float(radius.max()) * 2.0**-30)
    octave = np.zeros(len(radius), dtype=np.int64)
    if smallest > 0:
        octave = np.ceil(np.log2(np.maximum(radius, smallest) / smallest)).astype(np.int64)
    classes = []
    for level in np.unique(octave):
        rows = np.flatnonzero(octave == level)
        classes.append(Balls(cKDTree(centre[rows], balanced_tree=False), radius[rows], owner[rows]))
    return classes


def _pieces(corners: Float, owner: Index) -> tuple[Float, Float, Index]:
    """Enclosing balls of faces (m, 3, 3): (centres, radii, owner of each).

    The ball of a long thin face holds much that is not near it: faces larger than the usual are
    halved, the largest first, until there are some times as many pieces as faces.
    """
    centre, radius = enclosing_balls(corners)
    usual, budget = 2.0 * float(np.median(radius)), 3 * len(corners) + 1000
    while True:
        large = radius > max(usual, 0.5 * float(radius.max()))
        if not large.any() or len(radius) > budget:
            return centre, radius, owner
        halves = _halved(corners[large])
        new_centre, new_radius = enclosing_balls(halves)
        corners = np.concatenate((corners[~large], halves))
        centre = np.concatenate((centre[~large], new_centre))
        radius = np.concatenate((radius[~large], new_radius))
        owner = np.concatenate((owner[~large], np.tile(owner[large], 2)))


def enclosing_balls(corners: Float) -> tuple[Float, Float]:
    """Return centres (m, 3) and radii (m,) of balls around faces (m, 3, 3)."""
    centre = (corners[:, 0] + corners[:, 1] + corners[:, 2]) / 3.0
    radius = triples.squared(corners[:, 0] - centre)
    for i in (1, 2):
        np.maximum(radius, triples.squared(corners[:, i] - centre), out=radius)
    return centre, np.sqrt(radius)


def _halved(corners: Float) -> Float:
    """Cut each face (m, 3, 3) at the middle of its longest side: first halves, then second halves."""
    rows = np.arange(len(corners))
    sides = [corners[:, (i + 1) % 3] - corners[:, i] for i in range(3)]
    start = np.argmax([triples.dot(side, side) for side in sides], axis=0)
    stop = (start + 1) % 3
    middle = 0.5 * (corners[rows, start] + corners[rows, stop])
    one, two = corners.copy(), corners.copy()
    one[rows, stop], two[rows, start] = middle, middle
    return np.concatenate((one, two))
