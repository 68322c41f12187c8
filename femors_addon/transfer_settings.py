# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of a transfer; light, so that forms can be drawn without SciPy."""

from __future__ import annotations

import dataclasses

from .settings import setting

SPACES = (
    ("LPS", "LPS", "x to the left, y to the back: what 3D Slicer writes into STL, PLY and OBJ files"),
    ("RAS", "RAS", "x to the right, y to the front: what 3D Slicer shows"),
)


@dataclasses.dataclass(frozen=True)
class AxesSettings:
    """In which axes the meshes are that landmarks of files belong to."""

    space: str = setting(
        "LPS",
        "Axes of meshes",
        "Patient axes that the meshes are in; landmarks of 3D Slicer in the other ones are turned",
        choices=SPACES,
    )


@dataclasses.dataclass(frozen=True)
class TransferSettings(AxesSettings):
    """How points and geometries are carried by a field."""

    strength: float = setting(
        1.0,
        "Strength",
        "0 leaves everything where it is, 1 carries it all the way; between, along a straight line",
        minimum=0.0,
        maximum=1.0,
        unit="factor",
    )
    inverse: bool = setting(False, "Inverse", "Carry from the target back to the source")
