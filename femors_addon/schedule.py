# SPDX-License-Identifier: GPL-3.0-or-later
"""The iterations of a morph, made from its settings: on which mesh, with which spread and normal weight."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import NamedTuple

from .morph_settings import MorphSettings

COARSEST = 1500  # nodes of the coarsest level, where no reduction is given
GROWTH = 4  # times as many nodes on the next finer level
LEAP = 3.0  # times as many nodes on the dense mesh as a further level would have, for there to be one
START = 0.15  # of the target's size: the first spread
LEVEL_END = 1.5  # mean edges: the last spread of a reduced level
DENSE_END = 1.4  # mean edges: the last spread of all
CARRY = 1.5  # mean edges: the spread that carries a level's displacement to the next
RESTART = 2.5  # mean edges of the level before: the first spread of a finer level
NORMALS = 0.12  # of the target's size: length that a unit normal stands for
FINE_NORMALS = 0.5  # of that: from the finer levels on
NORMALS_SHARE = 0.6  # of a finer level's iterations that look at normals, where both ways are mixed


@dataclasses.dataclass(frozen=True)
class Iteration:
    """One iteration to be done.

    Attributes
    ----------
    spread : float
        Of the field, in the target's unit.
    normal_weight : float or None
        Length of a unit normal in the nearest-node search; None takes closest surface points.
    """

    spread: float
    normal_weight: float | None


@dataclasses.dataclass(frozen=True)
class Stage:
    """Iterations on one level: `level` counts from the coarsest, the dense mesh is the last."""

    name: str
    level: int
    step_scale: float
    iterations: tuple[Iteration, ...]


def node_counts(settings: MorphSettings, nodes: int) -> list[int]:
    """Return the node counts of the reduced levels of a mesh of so many nodes, coarsest first."""
    levels = settings.levels
    if settings.reduction > 0:
        counts = [int(nodes * settings.reduction / GROWTH**k) for k in range(levels)][::-1]
    else:
        while levels and COARSEST * GROWTH**levels * LEAP < nodes:
            levels += 1  # a very dense mesh takes more levels, for its details not to come all at once
        counts = [COARSEST * GROWTH**k for k in range(levels)]
    return [count for count in counts if 20 <= count < 0.9 * nodes]


class _Rates(NamedTuple):
    """What the iterations of a stage have in common."""

    spread_decay: float  # factor from one spread to the next; 0: whatever leads to the last one
    normal_weight: float  # length that a unit normal stands for in the first iteration
    normal_decay: float  # factor from one such length to the next; 0: as the root of the spread
    step_scale: float


class _Run(NamedTuple):
    """A stage in numbers."""

    name: str
    level: int
    iterations: int
    first: float  # spread
    last: float
    by_normals: float  # share of the iterations that look at normals, where both ways are mixed


def stages(settings: MorphSettings, edges: list[float], size: float) -> list[Stage]:
    """Return the stages of a morph.

    Parameters
    ----------
    settings : MorphSettings
    edges : list of float
        Mean edge length of each level, the larger of source's and target's, coarsest first.
    size : float
        Diagonal of the target's bounding box.
    """
    rates = _rates(settings, size)
    only = {"surface": 0.0, "nearest": 1.0}.get(settings.correspondence)
    out = []
    for run in _runs(settings, edges, size):
        rate, share = rates[run.name], run.by_normals if only is None else only
        spreads = _falling(run.first, run.last, run.iterations, rate.spread_decay)
        weights = [
            rate.normal_weight
            * (rate.normal_decay**i if rate.normal_decay > 0 else (spread / run.first) ** 0.5)
            for i, spread in enumerate(spreads)
        ]
        iterations = tuple(
            Iteration(spread, weight if i < round(share * run.iterations) else None)
            for i, (spread, weight) in enumerate(zip(spreads, weights, strict=True))
        )
        if iterations:
            out.append(Stage(run.name, run.level, rate.step_scale, iterations))
    return out


def _rates(settings: MorphSettings, size: float) -> dict[str, _Rates]:
    """The rates of each kind of stage."""
    s = settings
    coarse = s.normal_weight or NORMALS * size
    fine = s.fine_normal_weight or FINE_NORMALS * coarse
    return {
        "reduced": _Rates(s.spread_decay, coarse, s.normal_decay, s.step_scale),
        "fine": _Rates(s.fine_spread_decay, fine, s.fine_normal_decay, s.fine_step_scale),
        "dense": _Rates(s.dense_spread_decay, fine, s.fine_normal_decay, s.dense_step_scale),
    }


def _runs(settings: MorphSettings, edges: list[float], size: float) -> Iterator[_Run]:
    """The stages in order: the coarsest level, the finer ones, the dense mesh (the last of `edges`)."""
    dense = len(edges) - 1
    first = settings.spread_start or START * size
    ends = [max(LEVEL_END * edge, settings.spread_end) for edge in edges]
    if dense > 0 or settings.levels > 0:
        yield _Run("reduced", 0, settings.iterations, first, ends[0], 1.0)
    if dense == 1 and settings.spread_end > 0:
        spread = settings.spread_end
        yield _Run("fine", 0, settings.fine_iterations, spread, spread, 0.0)
    finer = list(range(1, dense))
    if dense and dense < settings.levels and not settings.spread_decay:
        finer.append(dense)  # a mesh too small for all the levels has its finer iterations on the dense one
    for level in finer:
        first = max(RESTART * edges[level - 1], ends[level])
        halvings = level - 1 if level < dense else 0
        count = -(-settings.fine_iterations // 2**halvings)
        yield _Run("fine", level, count, first, ends[level], NORMALS_SHARE)
    last = settings.spread_end or DENSE_END * edges[dense]
    first = RESTART * edges[max(dense - 1, 0)]
    if settings.dense_spread_decay and settings.spread_start:
        first = settings.spread_start
    yield _Run("dense", dense, settings.dense_iterations, max(first, last), last, 0.0)


def _falling(first: float, last: float, count: int, decay: float) -> list[float]:
    """Spreads of `count` iterations: by a given decay, or evenly (geometrically) down to `last`."""
    first = max(first, last)
    if decay > 0:
        return [first * decay**i for i in range(count)]
    if count == 1:
        return [last]
    return [first * (last / first) ** (i / (count - 1)) for i in range(count)]
