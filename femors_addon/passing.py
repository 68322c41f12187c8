# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a body went right through another: both ends are clear, but the way between them is not.

No measure of the end tells. Where a pair has moved far for its thinner body, it is looked at in steps on
the straight way from where it began to where it is.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Iterable, Sequence
from functools import partial
from operator import attrgetter

import numpy as np

from . import triples
from .bodies import Solid
from .crew import over
from .distances import Target, distances
from .mesh import Float
from .progress import Progress
from .separation import thickness

FAR = 0.5  # of the thinner body's thickness: who has moved less, both together, cannot have passed
STEP, MOST = 0.15, 60  # of that thickness: one step of the way; and steps, at most
DEEP = 0.1  # of it: what is deeper on the way, and overlaps at neither end, has passed through


@dataclasses.dataclass(frozen=True)
class Passing:
    """Two bodies on their way through each other.

    Attributes
    ----------
    one, two : str
        Names of the bodies.
    depth : float
        How deep a node of one is inside the other.
    where : tuple of float
        That node's place.
    """

    one: str
    two: str
    depth: float
    where: tuple[float, float, float]


def passed(solids: Sequence[Solid], pairs: Iterable[tuple[int, int]], progress: Progress) -> list[Passing]:
    """Return the deepest state on the way of each pair that went through each other.

    Of open bodies nothing tells what is inside on the way.

    Parameters
    ----------
    pairs : iterable of (int, int)
        Those that overlap neither at the start nor in the end, by the numbers of the solids. Of those that
        overlap at the start, the right way out may be the deeper one.
    """
    ways = [_Way.of(solid) for solid in solids]
    found = []
    for i, j in pairs:
        one, two = solids[i], solids[j]
        far = ways[i].farthest(ways[j]) + ways[j].farthest(ways[i])
        if far == 0.0 or one.open_edges or two.open_edges:
            continue
        thin = min(thickness(solid.begun_surface) for solid in (one, two))
        if not 0.0 < FAR * thin < far:
            continue
        steps = min(MOST, math.ceil(far / (STEP * thin)))
        states: list[Passing] = []
        for state in over(partial(_deepest, one, two), (number / steps for number in range(1, steps))):
            progress((len(states) + 1) / steps, f"the way of {one.name} and {two.name}")
            states.append(state)
        deepest = max(states, key=attrgetter("depth"))
        if deepest.depth > DEEP * thin:
            found.append(deepest)
    return found


@dataclasses.dataclass(frozen=True, eq=False)
class _Way:
    """How far the vertices (n,) of a body went, and boxes (n, 3) around the way of each, and of all."""

    length: Float
    low: Float
    high: Float
    bounds: tuple[Float, Float]

    @classmethod
    def of(cls, solid: Solid) -> _Way:
        start, end = solid.begun_surface.vertices, solid.vertices
        low, high = np.minimum(start, end), np.maximum(start, end)
        return cls(triples.length(end - start), low, high, (low.min(axis=0), high.max(axis=0)))

    def farthest(self, other: _Way) -> float:
        """The longest way of a vertex that comes into the box of all ways of another body."""
        if (self.bounds[0] > other.bounds[1]).any() or (self.bounds[1] < other.bounds[0]).any():
            return 0.0
        near = triples.every((self.low <= other.bounds[1]) & (self.high >= other.bounds[0]))
        return float(self.length[near].max(initial=0.0))


def _deepest(one: Solid, two: Solid, share: float) -> Passing:
    """Measure a pair at a share of its way."""
    targets = [Target(_on_its_way(solid, share)) for solid in (one, two)]
    depth, where = 0.0, np.zeros(3)
    for own, other in (targets, targets[::-1]):
        inside = distances(own.surface, other, 0.0)
        if len(inside.rows) and -inside.signed.min() > depth:
            depth = -float(inside.signed.min())
            where = own.surface.vertices[inside.rows[np.argmin(inside.signed)]]
    return Passing(one.name, two.name, depth, (float(where[0]), float(where[1]), float(where[2])))


def _on_its_way(solid: Solid, share: float) -> Solid:
    out = copy.copy(solid)
    out.put(solid.rest + share * (solid.points - solid.rest))
    return out
