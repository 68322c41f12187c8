# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of what FEMORS adds to Blender, asked of a Blender that has it enabled."""

from __future__ import annotations

import inspect
import sys
from pathlib import Path
from typing import Any

from .tables import cell, code, limits, number, table

ROOT = Path(__file__).resolve().parents[2]


def blender_page() -> str:
    """Enable the checkout in the bpy wheel and return the page of operators, panels and forms."""
    sys.path.insert(0, str(ROOT / "demo"))
    from checkout import Checkout

    checkout = Checkout()
    import bpy

    checkout.enable()
    try:
        kept = "".join(map(_group, preferences(bpy)))
        return (
            "What the extension registers, as Blender itself tells it.\n\n"
            f"## Operators\n\nAll are in the search (F3) and in Python as `bpy.ops.femors.NAME(...)`.\n"
            f"{''.join(map(_operator, operators(bpy)))}"
            f"\n## Panels\n\nIn the 3D view's sidebar (N), tab *FEMORS*.\n\n{_panels(bpy)}"
            f"\n## Preferences\n\n*Edit > Preferences > Add-ons > FEMORS*.\n{kept}"
            f"\n## Forms\n\nWhat the panels edit, as scripts reach it.\n{''.join(map(_group, groups(bpy)))}"
            f"\n## Attributes\n\n{_attributes()}"
        )
    finally:
        checkout.disable()


def operators(bpy: Any) -> list[Any]:
    """Return the RNA type of each operator, by name."""
    return [getattr(bpy.ops.femors, name).get_rna_type() for name in sorted(dir(bpy.ops.femors))]


def ours(bpy: Any, base: Any) -> list[Any]:
    """Return the registered classes of FEMORS below one of Blender's, by name."""
    found = [cls for cls in base.__subclasses__() if ".femors" in cls.__module__]
    mixed = [cls for cls in found for cls in cls.__subclasses__()]
    named = {cls.__name__: cls for cls in (*found, *mixed) if getattr(cls, "is_registered", False)}
    return [named[name] for name in sorted(named)]


def groups(bpy: Any) -> list[Any]:
    """Return the property groups."""
    return ours(bpy, bpy.types.PropertyGroup)


def preferences(bpy: Any) -> list[Any]:
    """Return the class of the preferences."""
    return ours(bpy, bpy.types.AddonPreferences)


def _operator(rna: Any) -> str:
    name = rna.identifier.replace("FEMORS_OT_", "")
    text = f"\n### femors.{name}\n\n**{cell(rna.name)}**. {cell(rna.description)}\n"
    rows = list(map(_row, visible(rna, hidden=True)))
    return text + (f"\n{table(('Argument', 'Label', 'Default', 'What'), rows)}" if rows else "")


def visible(rna: Any, hidden: bool = False) -> list[Any]:
    """Return the properties that a person sets; or a script, to which what a dialog hides is open, too."""
    none = ("rna_type", "name", "bl_idname", "filter_glob", "check_existing")
    return [item for item in rna.properties if item.identifier not in none and (hidden or not item.is_hidden)]


def _row(item: Any) -> tuple[str, str, str, str]:
    words, default = cell(item.description), ""
    if item.type == "ENUM" and not item.is_enum_flag:
        choices = [(c.identifier, c.name, c.description) for c in item.enum_items]
        words += "".join(f"<br>{code(key)} **{cell(label)}**: {cell(help)}" for key, label, help in choices)
        default = code(item.default)
    elif item.type in ("INT", "FLOAT") and not item.is_array:
        bounds = limits(
            *(float(value) if abs(value) < 2e9 else 1e38 for value in (item.hard_min, item.hard_max))
        )
        words += f" ({bounds})" if bounds else ""
        default = code(number(float(f"{item.default:.7g}") if item.type == "FLOAT" else item.default))
    elif item.type == "BOOLEAN" and not item.is_array:
        default = code("True" if item.default else "False")
    elif item.type == "STRING":
        default = code(f'"{item.default}"') if item.default else ""
    return code(item.identifier), cell(item.name), default, words


def _panels(bpy: Any) -> str:
    panels = ours(bpy, bpy.types.Panel)
    tops = [cls for cls in panels if not getattr(cls, "bl_parent_id", "")]
    lines = []
    for top in sorted(tops, key=lambda cls: getattr(cls, "bl_order", 0)):
        lines.append(f"- **{cell(top.bl_label)}** ({code(top.__name__)}): {cell(inspect.getdoc(top))}")
        below = [cls for cls in panels if getattr(cls, "bl_parent_id", "") == top.bl_idname]
        lines += [
            f"    - *{cell(c.bl_label)}* ({code(c.__name__)}): {cell(inspect.getdoc(c))}" for c in below
        ]
    return "\n".join(lines) + "\n"


def _group(cls: Any) -> str:
    rows = list(map(_row, visible(cls.bl_rna)))
    head = f"\n### {cls.__name__}\n\n{cell(inspect.getdoc(cls))}\n\n"
    return head + table(("Property", "Label", "Default", "What"), rows)


def _attributes() -> str:
    """Return the names of mesh attributes that the code writes, with the module that does."""
    import re

    found: dict[str, str] = {}
    for path in sorted((ROOT / "operators").glob("*.py")):
        for name in re.findall(
            r'"((?:femors_[a-z_]+|node_id|element_id))"', path.read_text(encoding="utf-8")
        ):
            found.setdefault(name, path.name)
    rows = [(code(name), code(f"operators/{module}")) for name, module in sorted(found.items())]
    return "Names that FEMORS keeps with meshes, objects and texts.\n\n" + table(("Name", "Written by"), rows)
