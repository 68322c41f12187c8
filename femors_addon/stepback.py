# SPDX-License-Identifier: GPL-3.0-or-later
"""What cannot be laid out on the target gives up some of the fit: it goes back, by the way that suits it.

Bad faces near each other are a site. All ways there are tried on all sites at once, narrow ones first, and
each site takes the one that leaves least bad in it; then its nodes return to the target as far as they may.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from operator import attrgetter

import numpy as np
from scipy import sparse

from . import triples
from .correspond import compatible
from .faults import Judge, State
from .folds import harmonic
from .mesh import Float, Int
from .morph_settings import MorphSettings
from .nearest import SurfaceIndex
from .patches import Hanging, evened, patch, turned
from .progress import Progress, silent
from .relax import averaging

BACK, BETWEEN = (
    (1, 2, 3, 5, 8),
    (4, 6),
)  # edges around a bad face that step back; and where none of these helps
ROUNDS = 8  # of averaging, per edge of the patch's width
TIMES = 12  # that a way is chosen: where bones have nothing in common each takes away a little, and long
TURNS = (0.3, 1.5)  # heights that a face on its back is given when it is turned over, beside its own
APPROACHES, HOLDS = 6, 5  # half-way steps back to the target, and times that nodes of each may be held


def step_back(
    judge: Judge, begun: State, target: SurfaceIndex, settings: MorphSettings, progress: Progress = silent
) -> State:
    """Mend what is bad in a part at the cost of the fit.

    All the ways that there are (`_ways`) are tried, until nothing is bad or no way helps; then nodes return
    towards the target as far as no face gets worse. Nothing goes farther than `judge.part.far` from where
    it was, which would be another fault.
    """
    state, mean, stuck = begun, averaging(judge.aligned), np.empty(0, dtype=np.int32)
    for _ in range(TIMES):
        at = np.setdiff1d(state.worst, stuck)
        if not len(at):
            break
        sites = _Sites(judge, state, at)
        state = sites.best(begun, mean, progress)
        stuck = np.union1d(stuck, at[~sites.helped(at)])
    nodes = np.flatnonzero(triples.some(state.positions != begun.positions))
    nearer = _approached(judge, state, nodes, target, settings, progress)
    far = triples.length(nearer.positions - begun.positions).max(initial=0.0) > judge.part.far
    return state if far else nearer


class _Sites:
    """Places with bad faces, so far from each other that each may take a way of its own."""

    def __init__(self, judge: Judge, state: State, at: Int) -> None:
        self._judge, self._state, self._at = judge, state, at
        self._hanging = Hanging.of(judge.aligned, patch(judge.aligned, at, max(BACK)) & judge.part.may)
        self._before = self._tally(state)
        self._helped = np.zeros(self._hanging.count + 1, dtype=bool)

    def helped(self, faces: Int) -> np.ndarray:
        """Whether some faces (r,) are of sites that `best` has changed."""
        return np.asarray(self._helped[self._hanging.of_faces(faces)])

    def best(self, begun: State, mean: sparse.csr_matrix, progress: Progress) -> State:
        """The state in which each site has taken the way that leaves least bad in it, if any leaves less."""
        judge, state, least = self._judge, self._state, self._before
        positions, single = state.positions.copy(), state
        for way, late in _ways(judge, state, mean):
            progress(0.5, "stepping back from the target")
            # a site that has nothing bad any more needs no wider way
            done = self._helped if late else self._clean(least)
            at = self._at[~done[self._hanging.of_faces(self._at)]]
            if not len(at):
                continue
            after = self._tried(begun, *way(at))
            tally = self._tally(after)
            fewer = _less(tally, least)
            fewer[-1] = False
            taken = fewer[self._hanging.label]
            positions[taken] = after.positions[taken]
            self._helped |= fewer
            least = [np.where(fewer, new, old) for new, old in zip(tally, least, strict=True)]
            single = min(single, after, key=attrgetter("tally"))
        found = min(judge.after(state, positions), single, key=attrgetter("tally"))
        if found is single:  # sites are in each other's way after all
            moved = triples.some(found.positions != state.positions)
            self._helped[:] = False
            self._helped[self._hanging.label[moved]] = True
        return found

    def _tried(self, begun: State, trial: Float, inside: np.ndarray) -> State:
        """The state where the patches that a trial mends, and no others, have moved."""
        judge, state = self._judge, self._state
        after = judge.after(state, trial)
        if after is state:
            return state
        patches = Hanging.of(judge.aligned, inside)
        fewer = patches.better(state.bad, after.bad)
        fewer &= patches.small(triples.length(trial - begun.positions), judge.part.count, judge.part.far)
        return after if fewer.all() else judge.after(state, np.where(fewer[:, None], trial, state.positions))

    def _tally(self, state: State) -> list[np.ndarray]:
        """How many faces of each site are folded over or cross others, and how bad they are."""
        rows = np.flatnonzero(state.bad)
        site, bad = self._hanging.of_faces(rows), state.bad[rows]
        return [np.bincount(site, weights, self._hanging.count + 1) for weights in (bad >= 1.0, bad)]

    def _clean(self, tally: list[np.ndarray]) -> np.ndarray:
        """Whether nothing in a site is folded over or crosses others, nor more squeezed than before."""
        return (tally[0] == 0) & (tally[1] < self._before[1] - self._before[0] + 1e-9)


def _less(one: list[np.ndarray], two: list[np.ndarray]) -> np.ndarray:
    """Where the first tally is less than the second."""
    return (one[0] < two[0]) | ((one[0] == two[0]) & (one[1] < two[1] - 1e-9))


def _ways(
    judge: Judge, state: State, mean: sparse.csr_matrix
) -> Iterator[tuple[Callable[[Int], tuple[Float, np.ndarray]], bool]]:
    """Ways to mend some bad faces, and whether each is only for where no other helps.

    They give the positions (k, 3) to try, and the nodes (k,) that they move.

    A single face that lies on its back is turned over a side; patches go back off the target, for `aligned`
    has neither folds nor crossings that are not its own, and a harmonic displacement makes none as long as
    it differs little from node to node; or they are evened out.
    """
    aligned, may, positions = judge.aligned, judge.part.may, state.positions

    def over(at: Int, side: int, share: float) -> tuple[Float, np.ndarray]:
        ring = patch(aligned, at, 1) & may
        return np.where(ring[:, None], turned(state.surface, at, side, share), positions), ring

    def back(at: Int, rings: int) -> tuple[Float, np.ndarray]:
        inside = patch(aligned, at, rings) & may
        away = harmonic(positions - aligned.vertices, inside, mean, rings)
        return np.where(inside[:, None], aligned.vertices + away, positions), inside

    def even(at: Int, rings: int) -> tuple[Float, np.ndarray]:
        inside = patch(aligned, at, rings) & may
        return evened(aligned, positions, np.flatnonzero(inside), ROUNDS * rings), inside

    for share in TURNS:
        for side in range(3):
            yield partial(over, side=side, share=share), False
    for rings in (*BACK, *BETWEEN):
        yield partial(back, rings=rings), rings in BETWEEN
        yield partial(even, rings=rings), rings in BETWEEN


def _approached(
    judge: Judge, state: State, nodes: Int, target: SurfaceIndex, settings: MorphSettings, progress: Progress
) -> State:
    """Move nodes towards the target as long as no face gets worse; return the state that they reach."""
    free = np.zeros(len(state.positions), dtype=bool)
    free[nodes] = True
    together = Hanging.of(judge.aligned, free)
    for _ in range(APPROACHES if len(nodes) else 0):
        point, kept = compatible(state.surface, nodes, target, settings.partial)
        step = np.where(kept[:, None], 0.5 * settings.projection * (point - state.positions[nodes]), 0.0)
        held = np.zeros(len(state.positions), dtype=bool)
        for number in range(HOLDS):
            progress(0.9, "returning to the target")
            trial = state.positions.copy()
            trial[nodes] += np.where(held[nodes, None], 0.0, step)
            after = judge.after(state, trial)
            worse = np.flatnonzero(after.bad > state.bad)
            if not len(worse):
                state = after
                break
            held |= patch(judge.aligned, worse, 1)
            if number == HOLDS - 2:  # else none would move, for the sake of a few
                held |= together.all_of(held)
    return state
