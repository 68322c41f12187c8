# SPDX-License-Identifier: GPL-3.0-or-later
"""A removal from its input to its certificate: what is tried, one after the other, and what is kept."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Container, Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np

from .bodies import Body
from .boxes import Boxes
from .contact import Pair
from .crew import together
from .effort import Effort
from .findings import OVERLAP, Excluded
from .overclosure_check import CONTAINED, Bounds, Finding, PairGaps, asked_gaps, every_pair, find
from .overclosure_methods import nodal, published
from .overclosure_result import OverclosureResult, Step, result_of
from .overclosure_settings import OverclosureSettings
from .passing import Passing, passed
from .progress import FemorsError, Progress, part, rising
from .removal_input import band_of, check_gaps, solids_of
from .removal_loop import loop
from .separation import runs_through, thickness

STRIDE = 0.35  # of the thinnest body, where there are more than two: how far one step may go
STRIDES = 30  # steps that the deepest pair may take to its end, at least as long as it needs for that
GAINED = 0.4  # of depth or crossings at the start: a state that is not clear and has more is not worth having
THROUGH = 50  # iterations where sheets run right through bodies, at most: those that were parted took 35
SIGHT = 4.0  # of what the largest gap lacks, and the band: farther pairs are left until they come near
TRIES = 3  # certificates that fail with no new pair found, until the loop gives up
SHAKEN = (1e-3, 1e-5)  # mean edges: how far nodes are moved at random where a pair is stuck
UNTOLD = 0.1  # of the smaller body's size: a depth by the normals of an open body alone that is not believed
ROUNDED = 1e-9  # of the largest body's size: a depth below it is rounding
NEARLY = 0.01  # mean edges: what is left at most, for it is little that shaking helps with
METHODS = {"grnn": loop, "nodal": nodal, "published": published}


class Removal:
    """The bodies of a removal, what was found of them, and what has been done.

    Attributes
    ----------
    solids : list of Solid
    before, after : list of Finding
    efforts : list of Effort
        Of the state that is kept.
    history : list of Step
        That led to it.
    stop : str
        Why it is not clear, or "".
    through : dict of names of a pair to str
        Overlapping pairs where a sheet runs right through a body: which of the two is the sheet.
    untold : dict of names of a pair to str
        Pairs that are left alone, for it cannot be told what is inside: which of the two is open.
    passed : list of Passing
        Pairs that are clear, but went through each other: the deepest state on their way.
    excluded : list of Excluded
        Pairs that may overlap, and how deep they do.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        settings: OverclosureSettings,
        exclude: Iterable[tuple[str, str]],
        gaps: PairGaps,
        preview: Any,
    ) -> None:
        self._settings, self._preview = settings, preview
        self.solids = solids_of(bodies, settings)
        self._asked = asked_gaps(self.solids, settings.gap, exclude, gaps)
        every = every_pair(self.solids, 0.0)
        self._spared = {pair: gap for pair, gap in every.items() if pair not in self._asked}
        self.excluded: list[Excluded] = []
        self.before: list[Finding] = []
        self.after: list[Finding] = []
        self.efforts: list[Effort] = []
        self.history: list[Step] = []
        self.stop = ""
        self.through: dict[tuple[str, str], str] = {}
        self.untold: dict[tuple[str, str], str] = {}
        self.passed: list[Passing] = []

    def run(self, progress: Progress) -> None:
        """Do what has to be done.

        Raises
        ------
        FemorsError
            Every body rigid; a gap that is wide for a body, see `check_gaps`.
        Cancelled
            From `progress`.
        """
        bounds: Bounds = {}
        progress = rising(progress)
        self.before = self.after = self._find(part(progress, 0.0, 0.1), bounds)
        overlap = any(not finding.clear for finding in self.before)
        if overlap and all(solid.share == 0 for solid in self.solids):
            raise FemorsError("every body is rigid, so that nothing can give way: let at least one deform")
        check_gaps(self.solids, self.before)
        self.untold = self._untold(self.before)
        self.efforts = self._begun(self._in_sight(), bounds)
        deep = self._depths(part(progress, 0.1, 0.1))
        self.excluded = [Excluded(*pair, depth, depth) for pair, depth in deep.items()]
        if not overlap:
            return
        self.through = self._run_through()
        self.stop, self.after = self._removed(self.efforts, self.history, part(progress, 0.1, 0.95))
        if self._settings.method == "grnn" and self._left(self.after):
            self._again(part(progress, 0.95, 0.97))
        self.passed = self._passed(part(progress, 0.97, 1.0))
        after = self._depths(part(progress, 1.0, 1.0))
        self.excluded = [Excluded(*pair, deep[pair], depth) for pair, depth in after.items()]

    def result(self, progress: Progress) -> OverclosureResult:
        """Measure the bodies and put the result together."""
        return result_of(
            self.solids,
            self.before,
            self.after,
            self.efforts,
            self._settings,
            tuple(self.history),
            self.stop,
            self.through,
            self.untold,
            self.passed,
            self.excluded,
            progress,
        )

    def _depths(self, progress: Progress) -> dict[tuple[str, str], float]:
        """How deep each of the excluded pairs is; 0 where it does not overlap, or where nobody can tell."""
        if not self._spared:
            return {}
        out = {(self.solids[i].name, self.solids[j].name): 0.0 for i, j in self._spared}
        found = find(self.solids, self._spared, 0.0, progress, volumes=False)
        untold, least = self._untold(found), ROUNDED * max(solid.surface.diagonal for solid in self.solids)
        depths = {f.names: max(f.depth, f.edge_depth) for f in found if f.names not in untold}
        return out | {names: depth for names, depth in depths.items() if depth > least}

    def _run_through(self) -> dict[tuple[str, str], str]:
        of = {solid.name: solid for solid in self.solids}
        return {
            finding.names: sheet
            for finding in self.before
            for sheet, body in (finding.names, finding.names[::-1])
            if finding.crossings and runs_through(of[sheet], of[body])
        }

    def _untold(self, findings: Iterable[Finding]) -> dict[tuple[str, str], str]:
        """Return pairs that overlap by the normals of an open body alone: nothing crosses, and it is deep.

        What faces a hole is neither inside nor outside, however deep the normals around the hole say.
        """
        of = {solid.name: solid for solid in self.solids}
        return {
            finding.names: other
            for finding in findings
            for own, other in (finding.names, finding.names[::-1])
            if finding.state == OVERLAP
            and not finding.crossings
            and finding.depth > UNTOLD * min(of[name].surface.diagonal for name in finding.names)
            and of[other].open_edges
            and (of[own].surface.vertices == finding.where).all(axis=1).any()
        }

    def _find(self, progress: Progress, bounds: Bounds | None = None) -> list[Finding]:
        """Measure all pairs anew."""
        return find(self.solids, self._asked, band_of(self.solids, self._settings), progress, bounds=bounds)

    def _alone(self) -> set[tuple[str, str]]:
        """Return the names of pairs that nothing can be done about."""
        rigid = [solid.name for solid in self.solids if solid.share == 0]
        contained = {finding.names for finding in self.before if finding.state == CONTAINED}
        return contained | self.untold.keys() | set(itertools.combinations(rigid, 2))

    def _left(self, found: Sequence[Finding]) -> list[Finding]:
        """Return what is not clear of the pairs that something can be done about."""
        alone = self._alone()
        return [finding for finding in found if not finding.clear and finding.names not in alone]

    def _in_sight(self) -> list[tuple[int, int]]:
        """Return the pairs that may have to be moved, in the order of the bodies; also clear ones, if near.

        Others may push these together.
        """
        near = band_of(self.solids, self._settings) + SIGHT * _farthest(self._left(self.before))
        apart = self._boxes().apart(list(self._asked))
        alone = self._alone()
        return [
            (i, j)
            for ((i, j), gap), far in zip(self._asked.items(), apart, strict=True)
            if far <= near + 2.0 * gap and (self.solids[i].name, self.solids[j].name) not in alone
        ]

    def _begun(
        self, pairs: Iterable[tuple[int, int]], bounds: Bounds, stuck: Container[tuple[str, str]] = ()
    ) -> list[Effort]:
        """Return an effort for each pair; those that are `stuck` are parted first."""
        settings = self._settings
        if settings.method != "grnn":
            settings = dataclasses.replace(settings, continuation=False)
        left, boxes = self._left(self.before), self._boxes()
        deep = {finding.names for finding in self.before if finding.state in (OVERLAP, CONTAINED)}
        jobs = []
        for i, j in pairs:
            one, two = self.solids[i], self.solids[j]
            margin = max(one.rounding, two.rounding)
            pair = Pair(one, two, self._asked[i, j])
            for side in pair.sides:
                side.bound = bounds.pop((side.body.name, side.other.name), side.bound)
            stride = self._stride((i, j), left, boxes)
            at_first = pair.names in stuck, pair.names not in deep
            jobs.append(partial(Effort, pair, settings, margin, stride, *at_first))
        return together(jobs)

    def _removed(
        self, efforts: list[Effort], history: list[Step], progress: Progress
    ) -> tuple[str, list[Finding]]:
        """Run the method until the certificate holds; return why it stopped short, or "", and what is left.

        The loop may think that it is done and be wrong, for it remembers much, and pairs may have come near
        that were out of sight: then it goes on with these, and with all forgotten.
        """
        settings, ours = self._settings, self._settings.method == "grnn"
        doubtful = all(finding.clear or finding.names in self.through for finding in self.before)
        if doubtful and ours:
            settings = dataclasses.replace(settings, iterations=min(settings.iterations, THROUGH))
        failures = 0
        while True:
            share = part(progress, 0.0, 0.9)
            stop = METHODS[settings.method](efforts, self.solids, settings, history, share, self._preview)
            progress(0.9, "overclosure: certificate")
            for effort in efforts:
                effort.pair.rest()
            after = self._find(part(progress, 0.9, 1.0))
            left = self._left(after)
            if stop or not left or not ours:
                break
            unknown = self._unknown(left, efforts)
            failures += not unknown  # there are so many pairs and no more: that has an end
            if failures == TRIES:
                stop = f"the certificate failed {TRIES} times"
                break
            for effort in efforts:
                effort.forget()
            efforts += self._begun(unknown, {})
        if stop and ours and (doubtful or not _better(self._left(after), self._left(self.before))):
            for solid in self.solids:
                solid.put(solid.rest)
            return stop, list(self.before)
        return stop, after

    def _unknown(self, found: Sequence[Finding], efforts: Sequence[Effort]) -> list[tuple[int, int]]:
        """Return the pairs found that nothing has been done about yet."""
        known = {effort.pair.names for effort in efforts}
        number = {solid.name: number for number, solid in enumerate(self.solids)}
        return [(number[f.one], number[f.two]) for f in found if f.names not in known]

    def _again(self, progress: Progress) -> None:
        """Begin anew with the pairs that are stuck, held apart or shaken; what ends no better is dropped."""
        through = {effort.pair.names for effort in self.efforts if effort.through}
        left = [finding for finding in self._left(self.after) if finding.names not in through]
        stuck = {finding.names for finding in left}
        edge = min(solid.surface.mean_edge for solid in self.solids)
        depths = (max(finding.depth, finding.edge_depth) for finding in left)
        little = max(depths, default=np.inf) < NEARLY * edge
        here = [(solid.points, solid.held) for solid in self.solids]
        for shaken in (0.0, *SHAKEN) if little else (0.0,):
            for solid in self.solids:
                solid.put(solid.rest)
                solid.held = set()
            if shaken:
                self._shake(stuck, shaken)
            again = self._begun(self._in_sight(), {}, () if shaken else stuck)
            if not shaken and not any(effort.through and effort.pair.names in stuck for effort in again):
                continue
            steps: list[Step] = []  # the history is that of the state that is returned
            failed, found = self._removed(again, steps, progress)
            if not failed and not self._left(found):
                self.efforts, self.history, self.stop, self.after = again, steps, failed, found
                return
        for solid, (points, held) in zip(self.solids, here, strict=True):
            solid.put(points)
            solid.held = held

    def _passed(self, progress: Progress) -> list[Passing]:
        """Return what went through each other: no certificate of the end alone can tell."""
        deep = {finding.names for finding in self.before if finding.state in (OVERLAP, CONTAINED)}
        beside = deep | {finding.names for finding in self.after if not finding.clear}
        of = [solid.name for solid in self.solids]
        return passed(self.solids, [(i, j) for i, j in self._asked if (of[i], of[j]) not in beside], progress)

    def _shake(self, stuck: Container[tuple[str, str]], edges: float) -> None:
        """Move nodes by up to so many mean edges where stuck pairs overlap: one plane leads nowhere."""
        random = np.random.default_rng(0)
        for i, j in self._asked:
            one, two = self.solids[i], self.solids[j]
            if (one.name, two.name) not in stuck:
                continue
            bounds = one.surface.bounds, two.surface.bounds
            edge = min(one.surface.mean_edge, two.surface.mean_edge)
            low = np.maximum(bounds[0][0], bounds[1][0]) - edge
            high = np.minimum(bounds[0][1], bounds[1][1]) + edge
            for solid in (one, two):
                points = solid.points.copy()
                near = ((points >= low) & (points <= high)).all(axis=1) & (solid.share > 0)
                points[near] += random.uniform(-edges * edge, edges * edge, (int(near.sum()), 3))
                solid.put(points)

    def _boxes(self) -> Boxes:
        """Boxes around the bodies as they stand."""
        return Boxes([solid.surface for solid in self.solids])

    def _stride(self, pair: tuple[int, int], left: Sequence[Finding], boxes: Boxes) -> float:
        """Return how far one step of a pair may go, so that no third body near it is passed through."""
        thinnest, farthest = np.inf, _farthest(left)
        near = {self.solids[number].name for number in pair}
        for mine in pair:
            apart = boxes.apart([(mine, number) for number in range(len(self.solids))])
            for number in np.flatnonzero(apart <= 2.0 * farthest).tolist():
                if number not in pair and (min(number, mine), max(number, mine)) in self._asked:
                    thinnest = min(thinnest, *(thickness(self.solids[n].surface) for n in (*pair, number)))
                    near.add(self.solids[number].name)
        here = _farthest([finding for finding in left if near.intersection(finding.names)])
        return max(STRIDE * thinnest, here / STRIDES)


def _farthest(found: Sequence[Finding]) -> float:
    """By how much the gap is missed at most: how far a pair may have to go."""
    return max((finding.gap - finding.least for finding in found), default=0.0)


def _better(after: Sequence[Finding], before: Sequence[Finding]) -> bool:
    """Whether a state that may not be clear is at least less deep, or crosses less and is no deeper."""
    now, then = (
        (sum(max(f.gap - f.least, 0.0) for f in found), sum(f.crossings for f in found))
        for found in (after, before)
    )
    crosses_less = now[1] < GAINED * then[1] and now[0] <= then[0]
    return all(f.clear for f in after) or now[0] < GAINED * then[0] or crosses_less
