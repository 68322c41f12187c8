# SPDX-License-Identifier: GPL-3.0-or-later
"""One body against another: gaps of its nodes, and of places on its edges, over the other's surface."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from . import triples
from .bodies import Solid
from .cached import cached_property
from .cutouts import Region
from .meeting import Pierced
from .mesh import Float, Int, Surface
from .nearest import SurfaceIndex

FACING = -0.2  # cosine between a node's own normal and its way out, above which it leaves by the wrong side
BESIDE = 2.5  # mean edges: how far a neighbour may be whose way out is taken over
SAME = 0.1  # of an edge: places on it that are closer to each other are one
FLAT = 1e-7  # of the coordinates' size: below this distance the way out is the surface's normal


@dataclasses.dataclass(frozen=True, eq=False)
class Contacts:
    """Places where one body is too near the other.

    Attributes
    ----------
    points : (k, 3) float64
        Where they are.
    ways : (k, 3) float64
        Unit vectors along which the *first* body of the pair, against the second, comes free.
    gaps : (k,) float64
        Signed distances; negative inside.
    pushed : (k,) float64
        How far the bodies have already been pushed apart here, along the way.
    """

    points: Float
    ways: Float
    gaps: Float
    pushed: Float

    @classmethod
    def joined(cls, *parts: Contacts) -> Contacts:
        """Return some as one."""
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in dataclasses.fields(cls)))


class Side:
    """The nodes of one body's surface, and places on its edges, against the other's surface."""

    def __init__(self, body: Solid, other: Solid, sign: float) -> None:
        count = len(body.corner)
        self.body, self.other, self.sign = body, other, sign
        self.bound = np.full(count, -np.inf)  # no gap is smaller than this
        self.found = _Gaps.none(count)
        self.wrong: NDArray[np.bool_] = np.zeros(count, dtype=bool)  # would leave by the wrong side
        self.ever: NDArray[np.bool_] = np.zeros(count, dtype=bool)  # was too near once
        self.ends = np.zeros((0, 2), dtype=np.int32)  # edges that were found to pierce, by vertex
        self.along = np.zeros(0)  # and where on them, from 0 to 1
        self.on_edges = _Gaps.none(0)
        self.shift = self.frame = np.zeros(3)
        self._near: _Near | None = None  # the other's faces that were within reach of what was measured last

    def look(self, reach: float, least: float = np.inf) -> None:
        """Measure gaps as `Pair.look` does, this body being shifted."""
        shift = self.shift
        rows = np.flatnonzero((self.bound < min(reach, least)) | (self.ever & (self.bound < reach)))
        self.found.gaps[rows] = np.inf
        low, high = self.other.surface.bounds
        points = self.body.vertices[rows] + shift
        # beyond the other's box by more than the reach: the box alone tells
        outside = np.maximum(np.maximum(low - points, points - high), 0.0)
        far = triples.length(outside)
        near = far < reach
        self.bound[rows[~near]] = far[~near]
        rows, points = rows[near], points[near]
        edges = self.between(self.body.vertices) + shift
        self._near = None
        if not len(rows) and not len(edges):
            return
        lowest = float(self.bound[rows].min(initial=0.0))
        span = reach + max(0.0, -lowest)
        every = np.concatenate((points, edges))
        self._near = _Near.of(self.other.surface, every, span)
        if self._near.empty:
            self.bound[rows] = span
            self._near = _Near.of(self.other.surface, edges, np.inf) if len(edges) else None
            if self._near is None:
                return
        all_gaps = self._measured(every, self._near)
        gaps, on_edges = all_gaps.at(slice(len(rows))), all_gaps.at(slice(len(rows), None))
        self._widen(edges, on_edges, np.abs(on_edges.gaps))
        # farther than the region is wide, the side is not to be trusted; but such a node is not inside
        self.found.put(rows, dataclasses.replace(gaps, gaps=_outside(gaps.gaps, span)))
        self.bound[rows] = np.minimum(self.found.gaps[rows], span)
        own = self.body.normals(rows)
        self.wrong[rows] = np.einsum("ij,ij->i", own, gaps.ways) > FACING
        near = on_edges.gaps < reach  # places that are far off by now may be forgotten
        self.ends, self.along, self.on_edges = self.ends[near], self.along[near], on_edges.at(near)

    def rest(self) -> None:
        """Let go of the search structure."""
        self._near = None

    def between(self, values: Float) -> Float:
        """Return what a quantity of the vertices is at the places on edges."""
        one, two = values[self.ends[:, 0]], values[self.ends[:, 1]]
        return one + self.along[:, None] * (two - one)

    def _measured(self, points: Float, near: _Near) -> _Gaps:
        """Measure the gaps of points, shifted as they are, to the faces that are near."""
        surface, vertex = near.region.surface, near.region.vertex
        found = near.index.closest(points)
        normal = near.index.pseudonormals(found)
        apart = points - found.point
        inside = np.einsum("ij,ij->i", apart, normal) < 0
        corners = surface.faces[found.face]
        if self.other.open_edges:  # beside an open border there is no inside
            inside &= ~triples.every(
                self.other.begun_surface.border[vertex][corners] | (found.barycentric <= 1e-12)
            )
        gaps = np.where(inside, -found.distance, found.distance)
        flat = found.distance <= FLAT * float(np.abs(surface.vertices).max(initial=0.0))
        ways = np.divide(apart, gaps[:, None], out=normal.copy(), where=~flat[:, None])
        moved = self.other.displacement[vertex][corners]
        return _Gaps(gaps, ways, np.einsum("pk,pkc->pc", found.barycentric, moved))

    def _widen(self, points: Float, gaps: _Gaps, far: Float) -> None:
        """Measure those points anew, of none farther than `far` (k,), to which faces beyond may be nearer."""
        rows = np.arange(len(points)) if self._near is None else self._near.beyond(points, far)
        if len(rows):
            near = _Near.of(self.other.surface, points[rows], float(far[rows].max()) * (1.0 + 1e-9))
            gaps.put(rows, self._measured(points[rows], near))

    def deepest(self, strict: bool) -> float:
        """Return the smallest gap."""
        nodes = self.found.gaps if strict else np.where(self.wrong, np.inf, self.found.gaps)
        return float(min(nodes.min(initial=np.inf), self.on_edges.gaps.min(initial=np.inf)))

    def contacts(self, target: float, strict: bool) -> Contacts:
        """Return the nodes that are, or were, closer than `target`, and the places on edges."""
        low = self.found.gaps < target
        known = (low | self.ever) & ~self.wrong & np.isfinite(self.found.gaps)
        wrong, extended = self._extended(np.flatnonzero(low & self.wrong), np.flatnonzero(known))
        asked = extended.gaps < target  # others leave by the wrong side, or not at all
        wrong, extended = wrong[asked], extended.at(asked)
        low &= ~self.wrong | strict
        low[wrong] = False
        self.ever |= low
        self.ever[wrong] = True
        back = self.ever & np.isfinite(self.found.gaps) & ~self.wrong
        back[wrong] = False
        rows = np.flatnonzero(low | back)
        displacement = self.body.displacement
        gaps = _Gaps.joined(_Gaps.joined(self.found.at(rows), extended), self.on_edges)
        rows = np.concatenate((rows, wrong))
        own = np.concatenate((displacement[rows], self.between(displacement)))
        points = np.concatenate((self.body.vertices[rows], self.between(self.body.vertices)))
        pushed = np.einsum("ij,ij->i", gaps.ways, own - gaps.feet)
        return Contacts(points + self.frame, self.sign * gaps.ways, gaps.gaps, pushed)

    def _extended(self, wrong: Int, right: Int) -> tuple[Int, _Gaps]:
        """Give nodes that would leave by the wrong side the way of a neighbour that would not.

        On a rim the other surface's closest face is often one beside it. The face that the neighbour is
        before is taken for a plane; nodes with no neighbour within `BESIDE` edges are left out.
        """
        if not len(wrong) or not len(right):
            return wrong[:0], _Gaps.none(0)
        points = self.body.vertices
        far, nearest = cKDTree(points[right]).query(points[wrong])
        beside = far < BESIDE * self.body.edge
        wrong, guide = wrong[beside], self.found.at(right[nearest[beside]])
        along = np.einsum("ij,ij->i", points[wrong] - points[right[nearest[beside]]], guide.ways)
        return wrong, _Gaps(guide.gaps + along, guide.ways, guide.feet)

    def beyond(self, share: float) -> bool:
        """Whether no node is within a share of the longest edge of the other surface."""
        return bool(self.bound.min() > share * self.body.longest_now)

    def pierced(self, found: Pierced) -> int:
        """Keep a place on each of the edges that pierce the other surface; return how many do."""
        if not len(found.t):
            return 0
        # the middles between one piercing and the next along an edge, its ends counting too where they are
        # inside; those of parts outside do no harm
        line = found.ends[:, 0].astype(np.int64) * len(self.body.corner) + found.ends[:, 1]
        order = np.lexsort((found.t, line))
        edge, t, ends = line[order], found.t[order], found.ends[order]
        inside = self.found.gaps[ends] < 0
        first = np.append(True, edge[1:] != edge[:-1])
        last = np.append(first[1:], True)
        starts = first & inside[:, 0]
        stops = last & inside[:, 1]
        within = ~last
        along = (0.5 * t[starts], 0.5 * (t[within] + t[1:][within[:-1]]), 0.5 * (1.0 + t[stops]))
        half = (0.5 * t[starts], 0.5 * (t[1:][within[:-1]] - t[within]), 0.5 * (1.0 - t[stops]))
        chosen = (ends[starts], ends[within], ends[stops])
        self._keep(*(np.concatenate(values) for values in (chosen, along, half)))
        return int(first.sum())

    def _keep(self, ends: Int, along: Float, half: Float) -> None:
        """Add places on edges, unless one is kept close by that is itself inside.

        Of the edge, as much as `half` (k,) lies between a place and where it pierces the other surface.
        """
        count = len(self.body.corner)
        line = [e[:, 0].astype(np.int64) * count + e[:, 1] for e in (self.ends, ends)]
        _, rank = np.unique(np.concatenate(line), return_inverse=True)
        known = np.sort(
            2.0 * rank[: len(self.ends)][self.on_edges.gaps < 0] + self.along[self.on_edges.gaps < 0]
        )
        known = np.concatenate(([-np.inf], known, [np.inf]))
        new = 2.0 * rank[len(self.ends) :] + along
        place = np.searchsorted(known, new)
        fresh = np.minimum(new - known[place - 1], known[place] - new) > SAME
        ends, along = ends[fresh], along[fresh]
        one, two = self.body.vertices[ends].transpose(1, 0, 2)
        points = one + along[:, None] * (two - one) + self.shift
        extra = _Gaps.none(len(points)) if self._near is None else self._measured(points, self._near)
        self._widen(points, extra, half[fresh] * triples.length(two - one))
        self.ends, self.along = np.concatenate((self.ends, ends)), np.concatenate((self.along, along))
        self.on_edges = _Gaps.joined(self.on_edges, extra)


@dataclasses.dataclass(frozen=True, eq=False)
class _Near:
    """The faces of a surface that reach into a box: whatever is nearer to a point than the box's sides."""

    low: Float
    high: Float
    region: Region

    @classmethod
    def of(cls, surface: Surface, points: Float, reach: float) -> _Near:
        """Cut out the faces that may be within reach of some points."""
        low, high = triples.box(points)
        return cls(low - reach, high + reach, Region.of(surface, low - reach, high + reach))

    @cached_property
    def index(self) -> SurfaceIndex:
        """Search structure of the faces."""
        return SurfaceIndex(self.region.surface)

    @property
    def empty(self) -> bool:
        """Whether there is no face."""
        return not len(self.region.surface.faces)

    def beyond(self, points: Float, far: Float) -> Int:
        """Return the points within `far` (k,) of which faces may be missing."""
        room = np.minimum(points - self.low, self.high - points).min(axis=1)
        return np.flatnonzero(far > room)


def _outside(gaps: Float, span: float) -> Float:
    return np.where(np.abs(gaps) > span, np.abs(gaps), gaps)


@dataclasses.dataclass(frozen=True, eq=False)
class _Gaps:
    """Signed gaps (k,), unit ways out (k, 3), and how far (k, 3) the closest points have moved."""

    gaps: Float
    ways: Float
    feet: Float

    @classmethod
    def none(cls, count: int) -> _Gaps:
        return cls(np.full(count, np.inf), np.zeros((count, 3)), np.zeros((count, 3)))

    @classmethod
    def joined(cls, one: _Gaps, two: _Gaps) -> _Gaps:
        pairs = ((getattr(one, f.name), getattr(two, f.name)) for f in dataclasses.fields(cls))
        return cls(*map(np.concatenate, pairs))

    def at(self, rows: NDArray | slice) -> _Gaps:
        return _Gaps(self.gaps[rows], self.ways[rows], self.feet[rows])

    def put(self, rows: Int, other: _Gaps) -> None:
        self.gaps[rows], self.ways[rows], self.feet[rows] = other.gaps, other.ways, other.feet
