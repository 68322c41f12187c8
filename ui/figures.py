# SPDX-License-Identifier: GPL-3.0-or-later
"""A morph's verdict, and the table of its figures before and after."""

from __future__ import annotations

import functools
import json
from typing import Any

import bpy

from ..operators.morph import NOTHING

TABLE = (
    ("Target to source", "target_to_surface", ("median", "p99", "maximum")),
    ("Source to target", "surface_to_target", ("median", "p99", "maximum")),
)
SHAPE = (
    ("Aspect, median", "aspect", "median"),
    ("Aspect, max", "aspect", "maximum"),
    ("Dihedral, median", "dihedral", "median"),
    ("Dihedral, 99 % (°)", "dihedral", "p99"),
)
"""The distance from the target first: the other is nothing where vertices are laid onto the target."""
WORDS = {"median": "median", "p99": "99 %", "maximum": "max"}
MARGINS = 80  # pixels of a sidebar beside a sentence and its icon, in a box or not, at scale 1
FIGURE = 2.4
"""Width of a column of numbers, in Blender's units of 20 pixels."""
NARROW = 240
"""Pixels of a sidebar at scale 1: below it some columns of tables are left out; Blender opens it at 280."""
COUNTS = (("Flipped faces", "flipped"), ("Self-intersecting", "self_intersecting"))
UNITS = {
    "KILOMETERS": (1e3, "km"),
    "METERS": (1.0, "m"),
    "CENTIMETERS": (1e-2, "cm"),
    "MILLIMETERS": (1e-3, "mm"),
    "MICROMETERS": (1e-6, "µm"),
    "MILES": (1609.344, "mi"),
    "FEET": (0.3048, "ft"),
    "INCHES": (0.0254, "in"),
    "THOU": (2.54e-5, "thou"),
}
"""Blender's units of length: metres, and how they are written."""


@functools.lru_cache(maxsize=4)
def parsed(report: str) -> dict[str, Any]:
    """Return a report's JSON as a dictionary; a panel is drawn often, so the last few are kept."""
    return json.loads(report)


def number(value: float) -> str:
    """Return three significant digits, two where there are many zeros; without an exponent if short."""
    if abs(value) < NOTHING:
        return "0"
    if abs(value) >= 1000:
        return f"{value:.0f}"
    return f"{value:.3g}" if abs(value) >= 1e-3 else f"{value:.2g}"


def fixed(value: float) -> str:
    """Return a number for a narrow column: no exponent, three digits or four decimals at most."""
    size = abs(value)
    for least, digits in ((99.95, 0), (9.995, 1), (0.0995, 2), (0.00995, 3), (0.00005, 4)):
        if size >= least:
            return f"{value:.{digits}f}"
    return "0"


def length_unit(settings: Any) -> tuple[float, str]:
    """Return the factor that takes scene lengths to the scene's unit, and the unit's name.

    Blender's factory settings say metres whatever a file's numbers mean: they count as not set, and
    lengths stay as they are, in the unit that the preferences name.

    Parameters
    ----------
    settings : bpy.types.UnitSettings
        Of the scene.
    """
    scale, unit = settings.scale_length, settings.length_unit
    if settings.system == "NONE" or (abs(scale - 1.0) < 1e-6 and unit in ("METERS", "ADAPTIVE")):
        addon = bpy.context.preferences.addons.get(__package__.rpartition(".")[0])
        chosen = getattr(addon and addon.preferences, "unit", "NONE")
        return 1.0, (UNITS[chosen][1] if chosen in UNITS else "scene units")
    if unit == "ADAPTIVE":  # Blender changes the unit with the length; one for the whole table is wanted
        named = [key for key, (metres, _) in UNITS.items() if abs(scale / metres - 1.0) < 1e-4]
        unit = named[0] if named else ("METERS" if settings.system == "METRIC" else "FEET")
    metres, name = UNITS[unit]
    factor = scale / metres
    return (1.0 if abs(factor - 1.0) < 1e-6 else factor), name


def draw_figures(layout: bpy.types.UILayout, report: dict[str, Any], context: bpy.types.Context) -> None:
    """Draw the verdict (why the morph stopped, its warnings, its faults), then the table."""
    before, after = report["before"], report["after"]
    verdict = layout.column(align=True)
    draw_sentence(verdict, context, report["stop_reason"], "CHECKMARK" if report["converged"] else "INFO")
    for warning in report["warnings"]:
        draw_sentence(verdict, context, warning, "ERROR")
    column = layout.column(align=True)
    draw_row(column, f"{report['source']} to {report['target']}", "aligned", "morphed")
    box = column.box().column(align=True)
    for title, key in COUNTS:
        draw_row(box, title, str(before[key]), str(after[key]), alert=after[key] > before[key])
    if "volume" in report:
        _draw_elements(column, report["volume"])
    factor, unit = length_unit(context.scene.unit_settings)
    for title, key, parts in TABLE:
        box = column.box().column(align=True)
        heading = box.row()
        heading.scale_y = 0.7
        heading.label(text=f"{title} ({unit})")
        for part in parts:
            values = (number(factor * side[key][part]) for side in (before, after))
            draw_row(box, "    " + WORDS[part], *values)
    if "sampled" in report:
        draw_sentence(column, context, report["sampled"])
    box = column.box().column(align=True)
    for title, key, part in SHAPE:
        draw_row(box, title, number(before[key][part]), number(after[key][part]))


def _draw_elements(layout: bpy.types.UILayout, elements: dict[str, Any]) -> None:
    """Draw the figures of a finite-element model's solid elements."""
    before, after = elements["before"], elements["after"]
    box = layout.box().column(align=True)
    row = (str(state["inverted"]) for state in (before, after))
    draw_row(box, "Inverted elements", *row, alert=len(elements["newly_inverted"]) > 0)
    draw_row(
        box,
        f"Volume ({round(elements['volume_change'], 3) + 0.0:+.1%})",
        number(before["volume"]),
        number(after["volume"]),
    )
    heading = box.row()
    heading.scale_y = 0.7
    heading.label(text="Scaled Jacobian")
    for key, word in (("minimum", "min"), ("p01", "1 %"), ("median", "median")):
        draw_row(box, "    " + word, f"{before[key]:.3f}", f"{after[key]:.3f}")


def narrow(context: bpy.types.Context) -> bool:
    """Whether the region has no room for all columns of a table."""
    return context.region.width < NARROW * context.preferences.system.ui_scale


def draw_sentence(
    layout: bpy.types.UILayout, context: bpy.types.Context, sentence: str, icon: str = "NONE"
) -> None:
    """Draw a sentence over as many lines as the region's width asks for."""
    import blf

    scale = context.preferences.system.ui_scale
    blf.size(0, bpy.context.preferences.ui_styles[0].widget.points * scale)
    room = max(context.region.width - MARGINS * scale, 80 * scale)
    column = layout.column(align=True)
    column.scale_y = 0.8
    line = ""
    icons = [icon]
    for word in [*sentence.split(), ""]:
        if line and (not word or blf.dimensions(0, f"{line} {word}")[0] > room):
            column.label(text=line, icon=icons.pop() if icons else ("BLANK1" if icon != "NONE" else "NONE"))
            line = ""
        line = f"{line} {word}".strip()


def draw_beside(heading: bpy.types.UILayout, scrolled: bool) -> None:
    """Leave room in a table's heading for the list's frame, and for its scroll bar where it has one."""
    beside = heading.row()
    beside.ui_units_x = 1.4 if scrolled else 0.3
    beside.label(text="")


def draw_figure(layout: bpy.types.UILayout, text: str) -> None:
    """Draw the last column of a table, a number of `fixed` or its head, as wide as these are and no wider."""
    cell = layout.row()
    cell.ui_units_x = FIGURE
    cell.alignment = "RIGHT"
    cell.label(text=text)


def draw_row(
    layout: bpy.types.UILayout, title: str, *values: str, alert: bool = False, factor: float = 0.0
) -> None:
    """Draw a line of a table: its title, and figures to the right; `factor` is the title's share."""
    row = layout.row()
    row.scale_y = 0.7
    rest = row.split(factor=factor or 0.5)
    rest.label(text=title)
    for place, text in enumerate(values):
        left = len(values) - place
        if left > 1:  # columns of one width, whatever stands in them
            rest = rest.split(factor=1.0 / left)
        cell = rest.row()
        cell.alignment = "RIGHT"
        cell.alert = alert
        cell.label(text=text)
