# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a body went right through another: both ends are clear, but the way between them is not.

No measure of the end tells. Where a pair has moved far for its thinner body, it is looked at in steps on
the straight way from where it began to where it is.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Sequence

import numpy as np

from . import triples
from .bodies import Solid
from .distances import Target
from .findings import Finding
from .mesh import Float
from .pair_check import measure
from .progress import Progress
from .separation import thickness

FAR = 0.5  # of the thinner body's thickness: who has moved less, both together, cannot have passed
STEP, MOST = 0.15, 60  # of that thickness: one step of the way; and steps, at most
DEEP = 0.1  # of it: what is deeper on the way, and was not at its ends, has passed through


def passed(solids: Sequence[Solid], pairs: Iterable[tuple[int, int]], progress: Progress) -> list[Finding]:
    """Return the deepest state on the way of each pair that went through each other.

    Of open bodies nothing tells what is inside on the way.

    Parameters
    ----------
    pairs : iterable of (int, int)
        Those that overlap neither at the start nor at the end, by the numbers of the solids.
    """
    boxes = [triples.box(np.concatenate((s.begun_surface.vertices, s.vertices))) for s in solids]
    way = [float(triples.length(solid.displacement).max(initial=0.0)) for solid in solids]
    found = []
    for i, j in pairs:
        apart = np.maximum(boxes[i][0], boxes[j][0]) - np.minimum(boxes[i][1], boxes[j][1])
        if way[i] + way[j] == 0.0 or (apart > 0).any() or solids[i].open_edges or solids[j].open_edges:
            continue
        thin = min(thickness(solids[n].begun_surface) for n in (i, j))
        if not 0.0 < FAR * thin < way[i] + way[j]:
            continue
        steps = min(MOST, math.ceil((way[i] + way[j]) / (STEP * thin)))
        deepest: Finding | None = None
        for number in range(1, steps):
            progress(number / steps, f"the way of {solids[i].name} and {solids[j].name}")
            state = _state(solids[i], solids[j], number / steps)
            if state is not None and state.depth > (DEEP * thin if deepest is None else deepest.depth):
                deepest = state
        if deepest is not None:
            found.append(deepest)
    return found


def _state(one: Solid, two: Solid, share: float) -> Finding | None:
    """Measure a pair at a share of its way."""
    here, there = (Target(_on_its_way(solid, share)) for solid in (one, two))
    return measure(here, there, 0.0, 0.0, volumes=False)


def _on_its_way(solid: Solid, share: float) -> Solid:
    there: Float = solid.rest + share * (solid.points - solid.rest)
    out = copy.copy(solid)
    out.put(there)
    return out
