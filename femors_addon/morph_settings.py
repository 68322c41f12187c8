# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of a morph and their presets; light, so that forms can be drawn without SciPy."""

from __future__ import annotations

import dataclasses

from .settings import setting

ALIGNMENTS = (
    ("none", "None", "Leave the source where it is"),
    ("rigid", "Rigid", "Rotate and move the source"),
    ("similarity", "Similarity", "Rotate, move and scale uniformly"),
    ("affine", "Affine", "Rotate, move, scale and shear, as the paper does"),
)
PARTIALS = (
    ("none", "Both whole", "Source and target show the same whole part"),
    ("source", "Source is part", "The source covers a part of what the target shows"),
    ("target", "Target is part", "The target covers a part of what the source shows"),
)
CORRESPONDENCES = (
    ("surface", "Surface", "Closest compatible point on the other surface; both ways"),
    ("nearest", "Nearest node", "Nearest node in position and normal, as published; both ways"),
)
PRESET_CHOICES = (
    ("standard", "Standard", "For most bones and soft tissues"),
    ("published", "As published", "The schedule and parameters of Andreassen et al. (2024); lengths in mm"),
    ("gross", "Gross shape", "Only the large differences: smooth, for noisy or coarse targets"),
    ("fine", "Fine detail", "More and finer steps, down to the target's details"),
)


@dataclasses.dataclass(frozen=True)
class MorphSettings:
    """How a source is morphed onto a target (Algorithm 1); zero means "found by itself"."""

    preset: str = setting("standard", "Preset", "Sets of values for common tasks", choices=PRESET_CHOICES)
    alignment: str = setting(
        "affine", "Alignment", "How the source is laid onto the target before it is deformed", choices=ALIGNMENTS
    )
    partial: str = setting(
        "none", "Overlap", "Whether one of the two shows only a part of the other", choices=PARTIALS
    )
    fix_units: bool = setting(
        False, "Convert units", "Scale the source by the unit factor (such as 1000) when the sizes tell of one"
    )
    fix_mirror: bool = setting(
        False, "Mirror if better", "Mirror the source when it fits the target as the other side (left, right)"
    )
    correspondence: str = setting(
        "surface", "Correspondence", "How the displacement vectors are found", choices=CORRESPONDENCES, advanced=True
    )
    levels: int = setting(
        2, "Reduced levels", "Reduced meshes worked on before the dense one", minimum=0, maximum=6, advanced=True
    )
    reduction: float = setting(
        0.0,
        "Reduction",
        "Fraction of the faces that the finest reduced level keeps; 0 finds it from the node count",
        minimum=0.0,
        maximum=1.0,
        unit="factor",
        advanced=True,
    )
    iterations: int = setting(
        8, "Iterations, reduced", "At most so many per reduced level", minimum=1, maximum=500, advanced=True
    )
    fine_iterations: int = setting(
        0,
        "Iterations, fine",
        "More iterations on the finest reduced level at the final spread",
        minimum=0,
        maximum=500,
        advanced=True,
    )
    dense_iterations: int = setting(
        4, "Iterations, dense", "At most so many on the dense mesh", minimum=0, maximum=500, advanced=True
    )
    spread_start: float = setting(
        0.0,
        "Spread, start",
        "Spread (smoothing) of the first iteration: large moves whole regions; 0 finds it from the size",
        minimum=0.0,
        unit="length",
        advanced=True,
    )
    spread_end: float = setting(
        0.0,
        "Spread, end",
        "Spread of the last iteration: small reaches details; 0 finds it from the edge length",
        minimum=0.0,
        unit="length",
        advanced=True,
    )
    spread_decay: float = setting(
        0.0,
        "Spread decay",
        "Factor on the spread from one iteration to the next; 0 goes evenly from start to end",
        minimum=0.0,
        maximum=1.0,
        unit="factor",
        advanced=True,
    )
    step_scale: float = setting(
        1.0,
        "Step scale",
        "Share of the field taken in each iteration on reduced meshes",
        minimum=0.01,
        maximum=1.5,
        unit="factor",
        advanced=True,
    )
    dense_step_scale: float = setting(
        1.0,
        "Step scale, dense",
        "Share of the field taken in each iteration on the dense mesh",
        minimum=0.01,
        maximum=1.5,
        unit="factor",
        advanced=True,
    )
    normal_weight: float = setting(
        0.0,
        "Normal weight",
        "Weight of the normals in the nearest-node search; nearest-node correspondence only",
        minimum=0.0,
        unit="length",
        advanced=True,
    )
    normal_decay: float = setting(
        1.0,
        "Normal weight decay",
        "Factor on the normal weight from one iteration to the next",
        minimum=0.0,
        maximum=1.0,
        unit="factor",
        advanced=True,
    )
    relaxation: int = setting(
        4,
        "Relaxation",
        "Rounds that even out the element shapes along the surface at the end",
        minimum=0,
        maximum=50,
        advanced=True,
    )
    tolerance: float = setting(
        1e-4,
        "Tolerance",
        "A level ends when the largest change of an iteration falls below this fraction of the size",
        minimum=0.0,
        maximum=0.1,
        unit="factor",
        advanced=True,
    )
    seed: int = setting(0, "Seed", "For what is sampled at random", minimum=0, maximum=2**31 - 1, advanced=True)


PRESETS: dict[str, MorphSettings] = {
    "standard": MorphSettings(),
    "published": MorphSettings(
        preset="published",
        correspondence="nearest",
        levels=1,
        reduction=0.15,
        iterations=10,
        fine_iterations=4,
        dense_iterations=10,
        spread_start=10.0,
        spread_end=1.0,
        spread_decay=0.95,
        step_scale=0.95,
        dense_step_scale=0.75,
        normal_weight=5.0,
        normal_decay=0.95,
        relaxation=0,
        tolerance=0.0,
    ),
    "gross": MorphSettings(preset="gross", dense_iterations=0, relaxation=0),
    "fine": MorphSettings(preset="fine", levels=3, iterations=12, dense_iterations=8, relaxation=8),
}
