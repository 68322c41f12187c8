# SPDX-License-Identifier: GPL-3.0-or-later
"""Two bodies in contact: gaps of each one's nodes over the other's surface, and edges that pierce it."""

from __future__ import annotations

from functools import partial
from operator import itemgetter

import numpy as np

from .bodies import Solid
from .crew import together
from .meeting import REACH, Meeting
from .mesh import Float
from .sides import Contacts, Side

Steps = dict[str, tuple[Float, float]]
"""How far bodies moved, by name: the distance of each vertex of the surface, and the largest."""


class Pair:
    """Two bodies of which one may have to give way to the other.

    Attributes
    ----------
    one, two : Solid
    gap : float
        Least distance that is asked for.
    offset : (3,) float64
        By which the first body is shifted while the two are looked at; see `separation`.
    weights : (float, float)
        Share of the way apart that each body takes; they add up to 1, or are both 0.
    """

    def __init__(self, one: Solid, two: Solid, gap: float) -> None:
        self.one, self.two, self.gap = one, two, gap
        total = one.share + two.share
        self.weights = (one.share / total, two.share / total) if total > 0 else (0.0, 0.0)
        self.offset = np.zeros(3)
        self.sides = (Side(one, two, 1.0), Side(two, one, -1.0))
        self._meeting = Meeting(one, two)
        self._steps: list[tuple[int, Steps]] = []

    @property
    def names(self) -> tuple[str, str]:
        """Both names."""
        return self.one.name, self.two.name

    @property
    def moving(self) -> set[str]:
        """Names of the bodies that may move."""
        return {solid.name for solid in (self.one, self.two) if solid.share > 0}

    def look(self, reach: float, least: float = np.inf) -> None:
        """Measure all gaps anew that may be below `reach`; those of nodes never too near, below `least`."""
        self.sides[0].frame = self.offset
        self.sides[0].shift, self.sides[1].shift = self.offset, -self.offset
        together([partial(side.look, reach, least) for side in self.sides])

    def shifted(self, offset: Float) -> None:
        """Look at the pair with the first body at another offset from now on."""
        moved = float(np.linalg.norm(offset - self.offset))
        self.offset = offset
        for side in self.sides:
            side.bound -= moved

    def moved(self, steps: Steps, number: int = 0) -> None:
        """Take note that bodies moved, for `catch_up`, in the order of the numbers; any thread may call."""
        if steps.keys() & set(self.names):
            self._steps.append((number, steps))

    def catch_up(self) -> None:
        """Lower all bounds by what was noted, before anybody looks at them."""
        noted, self._steps = sorted(self._steps, key=itemgetter(0)), []
        for _, steps in noted:
            for side in self.sides:
                own, _ = steps.get(side.body.name, (0.0, 0.0))
                _, other = steps.get(side.other.name, (0.0, 0.0))
                side.bound -= own + other

    def rest(self) -> None:
        """Let go of what only the next look needs."""
        self._meeting.forget()
        for side in self.sides:
            side.rest()

    def forget(self) -> None:
        """Measure everything anew the next time."""
        self._meeting.forget()
        for side in self.sides:
            side.bound[:] = -np.inf

    def deepest(self, strict: bool) -> float:
        """Return the smallest gap; nodes that would leave by the wrong side count if `strict`."""
        return min(side.deepest(strict) for side in self.sides)

    def contacts(self, target: float, strict: bool) -> Contacts:
        """Return the nodes that are, or have been, closer than `target`."""
        return Contacts.joined(*(side.contacts(target, strict) for side in self.sides))

    def pierce(self) -> int:
        """Find the edges that pierce the other surface, to be kept from it from now on; return how many."""
        if any(side.beyond(REACH) for side in self.sides):
            return 0
        one, two = self.sides
        found = self._meeting.pierced((self.offset, np.zeros(3)), (one.bound, two.bound))
        return sum(side.pierced(edges) for side, edges in zip(self.sides, found, strict=True))
