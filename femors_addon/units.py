# SPDX-License-Identifier: GPL-3.0-or-later
"""Units of length: whether two meshes seem to be in different ones."""

from __future__ import annotations

import math

from .mesh import Surface
from .poses import principal_frame

UNIT_FACTORS = (10.0, 25.4, 100.0, 304.8, 1000.0)
ALIKE, ALIKE_PARTIAL = 4.0, 60.0  # ratio of sizes up to which both may well be in one unit


def unit_factor(source: Surface, target: Surface, partial: str = "none") -> float | None:
    """Return the factor that would bring the source to the target's unit, if one seems needed.

    A part may well be a tenth of the whole: where one mesh is partial the sizes must differ more.
    """
    ratio = principal_frame(target.vertices).radius / principal_frame(source.vertices).radius
    alike = ALIKE if partial == "none" else ALIKE_PARTIAL
    if 1.0 / alike < ratio < alike:
        return None
    if partial != "none":
        return 1000.0 if ratio > 1.0 else 0.001
    known = [f for factor in UNIT_FACTORS for f in (factor, 1.0 / factor)]
    factor = min(known, key=lambda f: abs(math.log(ratio / f)))
    return factor if abs(math.log(ratio / factor)) < math.log(2.0) else None
