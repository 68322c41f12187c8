# SPDX-License-Identifier: GPL-3.0-or-later
"""Units of length: whether two meshes seem to be in different ones."""

from __future__ import annotations

import math
from collections.abc import Sequence

from .mesh import Surface
from .poses import spread_of
from .progress import FemorsError

METRIC = (10.0, 100.0, 1000.0, 1e6, 1e9)
IMPERIAL = (25.4, 304.8)
NEAR = 1.5  # times a unit factor, or as small a part of it: so much people and bones of one kind differ
SURE = 1.15  # the same of inches and feet, which are rare
FAIR = 3.0  # and of a metric one, where the sizes differ beyond what anatomy has
ALIKE, ALIKE_PARTIAL = 4.0, 60.0  # ratio of sizes up to which both may well be in one unit
BEYOND = 20.0  # ratio of two whole things' sizes that no anatomy has


def size_ratio(source: Surface, target: Surface) -> float:
    """Return how many times as large as the source the target is, by the spread of their vertices."""
    return spread_of(target.vertices) / spread_of(source.vertices)


def nearest_of(ratio: float, factors: Sequence[float], near: float = math.inf) -> float | None:
    """Return the factor that a ratio (1 or more) is closest to; None where all are `near` times off."""
    factor = min(factors, key=lambda one: abs(math.log(ratio / one)))
    return factor if abs(math.log(ratio / factor)) <= math.log(near) else None


def unit_factor(source: Surface, target: Surface, partial: str = "none") -> float | None:
    """Return the factor that would bring the source to the target's unit, if one seems needed.

    A part may well be a tenth of the whole: where one mesh is partial the sizes must differ more.

    Raises
    ------
    FemorsError
        Whole meshes whose sizes differ more than those of any two of a kind, and by no unit's factor.
    """
    ratio = size_ratio(source, target)
    times = max(ratio, 1.0 / ratio)
    if times < (ALIKE if partial == "none" else ALIKE_PARTIAL):
        return None
    if partial != "none":
        factor = nearest_of(times, METRIC[2:])
    elif times <= BEYOND:
        factor = nearest_of(times, METRIC[:1], NEAR)
    else:
        factor = nearest_of(times, IMPERIAL, SURE) or nearest_of(times, METRIC, FAIR)
        if factor is None:
            raise FemorsError(
                f"{_unlike(ratio)}, near no ratio of two units: scale one of them, or set Overlap if one "
                "is a part of the other"
            )
    if factor is None:
        return None
    return factor if ratio > 1.0 else 1.0 / factor


def unlike_sizes(source: Surface, target: Surface, partial: str = "none") -> tuple[str, ...]:
    """Return what to say of two whole meshes of quite different sizes, whose ratio is that of no units."""
    ratio = size_ratio(source, target)
    if partial != "none" or 1.0 / ALIKE < ratio < ALIKE or unit_factor(source, target) is not None:
        return ()
    return (_unlike(ratio),)


def _unlike(ratio: float) -> str:
    kind = "larger" if ratio > 1.0 else "smaller"
    return f"the target is {max(ratio, 1.0 / ratio):.4g} times {kind} than the source"
