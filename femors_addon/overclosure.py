# SPDX-License-Identifier: GPL-3.0-or-later
"""Algorithm 2: push bodies that overlap apart, to a least gap, with one smooth field for each pair.

Pairs are found by themselves. In every iteration each pair in turn is looked at as the others have left
it, a GRNN over the vectors of both bodies (the second body's negated) gives its field, and both bodies
take their share of it, inner nodes too. The loop ends on a certificate from a search built anew: gaps,
crossings, containment and elements. See `effort` for what is done about a pair, `contact_field` for the
field, and `overclosure_check` for the measure.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Container, Iterable, Mapping, Sequence

import numpy as np

from . import settings as declared
from .bodies import Body, Solid, shares
from .contact import Pair
from .effort import CLEARING, PARTING, Effort, apply
from .limits import require_nodes
from .mesh import Float
from .overclosure_check import (
    CONTAINED,
    Bounds,
    Finding,
    PairGaps,
    asked_gaps,
    find,
    same_surface,
)
from .overclosure_methods import nodal, published
from .overclosure_result import OverclosureResult, Step, notes_of, result_of
from .overclosure_settings import OverclosureSettings
from .progress import FemorsError, Progress, part, silent
from .separation import thickness

__all__ = ["Body", "OverclosureResult", "OverclosureSettings", "check_overclosure", "remove_overclosure"]

STRIDE = 0.35  # of the thinnest body, where there are more than two: how far one step may go
STRIDES = 30  # steps that the deepest pair may take to its end, at least as long as it needs for that
PATIENCE = 25  # iterations without headway after which the loop gives up
HEADWAY = 0.98  # of the least missing so far: what counts as headway
GAINED = 0.95  # of depth or crossings at the start: a state that has more is not worth having
MEMORY_LEAST, MEMORY_NODE = 10e6, 2.6e3  # bytes: what a removal was measured to take, and per node of all
TRIES = 3  # certificates that may fail before the loop gives up

Preview = Callable[[Mapping[str, Float]], None]
"""Called with the nodes (n, 3) of each body by name while a removal runs."""


def check_overclosure(
    bodies: Sequence[Body],
    settings: OverclosureSettings | None = None,
    progress: Progress = silent,
    *,
    exclude: Iterable[tuple[str, str]] = (),
    gaps: PairGaps | None = None,
    tell: Callable[[str], None] | None = None,
) -> list[Finding]:
    """Return the pairs of bodies that overlap or are closer than the band, the deepest first.

    Parameters and errors are those of `remove_overclosure`; nothing is moved. `tell` is called with
    each thing that the user should know of the bodies, in words.
    """
    settings = settings or OverclosureSettings()
    solids = _solids(bodies, settings)
    asked = asked_gaps(solids, settings.gap, exclude, gaps or {})
    found = find(solids, asked, _band(solids, settings), progress)
    if tell is not None:
        for note in notes_of(solids, found):
            tell(note)
    return found


def remove_overclosure(
    bodies: Sequence[Body],
    settings: OverclosureSettings | None = None,
    progress: Progress = silent,
    *,
    exclude: Iterable[tuple[str, str]] = (),
    gaps: PairGaps | None = None,
    preview: Preview | None = None,
) -> OverclosureResult:
    """Push bodies apart until none overlaps another and every pair keeps its gap.

    Parameters
    ----------
    bodies : sequence of Body
        At least two, in one unit of length and one frame; the input is left as it is.
    settings : OverclosureSettings, optional
    progress : Progress
        Called with the fraction done and a text; may raise `Cancelled`.
    exclude : iterable of pairs of names
        Bodies that may overlap, such as a cartilage that is tied to its bone.
    gaps : mapping of pairs of names to float
        Gaps of single pairs, in place of the settings'.
    preview : callable, optional
        Called with the bodies' nodes after each iteration.

    Returns
    -------
    OverclosureResult
        Certified, or the best state met and the reason why it is not.

    Raises
    ------
    FemorsError
        Fewer than two bodies, a name twice, a mesh that is no surface, two copies of one surface,
        settings outside their limits; more memory needed than is allowed.
    Cancelled
        From `progress`.
    """
    started = time.process_time()
    settings = settings or OverclosureSettings()
    solids = _solids(bodies, settings)
    asked = asked_gaps(solids, settings.gap, exclude, gaps or {})
    bounds: Bounds = {}
    before = find(solids, asked, _band(solids, settings), part(progress, 0.0, 0.1), bounds=bounds)
    history: list[Step] = []
    if all(solid.share == 0 for solid in solids) and not all(finding.clear for finding in before):
        raise FemorsError("every body is rigid, so that nothing can give way: let at least one deform")
    efforts = _efforts(solids, asked, before, bounds, settings)
    stop, after = "", before
    if any(not finding.clear for finding in before):
        stop, after = _removed(
            efforts, solids, asked, before, settings, history, part(progress, 0.1, 0.95), preview
        )
        if settings.method == "grnn" and not _clear(after, efforts):
            stop, after = _parted(
                efforts,
                solids,
                asked,
                before,
                after,
                settings,
                history,
                part(progress, 0.95, 0.97),
                preview,
                stop,
            )
    solved = time.process_time()
    result = result_of(solids, before, after, efforts, settings, tuple(history), stop)
    progress(1.0, "done")
    return dataclasses.replace(result, seconds=time.process_time() - started, solve_seconds=solved - started)


# --- input ------------------------------------------------------------------------------------------
def _solids(bodies: Sequence[Body], settings: OverclosureSettings) -> list[Solid]:
    """Return the bodies at work; refuse what cannot be worked with."""
    declared.check(settings)
    nodes = sum(len(body.nodes) for body in bodies)
    require_nodes(nodes, f"overclosure of {len(bodies)} bodies", MEMORY_LEAST, MEMORY_NODE)
    if len(bodies) < 2:
        raise FemorsError(f"{len(bodies)} body given; overclosure needs at least two")
    names = [body.name for body in bodies]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise FemorsError(f"two bodies are named '{twice}'; each needs a name of its own")
    solids = [Solid(body, share) for body, share in zip(bodies, shares(list(bodies)), strict=True)]
    for i, one in enumerate(solids):
        for two in solids[:i]:
            if same_surface(one, two):
                raise FemorsError(
                    f"'{two.name}' and '{one.name}' are copies of one surface in one place: leave one out"
                )
    return solids


def _band(solids: Sequence[Solid], settings: OverclosureSettings) -> float:
    return settings.band or float(np.median([solid.surface.mean_edge for solid in solids]))


def _efforts(
    solids: Sequence[Solid],
    asked: Mapping[tuple[int, int], float],
    before: Sequence[Finding],
    bounds: Bounds,
    settings: OverclosureSettings,
    stuck: Container[tuple[str, str]] = (),
) -> list[Effort]:
    """Return an effort for each pair that may have to be moved, in the order of the bodies.

    Pairs that are clear now are kept in sight, for others may push them together. Those that are `stuck` are
    parted first.
    """
    if settings.method != "grnn":
        settings = dataclasses.replace(settings, continuation=False)
    deepest = max((finding.depth for finding in before), default=0.0)
    given_up = {finding.names for finding in before if finding.state == CONTAINED}
    efforts = []
    for (i, j), gap in asked.items():
        one, two = solids[i], solids[j]
        if one.share + two.share == 0 or (one.name, two.name) in given_up:
            continue
        size = max(float(np.abs(solid.vertices).max()) for solid in (one, two))
        margin = 2.0 * float(np.spacing(np.float32(size)))
        pair = Pair(one, two, gap)
        for side in pair.sides:
            side.bound = bounds.pop((side.body.name, side.other.name), side.bound)
        stride = _stride((i, j), solids, asked, deepest)
        efforts.append(Effort(pair, settings, margin, stride, pair.names in stuck))
    return efforts


def _removed(
    efforts: list[Effort],
    solids: Sequence[Solid],
    asked: Mapping[tuple[int, int], float],
    before: Sequence[Finding],
    settings: OverclosureSettings,
    history: list[Step],
    progress: Progress,
    preview: Preview | None,
) -> tuple[str, list[Finding]]:
    """Run the method until the certificate holds; return why it stopped short, or "", and what is left.

    The loop may think that it is done and be wrong, for it remembers much: then it goes on, with all of
    that forgotten.
    """
    run = {"grnn": _loop, "nodal": nodal, "published": published}[settings.method]
    for number in range(TRIES if settings.method == "grnn" else 1):
        start = 0.9 * number / TRIES
        stop = run(efforts, solids, settings, history, part(progress, start, 0.9), preview)
        progress(0.9, "overclosure: certificate")
        for effort in efforts:
            effort.pair.rest()
        after = find(solids, asked, _band(solids, settings), part(progress, 0.9, 1.0))
        if stop or _clear(after, efforts):
            break
        for effort in efforts:
            effort.pair.forget()
    if stop and settings.method == "grnn" and not _better(after, before):
        for solid in solids:
            solid.put(solid.rest)
        return stop, list(before)
    return stop, after


def _parted(
    efforts: list[Effort],
    solids: Sequence[Solid],
    asked: Mapping[tuple[int, int], float],
    before: Sequence[Finding],
    after: list[Finding],
    settings: OverclosureSettings,
    history: list[Step],
    progress: Progress,
    preview: Preview | None,
    stop: str,
) -> tuple[str, list[Finding]]:
    """Begin anew with the pairs that are stuck held apart; where that ends no better, leave all as it was."""
    through = {effort.pair.names for effort in efforts if effort.through}
    stuck = {finding.names for finding in after if not finding.clear} - through
    here = [(solid.points, solid.held) for solid in solids]
    for solid in solids:
        solid.put(solid.rest)
        solid.held = set()
    again = _efforts(solids, asked, before, {}, settings, stuck)
    if any(effort.through and effort.pair.names in stuck for effort in again):
        steps: list[Step] = []  # the history is that of the state that is returned
        failed, found = _removed(again, solids, asked, before, settings, steps, progress, preview)
        if not failed and _clear(found, again):
            efforts[:], history[:] = again, steps
            return failed, found
    for solid, (points, held) in zip(solids, here, strict=True):
        solid.put(points)
        solid.held = held
    return stop, after


def _clear(found: Sequence[Finding], efforts: Sequence[Effort]) -> bool:
    """Whether all pairs are clear that something could be done about."""
    tried = {effort.pair.names for effort in efforts}
    return all(finding.clear for finding in found if finding.names in tried)


def _better(after: Sequence[Finding], before: Sequence[Finding]) -> bool:
    """Whether a state that may not be clear is at least less deep, or crosses less."""
    now, then = (
        (sum(max(f.gap - f.least, 0.0) for f in found), sum(f.crossings for f in found))
        for found in (after, before)
    )
    return all(f.clear for f in after) or now[0] < GAINED * then[0] or now[1] < GAINED * then[1]


def _stride(
    pair: tuple[int, int], solids: Sequence[Solid], asked: Mapping[tuple[int, int], float], deepest: float
) -> float:
    """Return how far one step of a pair may go, so that no third body near it is passed through."""
    thinnest = np.inf
    for number, other in enumerate(solids):
        for mine in pair:
            if number in pair or tuple(sorted((number, mine))) not in asked:
                continue
            (low, high), (its_low, its_high) = solids[mine].surface.bounds, other.surface.bounds
            if (np.maximum(low, its_low) - np.minimum(high, its_high) <= 2.0 * deepest).all():
                thinnest = min(thinnest, *(thickness(solids[n].surface) for n in (*pair, number)))
    return max(STRIDE * thinnest, deepest / STRIDES)


# --- the loop ---------------------------------------------------------------------------------------
def _loop(
    efforts: list[Effort],
    solids: Sequence[Solid],
    settings: OverclosureSettings,
    history: list[Step],
    progress: Progress,
    preview: Preview | None,
) -> str:
    """Iterate until all pairs are clear; return why it stopped short of it, or ""."""
    best = _Best(solids)
    deepest, share, shaped = 0.0, 0.0, False
    for number in range(settings.iterations):
        begun = [solid.points for solid in solids]
        missing, pierced, spread = _sweep(efforts)
        deepest = max(deepest, missing)
        history.append(Step(number + 1, missing, pierced, spread))
        done = 1.0 - math.log1p(1e4 * missing / deepest) / math.log1p(1e4) if deepest else 1.0
        clearing = all(effort.phase == CLEARING for effort in efforts)
        left = f"{pierced} edges crossing" if clearing or not missing else "shaping"
        text = f"overclosure, iteration {number + 1}, depth {missing:.3g}, {left}"
        share = min(0.99, max(share, done, number / settings.iterations))  # pairs push each other back in
        progress(share, text)
        if preview is not None:
            preview({solid.name: solid.nodes for solid in solids})
        ready = all(effort.done for effort in efforts)
        parting = any(effort.phase == PARTING for effort in efforts)
        if not parting and not shaped:  # squeezed elements get their shapes back before the fine work
            shaped = True
            for solid in solids:
                if solid.held:
                    solid.reshape()
        if ready:
            for solid in solids:
                solid.reshape()
            return ""
        if parting:
            continue
        uncounted = 0.0 if clearing and not pierced else 1e-9  # edges may still cross
        if not best.improved(missing + uncounted, number, begun):
            best.restore()
            return f"no headway in {PATIENCE} iterations"
    best.restore()
    return f"iteration limit ({settings.iterations}) reached"


def _sweep(efforts: list[Effort]) -> tuple[float, int, float]:
    """Move every pair once; return (largest depth that is missing, edges that pierce, largest spread)."""
    missing, pierced, spread = 0.0, 0, 0.0
    for effort in efforts:
        field = effort.field()
        missing, pierced = max(missing, effort.missing), pierced + effort.pierced
        if field is not None:
            spread = max(spread, effort.spread)
            steps = apply(effort, field)
            for other in efforts:
                other.pair.moved(steps)
        effort.pressed()
    return missing, pierced, spread


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
