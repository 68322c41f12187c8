# SPDX-License-Identifier: GPL-3.0-or-later
"""What is done about one pair of bodies: from where it stands to the next displacement field.

*Parting* goes from bodies held apart, where they have passed through each other, back to where they are
(see `separation`); *shaping* lays one surface on the other with ever smaller spreads, and takes back what
was pushed too far; *clearing* only pushes, until neither a node nor an edge is left inside.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from . import triples
from .bodies import Solid
from .contact import Pair
from .contact_field import ContactField
from .crew import together
from .mesh import Float
from .overclosure_settings import OverclosureSettings
from .separation import thickness, way_apart

PARTING, SHAPING, CLEARING = "parting", "shaping", "clearing"

REACH = 0.5  # mean edges beyond the gap: how far nodes are looked after
FALL = 0.7  # of the spread, from one step of the shaping to the next
LAST_STEPS = 3  # steps of the shaping at the last spread
PARTED = 0.3  # of the way pressed in so far: the spread while a pair is pressed together again
PRESS = 0.3  # of the thinner body: how far it is pressed in per step
CALM = 0.5  # of that: the depth below which the next step follows
FINE = 1.0  # mean edges: spread of the clearing
AIM = 0.03  # of the gap: how much farther than needed the clearing pushes, so as to end
ROUNDS = 20  # corrections of the clearing's amounts
AGAIN = 1.0  # mean edges: a depth from which a pair is shaped anew
ROOM = 0.25  # of the thinner body: how deep a pair that was clear may be pressed in by what others do


class Effort:
    """The state of a pair on its way.

    Attributes
    ----------
    pair : Pair
    target : float
        The gap that is aimed at: what was asked for, and `margin`.
    phase : str
    worst : float
        By how much the gap is missed at the deepest node or place on an edge that is asked to move.
    missing : float
        The same of all nodes, those that would leave by the wrong side too.
    pierced : int
        Edges that pierce the other surface; counted while clearing only.
    spread, widest : float
        Of the last field, and the largest so far.

    Parameters
    ----------
    margin : float
        What single precision may take of the gap.
    stride : float
        No step goes farther: other bodies stand beside this pair, and have to be able to follow.
    stuck : bool
        The loop has failed on this pair: part it first.
    clear : bool
        The two overlapped nowhere before anything moved.
    """

    def __init__(
        self,
        pair: Pair,
        settings: OverclosureSettings,
        margin: float,
        stride: float = np.inf,
        stuck: bool = False,
        clear: bool = True,
    ) -> None:
        self.pair, self._settings, self._stride = pair, settings, stride
        self.margin, self.target = margin, pair.gap + margin
        # of the finer body that moves: what a field does between the nodes of a coarse one is lost
        self.size = min(s.edge for s, w in zip((pair.one, pair.two), pair.weights, strict=True) if w > 0)
        self.aim = self.target + AIM * (pair.gap or 1e-3 * self.size)
        self.phase, self.spread, self.widest = SHAPING, 0.0, 0.0
        self.worst, self.missing, self.pierced = 0.0, 0.0, 0
        self._steps, self._clear_at = 0, (-1, -1)
        self._way, self._left, self._whole, self._press = np.zeros(3), 0.0, 0.0, 0.0
        pair.look(self._reach, self.target)
        self._clear = clear
        closed = [solid.surface for solid in (pair.one, pair.two) if not solid.open_edges]
        self._room = ROOM * min(map(thickness, closed), default=0.0)  # how thick a sheet is cannot be told
        self.through = settings.continuation and self._begin_parting(stuck)

    @property
    def _reach(self) -> float:
        return self.target + REACH * self.size

    @property
    def done(self) -> bool:
        """Whether nothing is left to do, as far as is known."""
        return self.phase != PARTING and self.worst <= 0 and not self.pierced

    @property
    def squeeze(self) -> float:
        """How much of its room, from 0 to 1, is taken where others press a pair together that was clear."""
        depth = self.missing - self.target
        return min(depth / self._room, 1.0) if self._clear and depth > 0 and self._room > 0 else 0.0

    def forget(self) -> None:
        """Measure everything anew the next time, even where nothing moved: what was known was wrong."""
        self.pair.forget()
        self._clear_at = (-1, -1)

    def _begin_parting(self, stuck: bool) -> bool:
        apart = way_apart(self.pair, stuck)
        if apart is None:
            return False
        self._whole = float(np.linalg.norm(apart))
        self._way = apart / self._whole
        self._left = self._whole + self.target
        self._press = PRESS * min(thickness(self.pair.one.surface), thickness(self.pair.two.surface))
        self.pair.shifted(self._left * self._way)
        self.phase = PARTING
        return True

    def field(self, squeeze: float = 0.0) -> ContactField | None:
        """Look at the pair and return the next field; None where nothing is to be moved.

        The more others that this pair presses together are squeezed, the shorter its step, down to none:
        they have to give way first, or would pass through each other.
        """
        pair = self.pair
        versions = pair.one.version, pair.two.version
        if self.done and versions == self._clear_at:
            return None
        pair.look(self._reach, self.target)
        strict = self.phase == CLEARING
        self.worst = max(0.0, self.target - pair.deepest(strict))
        self.missing = max(0.0, self.target - pair.deepest(True))
        if strict and self.worst > AGAIN * self.size:  # others pushed it back in
            self.phase, self.spread, self._steps, strict = SHAPING, 0.0, 0, False
        if self.phase == SHAPING and self.worst <= 0:
            self.phase, strict = CLEARING, True
        self.pierced = pair.pierce() if strict else 0
        if strict:
            self.worst = self.missing = max(0.0, self.target - pair.deepest(True))
        if self.done:
            self._clear_at = versions
            return None
        contacts = pair.contacts(self.target, strict)
        asked = (self.aim if strict else self.target) - contacts.gaps
        if self.phase == PARTING:
            self.spread = max(PARTED * (self._whole - self._left), self._settings.spread_end * self.size)
        elif self.phase == SHAPING:
            self._next_spread()
        else:
            self.spread = FINE * self.size
        self.widest = max(self.widest, self.spread)
        if not len(asked):
            return None
        asked = np.minimum(asked, self._stride)
        if squeeze > self.squeeze and self._room > 0:
            asked = np.minimum(asked, (1.0 - squeeze) * self._room)
        if strict:
            return ContactField.fitted(contacts, asked, self.spread, np.zeros(len(asked)), ROUNDS)
        # what is too far apart comes back as far as it was pushed
        back = np.minimum(-asked, np.maximum(contacts.pushed, 0.0))
        return ContactField.fitted(contacts, np.where(asked > 0, asked, -back), self.spread)

    def _next_spread(self) -> None:
        last = self._settings.spread_end * self.size
        if self.spread == 0.0 or self.worst > self._stride:
            self.spread = max(self._settings.spread_factor * self.worst, last)
        else:
            self.spread = max(last, FALL * self.spread)
        if self.spread <= last:
            self._steps += 1
            if self._steps >= LAST_STEPS:
                self.phase = CLEARING

    def pressed(self) -> None:
        """After a step: press a parted pair together by the next part of the way, if it is ready."""
        if self.phase != PARTING or self.worst >= CALM * self._press:
            return
        if self._left == 0.0:
            self.phase = SHAPING
            return
        self._left = max(0.0, self._left - self._press)
        self.pair.shifted(self._left * self._way)


def apply(effort: Effort, field: ContactField) -> dict[str, tuple[Float, float]]:
    """Move both bodies of a pair by a field; return by name how far (each vertex, at most) each went."""
    pair = effort.pair
    ways = ((pair.one, pair.weights[0], pair.offset), (pair.two, -pair.weights[1], np.zeros(3)))
    moving = [way for way in ways if way[1] != 0.0]
    steps = together([partial(_step, field, *way) for way in moving])
    return {way[0].name: step for way, step in zip(moving, steps, strict=True)}


def _step(field: ContactField, solid: Solid, weight: float, frame: Float) -> tuple[Float, float]:
    """Move a body by its part of a field; return how far (each vertex, at most)."""
    rows, step = field(solid.points + frame)
    before = solid.vertices
    solid.move(rows, weight * step)
    distance = triples.length(solid.vertices - before)
    return distance, float(distance.max(initial=0.0))
