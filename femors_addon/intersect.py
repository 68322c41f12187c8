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

import numpy as np
from numpy.typing import NDArray

from . import triples
from .balls import Balls, Index, Search, overlapping, searches, size_classes
from .crew import at_once, over
from .mesh import Float, Int, Surface
from .progress import Progress, silent

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
    (planes_a, planes_b), parts = at_once(lambda _: Planes.of(a, b), lambda _: searches(a, b))

    def test(search: Search) -> list[tuple[Int, Index, Float]]:
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
    for some in over(test, parts):
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
    (planes_a, planes_b), parts = at_once(lambda _: Planes.of(a, b), lambda _: searches(a, b))

    def test(search: Search) -> Index:
        out = [np.empty((0, 2), dtype=np.int64)]
        out += [_crossing(planes_a, f, planes_b, g, a is b) for f, g in search.candidates()]
        return np.concatenate(out)

    found = [np.empty((0, 2), dtype=np.int64)]
    for some in over(test, parts):
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


def crossings_of(surface: Surface, some: Index, balls: list[Balls]) -> Int:
    """Return the pairs (k, 2) int32 of a surface's faces that cross, of which one or both are of some faces.

    They are what `self_intersections` gives. `balls` are those of all faces, or of where these were before
    the chosen ones moved.
    """
    if not len(some):
        return np.empty((0, 2), dtype=np.int32)
    chosen = np.zeros(len(surface.faces), dtype=bool)
    chosen[some] = True
    own = size_classes(surface, np.flatnonzero(chosen))
    f, g = overlapping(balls, own)
    other = ~chosen[f]
    one, two = overlapping(own, own)
    once = one < two
    pairs = np.stack((np.concatenate((f[other], one[once])), np.concatenate((g[other], two[once]))))
    pairs.sort(axis=0)
    near = np.flatnonzero(np.bincount(pairs.ravel(), minlength=len(surface.faces)))
    planes = Planes.of(Surface(surface.vertices, surface.faces[near]))[0]
    f, g = np.searchsorted(near, pairs)
    rows = _crossing(planes, f, planes, g, True)
    keys = np.unique(near[rows[:, 0]] * len(surface.faces) + near[rows[:, 1]])
    return np.column_stack(np.divmod(keys, max(len(surface.faces), 1))).astype(np.int32)


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
            corners, longest = s.corners, s.told(triples.longest_side)
            area = 2.0 * s.face_areas
            # a face without area has no plane: nothing is ever off it
            tolerance = np.full(len(area), np.inf)
            np.divide(ROUNDING * scale * longest, area, out=tolerance, where=area > 0)
            planes = np.concatenate((corners[:, 0], s.face_normals), axis=1)
            out.append(cls(s.faces, s.vertices, corners, planes, tolerance))
        return out


def _crossing(one: Planes, f: Index, two: Planes, g: Index, same: bool) -> Index:
    """Return those (k, 2) of the pairs (f, g) of faces that cross; some twice."""
    f, g, f_over_g, g_over_f = straddling(one, f, two, g)
    rows = pierced(one, f, two, g, f_over_g, same)[0]
    back = pierced(two, g, one, f, g_over_f, same)[0]
    rows = np.concatenate((rows, back))
    return np.column_stack((f[rows], g[rows]))


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
