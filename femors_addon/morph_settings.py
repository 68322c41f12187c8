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
    ("mixed", "Normals, then surface", "Nearest in position and normal, then the closest surface points"),
    ("surface", "Surface", "Closest surface point that faces the same way, all the way"),
    ("nearest", "Normals", "Nearest node in position and normal all the way, as published"),
)
PRESET_CHOICES = (
    ("standard", "Standard", "For most bones and soft tissues"),
    ("published", "As published", "The schedule and parameters of Andreassen et al. (2024); lengths in mm"),
    ("gross", "Gross shape", "Only the large differences: smooth, for noisy or coarse targets"),
    ("fine", "Fine detail", "More and finer steps, down to the target's details"),
)


def _iterations(default: int, label: str, help: str) -> int:
    count: int = setting(default, label, help, minimum=0, maximum=500, advanced=True)
    return count


def _factor(default: float, label: str, help: str) -> float:
    factor: float = setting(default, label, help, minimum=0.0, maximum=1.0, unit="factor", advanced=True)
    return factor


def _step(default: float, label: str, help: str) -> float:
    share: float = setting(default, label, help, minimum=0.01, maximum=1.5, unit="factor", advanced=True)
    return share


@dataclasses.dataclass(frozen=True)
class MorphSettings:
    """How a source is morphed onto a target (Algorithm 1); zero means "found by itself"."""

    preset: str = setting("standard", "Preset", "Sets of values for common tasks", choices=PRESET_CHOICES)
    alignment: str = setting(
        "affine",
        "Alignment",
        "How the source is laid onto the target before it is deformed",
        choices=ALIGNMENTS,
    )
    partial: str = setting(
        "none", "Overlap", "Whether one of the two shows only a part of the other", choices=PARTIALS
    )
    fix_units: bool = setting(
        False,
        "Convert units",
        "Scale the source by the unit factor (such as 1000) when the sizes tell of one",
    )
    fix_mirror: bool = setting(
        False, "Mirror if better", "Mirror the source when it fits the target as the other side (left, right)"
    )
    steer: bool = setting(
        False,
        "Landmarks pull",
        "Paired landmarks not only align, but pull the source onto them; pairs that do not fit are left out",
    )
    landmark_weight: float = setting(
        1.0,
        "Landmark weight",
        "Share of what is left between paired landmarks that each pull takes",
        minimum=0.0,
        maximum=1.0,
        unit="factor",
        advanced=True,
    )
    correspondence: str = setting(
        "mixed",
        "Correspondence",
        "How displacement vectors are found, in both directions",
        choices=CORRESPONDENCES,
        advanced=True,
    )
    levels: int = setting(
        2,
        "Reduced levels",
        "Reduced meshes worked on before the dense one, at least; very dense meshes take more",
        minimum=0,
        maximum=6,
        advanced=True,
    )
    reduction: float = setting(
        0.0,
        "Reduction",
        "Fraction of the nodes that the finest reduced level keeps; 0 finds it from the node count",
        minimum=0.0,
        maximum=1.0,
        unit="factor",
        advanced=True,
    )
    iterations: int = _iterations(16, "Iterations, reduced", "At most so many on the coarsest level")
    fine_iterations: int = _iterations(
        6, "Iterations, fine", "At most so many on each finer reduced level (or again on the only one)"
    )
    dense_iterations: int = _iterations(1, "Iterations, dense", "At most so many on the dense mesh")
    spread_start: float = setting(
        0.0,
        "Spread, start",
        "Spread (smoothing) of the first iteration: large moves regions; 0 is 0.15 of the target's size",
        minimum=0.0,
        unit="length",
        advanced=True,
    )
    spread_end: float = setting(
        0.0,
        "Spread, end",
        "Spread of the last iteration: small reaches details; 0 is 1.4 times the mean edge",
        minimum=0.0,
        unit="length",
        advanced=True,
    )
    spread_decay: float = _factor(
        0.0, "Spread decay, reduced", "Factor on the spread per iteration; 0 goes evenly from start to end"
    )
    fine_spread_decay: float = _factor(0.0, "Spread decay, fine", "The same on the finer reduced levels")
    dense_spread_decay: float = _factor(0.0, "Spread decay, dense", "The same on the dense mesh")
    step_scale: float = _step(1.3, "Step scale, reduced", "Share of the field taken in each iteration")
    fine_step_scale: float = _step(1.3, "Step scale, fine", "The same on the finer reduced levels")
    dense_step_scale: float = _step(1.0, "Step scale, dense", "The same on the dense mesh")
    normal_weight: float = setting(
        0.0,
        "Normal weight",
        "Length that a unit normal stands for in the search; 0 is 0.12 of the target's size",
        minimum=0.0,
        unit="length",
        advanced=True,
    )
    fine_normal_weight: float = setting(
        0.0,
        "Normal weight, fine",
        "The same from the finer levels on; 0 is half of the first",
        minimum=0.0,
        unit="length",
        advanced=True,
    )
    normal_decay: float = _factor(0.0, "Normal weight decay", "Factor per iteration; 0 follows the spread")
    fine_normal_decay: float = _factor(0.0, "Normal weight decay, fine", "The same from the finer levels on")
    sliding: int = setting(
        10,
        "Sliding",
        "Rounds per iteration that let the displacement even out along the surface",
        minimum=0,
        maximum=100,
        advanced=True,
    )
    projection: float = _factor(
        1.0,
        "Projection",
        "Share of the remaining distance to the target taken at the end; less on a noisy target",
    )
    relaxation: int = setting(
        3,
        "Relaxation",
        "Rounds at the end that give the elements the shapes that they had in the source",
        minimum=0,
        maximum=50,
        advanced=True,
    )
    field_spread: float = setting(
        0.0,
        "Field spread",
        "Spread of the field that is kept for other points; 0 is 0.75 times the mean edge",
        minimum=0.0,
        unit="length",
        advanced=True,
    )
    tolerance: float = setting(
        1e-4,
        "Tolerance",
        "Iterations are skipped once the largest change falls below this fraction of the size",
        minimum=0.0,
        maximum=0.1,
        unit="factor",
        advanced=True,
    )


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
        spread_decay=1.0,
        fine_spread_decay=0.995,
        dense_spread_decay=0.95,
        step_scale=0.95,
        fine_step_scale=0.5,
        dense_step_scale=0.75,
        normal_weight=5.0,
        fine_normal_weight=1.0,
        normal_decay=0.999,
        fine_normal_decay=0.95,
        sliding=0,
        projection=0.0,
        relaxation=0,
        field_spread=1.0,
        tolerance=0.0,
    ),
    "gross": MorphSettings(
        preset="gross", fine_iterations=3, dense_iterations=0, projection=0.0, relaxation=0
    ),
    "fine": MorphSettings(preset="fine", levels=3, fine_iterations=20, dense_iterations=4, relaxation=1),
}
