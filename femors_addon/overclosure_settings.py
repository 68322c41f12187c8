# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of overclosure removal; light, so that forms can be drawn without SciPy."""

from __future__ import annotations

import dataclasses

from .settings import setting

METHODS = (
    ("grnn", "Smooth field", "One smooth displacement field for both bodies, down to zero crossings"),
    ("nodal", "Nodal", "Each penetrating node by itself, as finite-element programs do; for comparison"),
    ("published", "As published", "The loop and parameters of Andreassen et al. (2024); lengths in mm"),
)


@dataclasses.dataclass(frozen=True)
class OverclosureSettings:
    """How overlapping bodies are pushed apart (Algorithm 2); zero means "found by itself"."""

    gap: float = setting(
        0.01,
        "Minimum gap",
        "Least distance of each body's nodes to the surface of another afterwards; edges do not cross, but "
        "may be nearer each other",
        minimum=0.0,
        maximum=1e6,
        unit="length",
    )
    method: str = setting("grnn", "Method", "How the bodies are pushed apart", choices=METHODS)
    band: float = setting(
        0.0,
        "Search band",
        "Bodies closer than this are listed as pairs; 0 = one mean edge",
        minimum=0.0,
        maximum=1e6,
        unit="length",
        advanced=True,
    )
    spread_factor: float = setting(
        1.25,
        "Spread per depth",
        "First spread of the field, as a multiple of the deepest overclosure: larger moves more around it",
        minimum=0.25,
        maximum=10.0,
        unit="factor",
        advanced=True,
    )
    spread_end: float = setting(
        1.15,
        "Last spread",
        "Last spread of the field, in mean edges of the finer body that moves",
        minimum=0.75,
        maximum=10.0,
        unit="factor",
        advanced=True,
    )
    iterations: int = setting(
        120,
        "Iterations",
        "Steps after which the removal gives up; the loop as published takes up to 500, whatever stands here",
        minimum=1,
        maximum=2000,
        advanced=True,
    )
    continuation: bool = setting(
        True,
        "Through thin bodies",
        "Bodies deeper in each other than half their thickness are parted first and pressed together again",
        advanced=True,
    )
