# SPDX-License-Identifier: GPL-3.0-or-later
"""The volume that two closed surfaces share, as a sum over their faces: no mesh of what is shared is made.

A volume is a sum over its boundary (divergence theorem). The boundary of what is shared is the parts of each
surface's faces inside the other, and such a part is a polygon: pieces of the face's sides, and the
segments in which other faces cross it. Which corners are inside is known from how often sides come and go.
All are array operations, which let other threads run: a library that makes the mesh keeps them waiting.

Surfaces that touch (the very same vertices, faces in one plane) are nothing special: each vertex is shifted
by some roundings of its coordinates, so that they cross or do not, and the signs of determinants are exact.
So each segment has two ends, and all ways to a vertex agree (Edelsbrunner and Muecke 1990 shift by symbols).
"""

from __future__ import annotations

import dataclasses
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from . import triples
from .balls import AT_ONCE, Index, Search, searches
from .crew import over
from .cutouts import Region, reaching
from .mesh import Float, Surface, connected

SHIFT = 512 * np.finfo(np.float64).eps  # of the largest coordinate: 1e-13
DOUBT = 8 * np.finfo(np.float64).eps  # of a determinant's terms: more than rounding does to it
NEXT = [1, 2, 0]


class _TangledError(Exception):
    """The sums do not fit together: a surface is open, or has faces of two corners."""


def shift(surface: Surface) -> float:
    """Return how far the coordinates of a surface are shifted, at most."""
    return float(SHIFT * np.abs(surface.vertices).max(initial=0.0))


def shifted(surface: Surface, seed: int) -> Surface:
    """Return a surface with its vertices shifted a little, always in the same way."""
    size = shift(surface)
    noise = np.random.default_rng(seed).uniform(-size, size, surface.vertices.shape)
    return surface.moved(surface.vertices + noise)


def inside(
    surfaces: tuple[Surface, Surface],
    chosen: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    origin: Float,
    box: tuple[Float, Float] | None = None,
) -> float | None:
    """Return the sum of signed volumes between an origin (3,) and what of some faces is inside the other.

    With all faces that reach into a `box` that holds all that is shared, that is the volume shared, wherever
    the origin is. Without a box other faces may be where the chosen ones are, and are looked for.

    None where the surfaces are not closed, as far as that matters.
    """
    one, two = (shifted(surface, seed) for seed, surface in enumerate(surfaces))
    a, b = (_Part.of(s, mask, origin) for s, mask in zip((one, two), chosen, strict=True))
    try:
        _meet(a, b)
        if box is None:
            for part, whole, mask in ((a, two, chosen[1]), (b, one, chosen[0])):
                near = reaching(whole, *part.surface.bounds) & ~mask
                if near.any():
                    _meet(part, _Part.of(whole, near, origin))
        return a.sum(two, box) + b.sum(one, box)
    except _TangledError:
        return None


def below(surface: Surface, chosen: NDArray, origin: Float) -> float:
    """Return the sum of signed volumes between an origin (3,) and some faces."""
    part = _Part.of(surface, chosen, origin)
    return float(part.whole().sum() / 6.0)


@dataclasses.dataclass(frozen=True, eq=False)
class _Part:
    """Some faces of a surface, and what is known of them against the other.

    Attributes
    ----------
    leaves : (m, 3) float64
        How often each side of a face leaves the other surface, less how often it enters.
    along : (m, 3) float64
        The places of these along the side, from 0 to 1, added up with the same signs.
    cut : (m,) float64
        Six times the volume below the segments in which the face is cut.
    """

    surface: Surface
    origin: Float
    leaves: Float
    along: Float
    cut: Float

    @classmethod
    def of(cls, surface: Surface, chosen: NDArray, origin: Float) -> _Part:
        part = Region.cut(surface, chosen).surface
        m = len(part.faces)
        return cls(part, origin, np.zeros((m, 3)), np.zeros((m, 3)), np.zeros(m))

    def below(self, start: Float, stop: Float, face: Index) -> Float:
        """Six times the volumes (k,) between the origin, segments, and the first corners of their faces."""
        first = self.surface.vertices[self.surface.faces[face, 0]]
        return triples.dot(start - self.origin, triples.cross(stop - self.origin, first - self.origin))

    def add(self, ends: _Ends, face: Index, start: Float, stop: Float) -> None:
        """Take in where sides pierce the other surface, and the segments in faces."""
        place = ends.face * 3 + ends.side
        m = len(self.cut)
        self.leaves.ravel()[:] += np.bincount(place, ends.sign, 3 * m)
        self.along.ravel()[:] += np.bincount(place, ends.sign * ends.along, 3 * m)
        self.cut[:] += np.bincount(face, self.below(start, stop, face), m)

    def sum(self, other: Surface, box: tuple[Float, Float] | None) -> float:
        """The sum over all faces, of what of them is inside the other surface."""
        if not len(self.surface.faces):
            return 0.0
        turns = self._turns(other, box)
        # sides that begin or end at the first corner have nothing below them
        length = turns[self.surface.faces[:, 2]] + self.along[:, 1]
        return float((length * self.whole() + self.cut).sum() / 6.0)

    def whole(self) -> Float:
        """Six times the volumes (m,) between the origin and the faces."""
        second, third = (self.surface.vertices[self.surface.faces[:, k]] for k in (1, 2))
        return self.below(second, third, np.arange(len(second)))

    def _turns(self, other: Surface, box: tuple[Float, Float] | None) -> Float:
        """How many times the other surface goes around each vertex (n,): once where that is inside."""
        faces, vertices = self.surface.faces, self.surface.vertices
        low, high = other.bounds if box is None else box
        start, stop, change = faces.ravel(), faces[:, NEXT].ravel(), -self.leaves.ravel()
        same = change == 0
        label = connected(np.column_stack((start[same], stop[same])), len(vertices))
        turns = np.full(int(label.max()) + 1, np.nan)
        turns[label[triples.some((vertices < low) | (vertices > high))]] = 0.0
        a, b, change = label[start[~same]], label[stop[~same]], change[~same]
        while True:
            for here, there, step in ((a, b, change), (b, a, -change)):
                new = ~np.isnan(turns[here]) & np.isnan(turns[there])
                turns[there[new]] = turns[here[new]] + step[new]
            unknown = np.isnan(turns)
            if not unknown.any():
                break
            if not (np.isnan(turns[a]) != np.isnan(turns[b])).any():
                row = int(np.argmax(unknown[label]))
                turns[label[row]] = _around(vertices[row], other)
        if (turns[a] + change != turns[b]).any():
            raise _TangledError
        return np.asarray(turns[label])


def _around(point: Float, surface: Surface) -> float:
    """How many times a closed surface goes around a point: by the faces on a straight way out of it."""
    if len(rim(surface)):
        raise _TangledError
    low, high = np.append(point[:2], point[2]), np.append(point[:2], np.inf)
    corners = surface.vertices[surface.faces[reaching(surface, low, high)]]
    far = np.append(point[:2], surface.bounds[1][2] + surface.diagonal)
    start, stop = np.broadcast_to(point, (len(corners), 3)), np.broadcast_to(far, (len(corners), 3))
    here, there = _over(corners, start) > 0, _over(corners, stop) > 0
    through = _through(start, stop, corners)
    return float((through & there).sum()) - float((through & here).sum())


def rim(surface: Surface) -> Index:
    """Return the edges (k, 2) that faces run along more often this way than the other; none: it is closed."""
    faces = surface.faces
    if 2 * len(surface.edge_faces[0]) == faces.size and not surface.opposed_edges.any():
        return np.empty((0, 2), dtype=np.int64)
    one, two = faces.ravel().astype(np.int64), faces[:, NEXT].ravel().astype(np.int64)
    count = len(surface.vertices)
    keys, which = np.unique(np.minimum(one, two) * count + np.maximum(one, two), return_inverse=True)
    net = np.bincount(which, np.where(one < two, 1.0, -1.0)).astype(np.int64)
    edges = np.column_stack(np.divmod(keys, count))
    edges[net < 0] = edges[net < 0, ::-1]
    return np.repeat(edges, np.abs(net), axis=0)


# --- pairs of faces -------------------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True, eq=False)
class _Ends:
    """Where sides of faces pierce faces: (k,) row of the pair, face and side; 1 out, -1 in; place; point."""

    row: Index
    face: Index
    side: Index
    sign: Float
    along: Float
    point: Float


def _meet(a: _Part, b: _Part) -> None:
    """Find where two parts cross, for both."""
    corners = a.surface.corners, b.surface.corners

    def test(search: Search) -> Index:
        out = [np.empty((0, 2), dtype=np.int64)]
        for f, g in search.candidates():
            kept = np.flatnonzero(_straddles(_heights(corners[0][f], corners[1][g])))
            f, g = f[kept], g[kept]
            kept = np.flatnonzero(_straddles(_heights(corners[1][g], corners[0][f])))
            out.append(np.column_stack((f[kept], g[kept])))
        return np.concatenate(out)

    found = [np.empty((0, 2), dtype=np.int64), *over(test, searches(a.surface, b.surface))]
    # large faces are met once for each of their pieces
    keys = np.unique(np.concatenate(found) @ (len(b.cut), 1))
    for first in range(0, len(keys), AT_ONCE):
        f, g = np.divmod(keys[first : first + AT_ONCE], len(b.cut))
        ends, back, row, start, stop = _segments(a, f, b, g)
        a.add(ends, f[row], start, stop)
        b.add(back, g[row], stop, start)


def _segments(a: _Part, f: Index, b: _Part, g: Index) -> tuple[_Ends, _Ends, Index, Float, Float]:
    """Return where sides of faces f pierce g, those of g pierce f, and segments (row of pair, start, stop).

    With what is inside the other surface on its left, a segment runs from start to stop in f, and back in g.
    """
    c, d = a.surface.corners[f], b.surface.corners[g]
    ends, others = _ends(a.surface.faces, f, c, d), _ends(b.surface.faces, g, d, c)
    row = np.concatenate((ends.row, others.row))
    sign = np.concatenate((ends.sign, -others.sign))
    point = np.concatenate((ends.point, others.point))
    order = np.lexsort((-sign, row))
    row, sign, point = row[order], sign[order], point[order]
    if len(row) % 2 or (row[::2] != row[1::2]).any() or (sign[::2] != 1).any() or (sign[1::2] != -1).any():
        raise _TangledError
    return ends, others, row[::2], point[::2], point[1::2]


def _ends(faces: NDArray, f: Index, corners: Float, others: Float) -> _Ends:
    """Find which sides of faces f, with corners (p, 3, 3), pierce the triangles (p, 3, 3) beside them."""
    height = _heights(corners, others)
    out = height > 0
    row, side = np.nonzero(out != out[:, NEXT])
    after = (side + 1) % 3
    start, stop = corners[row, side], corners[row, after]
    hit = np.flatnonzero(_through(start, stop, others[row]))
    row, side, after, start, stop = row[hit], side[hit], after[hit], start[hit], stop[hit]
    here, there = np.abs(height[row, side]), np.abs(height[row, after])
    # both faces at a side have to come to the very same point: lower vertex first
    swap = faces[f[row], side] > faces[f[row], after]
    share = np.where(swap, there, here) / (here + there)
    low, high = np.where(swap[:, None], stop, start), np.where(swap[:, None], start, stop)
    return _Ends(
        row=row,
        face=f[row],
        side=side,
        sign=np.where(out[row, side], -1.0, 1.0),
        along=np.where(swap, 1.0 - share, share),
        point=low + share[:, None] * (high - low),
    )


def _through(start: Float, stop: Float, corners: Float) -> NDArray[np.bool_]:
    """Whether the lines (k) of which two points are given go through the triangles (k, 3, 3) beside them."""
    left = [_volumes(start, stop, corners[:, i], corners[:, NEXT[i]]) > 0 for i in range(3)]
    out: NDArray[np.bool_] = (left[0] == left[1]) & (left[1] == left[2])
    return out


def _heights(corners: Float, others: Float) -> Float:
    """See `_over`, for the corners of triangles (k, 3, 3): (k, 3)."""
    return np.column_stack([_over(others, corners[:, k]) for k in range(3)])


def _straddles(heights: Float) -> NDArray[np.bool_]:
    """Whether corners at heights (k, 3) are on both sides."""
    return (triples.least(heights) < 0) & (triples.greatest(heights) > 0)


def _over(corners: Float, points: Float) -> Float:
    """Positive for points (k, 3) on the outer side of the triangles (k, 3, 3) beside them, else negative."""
    return -_volumes(corners[:, 0], corners[:, 1], corners[:, 2], points)


def _volumes(a: Float, b: Float, c: Float, d: Float) -> Float:
    """Six times the signed volumes (k,) of tetrahedra; the sign is exact."""
    u, v, w = a - d, b - d, c - d
    out = triples.dot(u, triples.cross(v, w))
    doubtful = np.flatnonzero(
        np.abs(out) <= DOUBT * triples.length(u) * triples.length(v) * triples.length(w)
    )
    u, v, w = (np.abs(rows[doubtful]) for rows in (u, v, w))
    terms = triples.dot(u, triples.cross(v, w) + 2.0 * v[:, [2, 0, 1]] * w[:, NEXT])
    for row in doubtful[np.abs(out[doubtful]) <= DOUBT * terms]:
        x, y, z, o = ([Fraction(float(value)) for value in points[row]] for points in (a, b, c, d))
        p, q, r = ([s - t for s, t in zip(point, o, strict=True)] for point in (x, y, z))
        out[row] = float(
            p[0] * (q[1] * r[2] - q[2] * r[1])
            + p[1] * (q[2] * r[0] - q[0] * r[2])
            + p[2] * (q[0] * r[1] - q[1] * r[0])
        )
    return out
