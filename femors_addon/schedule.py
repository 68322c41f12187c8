# SPDX-License-Identifier: GPL-3.0-or-later
"""The iterations of a morph, made from its settings: on which mesh, with which spread and normal weight."""

from __future__ import annotations

import dataclasses

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


def stages(settings: MorphSettings, edges: list[float], size: float) -> list[Stage]:
    """Return the stages of a morph.

    Parameters
    ----------
    edges : list of float
        Mean edge length of each level, the larger of source's and target's, coarsest first.
    size : float
        Diagonal of the target's bounding box.
    """
    dense = len(edges) - 1
    floor = settings.spread_end
    weight = settings.normal_weight or NORMALS * size
    fine_weight = settings.fine_normal_weight or FINE_NORMALS * weight
    start = settings.spread_start or START * size
    out = []

    def add(name: str, level: int, count: int, first: float, last: float, share: float) -> None:
        coarse = name == "reduced"
        decay = {"reduced": settings.spread_decay, "fine": settings.fine_spread_decay}.get(
            name, settings.dense_spread_decay
        )
        spreads = _falling(first, last, count, decay)
        if settings.correspondence == "surface":
            share = 0.0
        elif settings.correspondence == "nearest":
            share = 1.0
        base = weight if coarse else fine_weight
        normal_decay = settings.normal_decay if coarse else settings.fine_normal_decay
        looks = [
            base * (normal_decay**i if normal_decay > 0 else (spread / first) ** 0.5)
            for i, spread in enumerate(spreads)
        ]
        iterations = tuple(
            Iteration(spread, look if i < round(share * count) else None)
            for i, (spread, look) in enumerate(zip(spreads, looks, strict=True))
        )
        scale = {"reduced": settings.step_scale, "fine": settings.fine_step_scale}.get(
            name, settings.dense_step_scale
        )
        if iterations:
            out.append(Stage(name, level, scale, iterations))

    if dense > 0 or settings.levels > 0:
        add("reduced", 0, settings.iterations, start, max(LEVEL_END * edges[0], floor), 1.0)
    if dense == 1 and settings.spread_end > 0:
        add("fine", 0, settings.fine_iterations, settings.spread_end, settings.spread_end, 0.0)
    for level in range(1, dense):
        first = RESTART * edges[level - 1]
        last = max(LEVEL_END * edges[level], floor)
        count = settings.fine_iterations if level == 1 else -(-settings.fine_iterations // 2 ** (level - 1))
        add("fine", level, count, max(first, last), last, NORMALS_SHARE)
    if dense and dense < settings.levels and not settings.spread_decay:
        # a mesh too small for all the levels has its finer iterations on the dense one
        first, last = RESTART * edges[dense - 1], max(LEVEL_END * edges[dense], floor)
        add("fine", dense, settings.fine_iterations, max(first, last), last, NORMALS_SHARE)
    last = settings.spread_end or DENSE_END * edges[dense]
    first = RESTART * edges[max(dense - 1, 0)]
    if settings.dense_spread_decay and settings.spread_start:
        first = settings.spread_start
    add("dense", dense, settings.dense_iterations, max(first, last), last, 0.0)
    return out


def _falling(first: float, last: float, count: int, decay: float) -> list[float]:
    """Spreads of `count` iterations: by a given decay, or evenly (geometrically) down to `last`."""
    first = max(first, last)
    if decay > 0:
        return [first * decay**i for i in range(count)]
    if count == 1:
        return [last]
    return [first * (last / first) ** (i / (count - 1)) for i in range(count)]
