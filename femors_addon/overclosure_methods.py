# SPDX-License-Identifier: GPL-3.0-or-later
"""What FEMORS' own loop is compared with: the nodal method, and the paper's loop as published.

Both look at nodes only, and neither knows of edges or elements: the certificate says what they leave.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .bodies import Solid
from .effort import Effort
from .grnn import DisplacementField
from .mesh import Float, Int
from .overclosure_result import Step
from .overclosure_settings import OverclosureSettings
from .progress import Progress
from .sides import Side

SPREAD, SPREAD_DECAY = 10.0, 0.99995  # mm; per iteration
SAMPLE, SAMPLE_GROWTH = 0.01, 1.005  # share of the surfaces' nodes that is looked at, and its growth
INTERIOR = 0.75  # share of the inner nodes that stand in the field with no displacement
MOMENTUM = 1.0  # share of the step before that is added to each
LIMIT, STOP = 500, 1e-5  # iterations; overclosure that counts as none
SEED = 2024


def nodal(
    efforts: list[Effort],
    solids: Sequence[Solid],
    settings: OverclosureSettings,
    history: list[Step],
    progress: Progress,
    preview: Any,
) -> str:
    """Move each node that is too near straight out by its share, and no other; repeat."""
    for number in range(settings.iterations):
        missing = 0.0
        for effort in efforts:
            pair = effort.pair
            pair.look(effort.target)
            missing = max(missing, effort.target - pair.deepest(True))
            steps = {}
            for side, weight in zip(pair.sides, pair.weights, strict=True):
                rows = np.flatnonzero(side.found.gaps < effort.target)
                if not weight or not len(rows):
                    continue
                asked = (effort.target - side.found.gaps[rows])[:, None]
                step = weight * asked * side.found.ways[rows]
                side.body.move(side.body.corner[rows], step, guard=False)
                distance = np.zeros(len(side.body.corner))
                distance[rows] = np.linalg.norm(step, axis=1)
                steps[side.body.name] = (distance, float(distance.max()))
            for other in efforts:
                other.pair.moved(steps)
                other.pair.catch_up()
        history.append(Step(number + 1, max(missing, 0.0), 0, 0.0))
        progress(number / settings.iterations, f"nodal, iteration {number + 1}, depth {missing:.3g}")
        if preview is not None:
            preview({solid.name: solid.nodes for solid in solids})
        if missing <= STOP:
            return ""
    return f"iteration limit ({settings.iterations}) reached"


def published(
    efforts: list[Effort],
    solids: Sequence[Solid],
    settings: OverclosureSettings,
    history: list[Step],
    progress: Progress,
    preview: Any,
) -> str:
    """Run the loop of Andreassen et al. (2024) with the settings of the authors' batch.

    Random parts of the surfaces' nodes, growing from 1 %, give the vectors; nodes without overclosure
    give zero vectors; one field of 10 mm moves all nodes, and each step adds the one before. The
    authors' weighting of vectors, taken back after the field, has no effect on a mean and is left out.
    """
    random = np.random.default_rng(SEED)
    sides = [side for effort in efforts for side in effort.pair.sides]
    order = {id(side): random.permutation(len(side.body.corner)).astype(np.int32) for side in sides}
    inner = {solid.name: _inner(solid, random) for solid in solids}
    last = {solid.name: np.zeros_like(solid.points) for solid in solids}
    for number in range(LIMIT):
        missing, spread = 0.0, SPREAD * SPREAD_DECAY**number
        steps = {solid.name: MOMENTUM * last[solid.name] for solid in solids}
        for effort in efforts:
            pair = effort.pair
            pair.look(np.inf)
            missing = max(missing, effort.target - pair.deepest(True))
            field = _trained(effort, order, inner, min(SAMPLE * SAMPLE_GROWTH**number, 1.0), spread)
            for solid, weight in zip((pair.one, pair.two), (pair.weights[0], -pair.weights[1]), strict=True):
                if weight:
                    steps[solid.name] = steps[solid.name] + weight * field(solid.points)
        history.append(Step(number + 1, max(missing, 0.0), 0, spread))
        progress(number / LIMIT, f"as published, iteration {number + 1}, depth {missing:.3g}")
        if missing <= STOP:
            return ""
        for solid in solids:
            if solid.share > 0:
                solid.move(np.arange(len(solid.points)), steps[solid.name], guard=False)
        last = steps
        for effort in efforts:
            effort.pair.forget()
        if preview is not None:
            preview({solid.name: solid.nodes for solid in solids})
    return f"iteration limit ({LIMIT}) reached"


def _trained(
    effort: Effort, order: dict[int, Int], inner: dict[str, Int], share: float, spread: float
) -> DisplacementField:
    """Return the field of a pair's vectors at a part of its nodes, the second body's negated."""
    centres: list[Float] = []
    vectors: list[Float] = []

    def add(side: Side) -> None:
        rows = order[id(side)][: max(1, round(share * len(side.body.corner)))]
        gaps = side.found.gaps[rows]
        asked = np.where(np.isfinite(gaps), np.maximum(effort.target - gaps, 0.0), 0.0)
        loose = side.body.points[inner[side.body.name]]
        centres.extend((side.body.vertices[rows], loose))
        vectors.extend((side.sign * asked[:, None] * side.found.ways[rows], np.zeros_like(loose)))

    for side in effort.pair.sides:
        add(side)
    return DisplacementField(np.concatenate(centres), np.concatenate(vectors), spread)


def _inner(solid: Solid, random: np.random.Generator) -> Int:
    """Three quarters of the nodes that are not on the surface, at random."""
    inside = np.setdiff1d(np.arange(len(solid.points)), solid.corner)
    chosen: Int = random.permutation(inside)[: round(INTERIOR * len(inside))].astype(np.int32)
    return chosen
