# SPDX-License-Identifier: GPL-3.0-or-later
"""What cannot be laid out on the target gives up some of the fit: it goes back, by the way that suits it.

Bad faces near each other are a site. All ways there are tried on all sites at once, narrow ones first, and
each site takes the one that leaves least bad in it; then its nodes return to the target as far as they may.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from operator import attrgetter

import numpy as np
from scipy import sparse

from . import triples
from .correspond import compatible
from .faults import SQUEEZED, Judge, State
from .folds import harmonic
from .mesh import Float, Int, Surface
from .morph_settings import MorphSettings
from .nearest import SurfaceIndex
from .patches import Hanging, evened, patch, turned
from .progress import Progress, silent
from .quality import aspect_ratio
from .relax import averaging

BACK = (1, 2, 3, 4, 5, 6, 8)  # edges around a bad face that step back
ROUNDS = 8  # of averaging, per edge of the patch's width
TIMES = 12  # that a way is chosen: where bones have nothing in common each takes away a little, and long
MANY, GAIN = 500, 0.1  # faces, and share of them: where so many are bad and fewer got well, it is given up
TURNS = (0.3, 1.5)  # heights that a face on its back is given when it is turned over, beside its own
APPROACHES, HOLDS = 6, 5  # half-way steps back to the target, and times that nodes of each may be held


def step_back(
    judge: Judge, begun: State, target: SurfaceIndex, settings: MorphSettings, progress: Progress = silent
) -> State:
    """Mend what is bad in a part at the cost of the fit.

    All the ways that there are (`_ways`) are tried, until nothing is bad or no way helps, or they help little
    (`hopeless`); then nodes return towards the target as far as no face gets worse. Nothing goes farther than
    `judge.part.far` from where it was, which would be another fault.
    """
    state, mean = begun, averaging(judge.aligned)
    tried: dict[int, Float] = {}  # where nodes were when patches of so many edges were last tried
    for _ in range(TIMES):
        before = state
        for rings in BACK:
            last = state
            places = _Places.around(judge, state, rings, tried.get(rings))
            tried[rings] = state.positions
            if len(places.at):
                state = _best(judge, begun, state, places, mean, progress)
            if state is last and len(state.worst) > MANY:  # wider patches cost more, and help less
                break
        if state is before or hopeless(before, state):
            break
    nodes = np.flatnonzero(triples.some(state.positions != begun.positions))
    nearer = _approached(judge, state, nodes, target, settings, progress)
    far = triples.length(nearer.positions - begun.positions).max(initial=0.0) > judge.part.far
    return state if far else nearer


def hopeless(before: State, after: State) -> bool:
    """Whether a great many faces are still bad, and hardly any of them got well.

    Surfaces that have nothing in common, or that cross themselves all over, could be mended for minutes.
    """
    return len(after.worst) > max(MANY, (1.0 - GAIN) * len(before.worst))


@dataclasses.dataclass(frozen=True, eq=False)
class _Places:
    """Faces that are folded or cross others (q,), and the nodes within some edges of them, which may move."""

    at: Int
    inside: np.ndarray
    rings: int

    @classmethod
    def around(cls, judge: Judge, state: State, rings: int, tried: Float | None) -> _Places:
        """All there are, but for patches where nothing has moved since they were at the positions `tried`."""
        at = state.worst
        inside = patch(judge.aligned, at, rings) & judge.part.may
        if tried is not None and len(at):
            moved = inside & triples.some(state.positions != tried)
            inside = Hanging.of(judge.aligned, inside).all_of(moved)
            at = at[triples.some(inside[judge.aligned.faces[at]])]
        return cls(at, inside, rings)


def _best(
    judge: Judge, begun: State, state: State, places: _Places, mean: sparse.csr_matrix, progress: Progress
) -> State:
    """The state in which each patch has taken the way that leaves least bad in it, if any leaves less."""
    patches = Hanging.of(judge.aligned, places.inside)
    trials, least, positions = [], _tally(patches, state), state.positions.copy()
    for trial in _ways(judge, state, places, mean):
        progress(0.5, "stepping back from the target")
        after = judge.after(state, trial)
        if after is state:
            continue
        small = patches.small(triples.length(trial - begun.positions), judge.part.count, judge.part.far)
        left = _tally(patches, after)
        fewer = (left[0] < least[0]) | ((left[0] == least[0]) & (left[1] < least[1] - 1e-9))
        taken = fewer[patches.label] & small & places.inside
        positions[taken] = trial[taken]
        least = np.where(np.isin(np.arange(patches.count + 1), patches.label[taken]), left, least)
        trials.append(
            np.where((patches.better(state.bad, after.bad) & small)[:, None], trial, state.positions)
        )
    found = judge.after(state, positions)
    if found is not state and found.tally >= state.tally:  # patches are in each other's way after all
        found = min((judge.after(state, trial) for trial in trials), key=attrgetter("tally"))
    return found if found.tally < state.tally else state


def _tally(patches: Hanging, state: State) -> Float:
    """How many faces of each patch are folded over or cross others, and how bad its faces are: (2, p + 1)."""
    rows = np.flatnonzero(state.bad)
    where, bad = patches.of_faces(rows), state.bad[rows]
    return np.stack([np.bincount(where, each, patches.count + 1) for each in (bad >= 1.0, bad)])


def _ways(judge: Judge, state: State, places: _Places, mean: sparse.csr_matrix) -> Iterator[Float]:
    """Positions (k, 3) to try, in which no nodes have moved but those `inside`.

    A single face that lies on its back is turned over a side; patches go back off the target, for `aligned`
    has neither folds nor crossings that are not its own, and a harmonic displacement makes none as long as
    it differs little from node to node; or they are evened out.
    """
    aligned, positions, inside, rings = judge.aligned, state.positions, places.inside, places.rings
    for share in TURNS if rings == 1 else ():
        for side in range(3):
            yield np.where(inside[:, None], turned(state.surface, places.at, side, share), positions)
    away = harmonic(positions - aligned.vertices, inside, mean, rings)
    yield np.where(inside[:, None], aligned.vertices + away, positions)
    yield evened(aligned, positions, np.flatnonzero(inside), ROUNDS * rings)


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
            worse = _worse(state, after)
            if not len(worse):
                state = after
                break
            held |= patch(judge.aligned, worse, 1)
            if number == HOLDS - 2:  # else none would move, for the sake of a few
                held |= together.all_of(held)
    return state


def _worse(before: State, after: State) -> Int:
    """Faces (q,) that have become bad, or were squeezed and are so even more."""
    squeezed = np.flatnonzero(after.bad == SQUEEZED)
    faces = after.surface.faces[squeezed]
    then, now = (aspect_ratio(Surface(each.positions, faces)) for each in (before, after))
    more = squeezed[now > (1.0 + 1e-9) * then]
    return np.union1d(np.flatnonzero(after.bad > before.bad), more).astype(np.int32)
