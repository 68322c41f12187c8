# SPDX-License-Identifier: GPL-3.0-or-later
"""Values into a form and out of it: presets, settings, and what a property's callbacks do.

This module does not import bpy, on purpose: Blender 4.2 never lets go of a property's callback, and
a callback whose module knows bpy would keep it alive past its end, where the bpy wheel crashes.
"""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

from ..femors_addon.morph_settings import PRESETS, MorphSettings
from ..femors_addon.settings import specs

T = TypeVar("T")

FIELD = "femors_field"
"""Custom property of a Text that holds a field: the bytes of its file."""


def exact(value: float) -> float:
    """Return the short decimal behind a single-precision number: 0.95 where Blender has 0.94999999."""
    return float(f"{value:.7g}")


def read_settings(properties: Any, cls: type[T], presets: dict[str, T]) -> T:
    """Return the settings that an operator was called with.

    The preset's values hold, except for those that the caller has set.
    """
    values = dataclasses.asdict(presets[properties.preset])  # type: ignore[call-overload]
    for name, (field, _) in specs(cls).items():
        if properties.is_property_set(name):
            value = getattr(properties, name)
            values[name] = exact(value) if isinstance(field.default, float) else value
    return cls(**values)


def fill_from_preset(form: Any, cls: type, presets: dict[str, Any]) -> None:
    """Write a preset's advanced values into a form; what the user said of the data stays."""
    for name, (_, spec) in specs(cls).items():
        if spec.advanced:
            setattr(form, name, getattr(presets[form.preset], name))


def changed_from_preset(form: Any, cls: type, presets: dict[str, Any]) -> list[str]:
    """Return the names of the advanced settings in which a form differs from its preset."""
    out = []
    for name, (field, spec) in specs(cls).items():
        value = getattr(form, name)
        value = exact(value) if isinstance(field.default, float) else value
        if spec.advanced and value != getattr(presets[form.preset], name):
            out.append(name)
    return out


def preset_chosen(form: Any, context: Any) -> None:
    """Fill the form when the user chooses a preset."""
    fill_from_preset(form, MorphSettings, PRESETS)


def is_field(form: Any, item: Any) -> bool:
    """Whether a picker offers this text: one that holds a field."""
    return FIELD in item.keys()  # noqa: SIM118  (a Text is no dict)


def is_mesh(form: Any, item: Any) -> bool:
    """Whether a picker offers this object: a mesh, and not one that was deleted."""
    return item.type == "MESH" and bool(item.users_scene)
