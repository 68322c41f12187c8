# SPDX-License-Identifier: GPL-3.0-or-later
"""The loop of a removal: every pair moved once an iteration, until all are clear or nothing helps any more.

Pairs come one after the other, each on what the others have left. Those that have no body in common that
moves know nothing of each other, so that they may be worked on at once: the bits are those of one by one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from .bodies import Solid
from .crew import ordered, together
from .effort import CLEARING, PARTING, Effort, apply
from .mesh import Float
from .overclosure_result import Step
from .overclosure_settings import OverclosureSettings
from .progress import Progress, counted

PATIENCE = 25  # iterations without headway after which the loop gives up
HEADWAY = 0.98  # of the least missing so far: what counts as headway


def loop(
    efforts: list[Effort],
    solids: Sequence[Solid],
    settings: OverclosureSettings,
    history: list[Step],
    progress: Progress,
    preview: Any,
) -> str:
    """Iterate until all pairs are clear; return why it stopped short of it, or ""."""
    best = _Best(solids)
    deepest, share, shaped = 0.0, 0.0, False
    beside = _beside(efforts)
    for number in range(settings.iterations):
        begun = [solid.points for solid in solids]
        missing, pierced, spread = _sweep(efforts, beside)
        deepest = max(deepest, missing)
        history.append(Step(len(history) + 1, missing, pierced, spread))
        done = 1.0 - math.log1p(1e4 * missing / deepest) / math.log1p(1e4) if deepest else 1.0
        clearing = all(effort.phase == CLEARING for effort in efforts)
        left = counted(pierced, "edge crossing", "edges crossing") if clearing or not missing else "shaping"
        text = f"overclosure, iteration {len(history)}, depth {missing:.3g}, {left}"
        share = min(0.99, max(share, done, number / settings.iterations))  # pairs push each other back in
        progress(share, text)
        if preview is not None:
            preview({solid.name: solid.nodes for solid in solids})
        ready = all(effort.done for effort in efforts)
        parting = any(effort.phase == PARTING for effort in efforts)
        if not parting and not shaped:  # squeezed elements get their shapes back before the fine work
            shaped = True
            _reshape([solid for solid in solids if solid.held])
        if ready:
            _reshape(solids)
            return ""
        if parting:
            continue
        uncounted = 0.0 if clearing and not pierced else 1e-9  # edges may still cross
        if not best.improved(missing + uncounted, number, begun):
            best.restore()
            return f"no headway in {PATIENCE} iterations"
    best.restore()
    return f"iteration limit ({settings.iterations}) reached"


def _sweep(efforts: list[Effort], beside: list[list[Effort]]) -> tuple[float, int, float]:
    """Move every pair once; return (largest depth that is missing, edges that pierce, largest spread)."""
    jobs = [partial(_moved, number, efforts, beside[number]) for number in range(len(efforts))]
    found = ordered(jobs, _needs(efforts))
    for effort in efforts:
        effort.pair.catch_up()
    missing, pierced, spread = zip(*found, strict=True) if found else ((0.0,), (0,), (0.0,))
    return max(0.0, *missing), sum(pierced), max(0.0, *spread)


def _needs(efforts: list[Effort]) -> list[set[int]]:
    """Return for each pair those that must be done before: the last that may move one of its bodies."""
    last: dict[str, int] = {}
    needs = []
    for number, effort in enumerate(efforts):
        moving = effort.pair.moving
        needs.append({last[name] for name in moving if name in last})
        last.update(dict.fromkeys(moving, number))
    return needs


def _beside(efforts: list[Effort]) -> list[list[Effort]]:
    """Return for each pair the others with a body in common that moves: none is at work while this one is."""
    of: dict[str, list[Effort]] = {}
    for effort in efforts:
        for name in effort.pair.moving:
            of.setdefault(name, []).append(effort)
    return [
        [other for name in sorted(e.pair.moving) for other in of[name] if other is not e] for e in efforts
    ]


def _moved(number: int, efforts: list[Effort], beside: list[Effort]) -> tuple[float, int, float]:
    """Move a pair, and let the others know; return its (missing depth, piercing edges, spread)."""
    effort = efforts[number]
    effort.pair.catch_up()
    field = effort.field(max((other.squeeze for other in beside), default=0.0))
    if field is not None:
        steps = apply(effort, field)
        for other in efforts:
            other.pair.moved(steps, number)
        effort.pair.catch_up()
    effort.pressed()
    return effort.missing, effort.pierced, 0.0 if field is None else effort.spread


def _reshape(solids: Sequence[Solid]) -> None:
    together([solid.reshape for solid in solids])


class _Best:
    """The best state met."""

    def __init__(self, solids: Sequence[Solid]) -> None:
        self._solids = solids
        self._score, self._number = np.inf, 0
        self._points = [solid.points for solid in solids]

    def improved(self, score: float, number: int, points: list[Float]) -> bool:
        """Take note of a state's score and points; whether there was headway lately."""
        if score < HEADWAY * self._score:
            self._score, self._number, self._points = score, number, points
        return number - self._number < PATIENCE

    def restore(self) -> None:
        """Go back to the best state."""
        for solid, points in zip(self._solids, self._points, strict=True):
            solid.put(points)
