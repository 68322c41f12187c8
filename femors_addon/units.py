# SPDX-License-Identifier: GPL-3.0-or-later
"""Units of length: whether two meshes seem to be in different ones."""

from __future__ import annotations

import math
from collections.abc import Sequence

from .mesh import Surface
from .poses import principal_frame

UNIT_FACTORS = (10.0, 25.4, 100.0, 304.8, 1000.0)
NEAR = 1.5  # times a unit factor, or as small a part of it: so much people and bones of one kind differ
ALIKE, ALIKE_PARTIAL = 4.0, 60.0  # ratio of sizes up to which both may well be in one unit


def size_ratio(source: Surface, target: Surface) -> float:
    """Return how many times as large as the source the target is, by the spread of their vertices."""
    return principal_frame(target.vertices).radius / principal_frame(source.vertices).radius


def near_unit(ratio: float, factors: Sequence[float] = UNIT_FACTORS) -> float | None:
    """Return the unit factor, or the inverse of one, that a ratio of sizes is close to."""
    known = [f for factor in factors for f in (factor, 1.0 / factor)]
    factor = min(known, key=lambda f: abs(math.log(ratio / f)))
    return factor if abs(math.log(ratio / factor)) <= math.log(NEAR) else None


def unit_factor(source: Surface, target: Surface, partial: str = "none") -> float | None:
    """Return the factor that would bring the source to the target's unit, if one seems needed.

    A part may well be a tenth of the whole: where one mesh is partial the sizes must differ more.
    """
    ratio = size_ratio(source, target)
    alike = ALIKE if partial == "none" else ALIKE_PARTIAL
    if 1.0 / alike < ratio < alike:
        return None
    if partial != "none":
        return 1000.0 if ratio > 1.0 else 0.001
    return near_unit(ratio)


def unlike_sizes(source: Surface, target: Surface, partial: str = "none") -> tuple[str, ...]:
    """Return what to say of two whole meshes of quite different sizes, whose ratio is that of no units."""
    ratio = size_ratio(source, target)
    if partial != "none" or 1.0 / ALIKE < ratio < ALIKE or near_unit(ratio) is not None:
        return ()
    kind = "larger" if ratio > 1.0 else "smaller"
    return (f"the target is {max(ratio, 1.0 / ratio):.3g} times {kind} than the source",)
