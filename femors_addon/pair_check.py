# SPDX-License-Identifier: GPL-3.0-or-later
"""One pair of bodies, measured anew: how deep, where, what crosses, what lies inside, what is shared."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from . import triples
from .booleans import shared_volume
from .crew import together
from .cutouts import Region
from .distances import Target, distances
from .edge_gaps import least_between, middles
from .findings import CLEAR, CONTAINED, NEAR, OVERLAP, Finding
from .intersect import crossings, piercings
from .mesh import Float, Int, Surface, connected

SWALLOWED = 0.5  # of a body's nodes inside another: as many leaving by the wrong side, and it is contained
TOLERANCE = 1e-5  # of the unit: by how much a gap may miss what is asked for

Bounds = dict[tuple[str, str], Float]
"""By the names of a body and of another: no signed distance of the body's vertices (n,) is smaller."""


def tolerance(gap: float, size: float) -> float:
    """Return by how much a gap may be missed: 1e-5 of the unit, less where gap or bodies are tiny."""
    return min(TOLERANCE, 1e-3 * gap if gap > 0 else 1e-6 * size)


@dataclasses.dataclass(frozen=True, eq=False)
class _Side:
    """A body against another.

    Attributes
    ----------
    rows, distance : (k,) int64, (k,) float64
        The vertices near the other body, and how far they are from it, at least, in single precision.
    inside : (n,) bool
        The vertices inside the other.
    swallowed : bool
        Whether so many of these would leave by the wrong side that a piece may lie in the other whole.
    near : Surface
        The faces that may cross the other's.
    apart : (n,) float64
        See `distances`.
    bound : (n,) float64
        See `distances`.
    """

    body: Target
    rows: NDArray[np.int64]
    distance: Float
    inside: NDArray[np.bool_]
    swallowed: bool
    near: Surface
    apart: Float
    bound: Float

    @classmethod
    def of(cls, body: Target, other: Target, reach: float, slack: float) -> _Side:
        """Measure a body's vertices within `reach` of another."""
        found = distances(body.surface, other, reach)
        near = _close(body.surface, found.apart, slack, body.longest)
        rows, distance = found.rows, found.signed - slack
        inside: NDArray[np.bool_] = np.zeros(len(body.surface.vertices), dtype=bool)
        inside[rows[distance < 0]] = True
        # a ball whose socket has closed in on it comes free by its own side: that is no body in a body
        swallowed = bool(inside.any() and found.wrong[distance < 0].mean() > SWALLOWED)
        return cls(body, rows, distance, inside, swallowed, near, found.apart, found.bound)

    @property
    def least(self) -> float:
        """The smallest distance."""
        return float(self.distance.min(initial=np.inf))

    @property
    def where(self) -> Float:
        """Place (3,) of the smallest distance."""
        return np.asarray(self.body.surface.vertices[self.rows[np.argmin(self.distance)]])


def measure(
    one: Target, two: Target, gap: float, band: float, volumes: bool = True, bounds: Bounds | None = None
) -> Finding | None:
    """Measure a pair anew; None where no node of one is within `band` of the other and nothing crosses."""
    a, b = one.surface, two.surface
    reach = band + 1e-9 * max(a.diagonal, b.diagonal)
    if (np.maximum(a.bounds[0], b.bounds[0]) - reach > np.minimum(a.bounds[1], b.bounds[1])).any():
        return None
    slack = _rounding(a) + _rounding(b)
    ways = ((one, two), (two, one))
    sides = together([partial(_Side.of, own, other, reach, slack) for own, other in ways])
    if bounds is not None:
        for (own, other), side in zip(ways, sides, strict=True):
            bounds[own.solid.name, other.solid.name] = side.bound
    cross = _crossing(*(side.near for side in sides))
    least = min(side.least for side in sides)
    if least >= band and not len(cross):
        return None
    where = _place(sides, len(cross) > 0)
    if least >= reach:  # large faces cross, and no node is near
        least = min(float(distances(own.surface, other, np.inf).signed.min()) for own, other in ways)
    limit = gap - tolerance(gap, max(a.diagonal, b.diagonal))
    over = [int((side.distance < limit).sum()) for side in sides]
    contained = _contained(sides)
    state = CLEAR
    if contained:
        state = CONTAINED
    elif len(cross) or least < -slack:
        state = OVERLAP
    elif sum(over):
        state = NEAR
    apart = None
    if state == CLEAR:
        within = max(least, slack)
        c, d = (_close(side.body.surface, side.apart, within, side.body.longest) for side in sides)
        apart = least_between(c, d, max(least, 0.0))
    shared = 0.0 if state in (CLEAR, NEAR) else None
    if shared is None and volumes:
        shared = shared_volume(a, b, _box(sides, cross))
    return Finding(
        one=one.solid.name,
        two=two.solid.name,
        gap=gap,
        least=float(least),
        over=(over[0], over[1]),
        crossings=len(cross),
        contained=contained,
        where=(float(where[0]), float(where[1]), float(where[2])),
        shared=shared,
        state=state,
        surfaces_apart=apart,
        edge_depth=_edge_depth(sides, cross) if state == OVERLAP else 0.0,
    )


def _crossing(one: Surface, two: Surface) -> Int:
    """Return the pairs (k, 2) of faces that cross, as they are or in single precision: whichever are more."""
    exact, single = together(
        [
            partial(crossings, one.bare(), two.bare()),
            partial(crossings, _single(one), _single(two)),
        ]
    )
    return exact if len(exact) >= len(single) else single


def _place(sides: Sequence[_Side], cross: bool) -> Float:
    """Return the place (3,) of the smallest distance; where edges cross and no node is inside, theirs."""
    deepest = min(sides, key=lambda side: side.least)
    where = deepest.where if len(deepest.rows) else np.zeros(3)
    if cross and deepest.least > 0:
        c, d = (side.near for side in sides)
        places = np.concatenate((piercings(c, d).points(c), piercings(d, c).points(d)))
        where = places[len(places) // 2] if len(places) else where
    return where


def _edge_depth(sides: Sequence[_Side], cross: Int) -> float:
    """Return how deep edges are inside the other body where they go in and out again, by their middles."""
    one, two = (
        Region.cut(side.near, np.unique(faces)).surface for side, faces in zip(sides, cross.T, strict=True)
    )
    places = middles(one, two), middles(two, one)
    signed = [side.body.near(points) for side, points in zip(reversed(sides), places, strict=True)]
    return max(0.0, -float(np.concatenate(signed).min(initial=0.0)))


def _contained(sides: Sequence[_Side]) -> str:
    """Return the name of the body of which a piece lies inside the other, or ""."""
    for side, other in zip(sides, reversed(sides), strict=True):
        if side.swallowed and _whole_piece(side.body.surface, other.body.surface, side.inside):
            return side.body.solid.name
    return ""


def _box(sides: Sequence[_Side], cross: Int) -> tuple[Float, Float]:
    """Return the corners (3,) of a box that holds all that two bodies share."""
    places = [side.body.surface.vertices[side.inside] for side in sides]
    places += [
        side.near.vertices[side.near.faces[face]].reshape(-1, 3)
        for side, face in zip(sides, cross.T, strict=True)
    ]
    return triples.box(np.concatenate(places))


def _close(surface: Surface, apart: Float, slack: float, longest: float) -> Surface:
    """The faces that may cross the other surface: all their corners are within a side's length of it.

    With a larger slack, those that may come so near it.
    """
    faces = surface.faces
    farthest = triples.greatest(apart[faces]) - slack
    chosen = np.flatnonzero(farthest <= longest)
    sides = np.sqrt(triples.longest_squared(surface.vertices.take(faces[chosen], axis=0)))
    return Region.cut(surface, chosen[farthest[chosen] <= sides * (1.0 + 1e-9) + slack]).surface


def _single(surface: Surface) -> Surface:
    """The surface with its coordinates in single precision, as Blender has them."""
    return surface.moved(surface.vertices.astype(np.float32).astype(np.float64))


def _rounding(surface: Surface) -> float:
    """Return how far single precision moves a vertex, at most."""
    rounded = surface.vertices.astype(np.float32).astype(np.float64)
    return float(triples.length(rounded - surface.vertices).max(initial=0.0))


def _whole_piece(surface: Surface, other: Surface, deep: NDArray[np.bool_]) -> bool:
    """Whether a connected piece of a surface lies inside the other without crossing it."""
    piece = connected(surface.edges, len(surface.vertices))
    outside = np.zeros(int(piece.max()) + 1, dtype=bool)
    np.logical_or.at(outside, piece, ~deep)
    whole = np.flatnonzero(~outside)
    if not len(whole):
        return False
    faces = np.isin(piece[surface.faces[:, 0]], whole)
    part = Surface(surface.vertices, surface.faces[faces])
    crossing = np.unique(piece[part.faces[crossings(part, other)[:, 0], 0]])
    return bool(len(np.setdiff1d(whole, crossing)))
