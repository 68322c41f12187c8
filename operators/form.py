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
    return given_settings(properties, presets[properties.preset])


def given_settings(properties: Any, base: T) -> T:
    """Return settings with those values in place that the caller of an operator has set."""
    cls = type(base)
    values = dataclasses.asdict(base)  # type: ignore[call-overload]
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


def pair_chosen(form: Any, context: Any) -> None:
    """Select and frame both objects of the pair that the user clicks in the table."""
    import bpy  # here, or the module would know it; see above

    if not 0 <= form.pair_index < len(form.pairs) or context.mode != "OBJECT":
        return
    pair = form.pairs[form.pair_index]
    objects = context.view_layer.objects
    items = [objects[name] for name in (pair.one, pair.two) if name in objects]
    for other in context.selected_objects:
        other.select_set(False)
    for item in items:
        item.select_set(True)
    if items:
        objects.active = items[0]
    areas = [context.area, *(context.screen.areas if context.screen else ())]
    area = next((area for area in areas if area is not None and area.type == "VIEW_3D"), None)
    if area is not None and context.selected_objects:
        region = next(region for region in area.regions if region.type == "WINDOW")
        with context.temp_override(area=area, region=region):
            bpy.ops.view3d.view_selected()
