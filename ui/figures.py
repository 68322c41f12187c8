# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of a morph's figures, before and after."""

from __future__ import annotations

import functools
import json
from typing import Any

import bpy

from ..operators.morph import NOTHING

TABLE = (
    ("Source to target", "surface_to_target", ("median", "p99", "maximum")),
    ("Target to source", "target_to_surface", ("median", "p99", "maximum")),
    ("Aspect ratio", "aspect", ("median", "maximum")),
    ("Dihedral angle", "dihedral", ("median", "p99")),
)
WORDS = {"median": "median", "p99": "99 %", "maximum": "max"}
COUNTS = (("Flipped faces", "flipped"), ("Self-intersections", "self_intersecting"))


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


def draw_figures(layout: bpy.types.UILayout, report: dict[str, Any], context: bpy.types.Context) -> None:
    """Draw the table, the reason that the morph stopped, and its warnings."""
    before, after = report["before"], report["after"]
    column = layout.column(align=True)
    _row(column, f"{report['source']} to {report['target']}", "aligned", "morphed")
    column.separator()
    for title, key, parts in TABLE:
        box = column.box().column(align=True)
        heading = box.row()
        heading.scale_y = 0.75
        heading.label(text=title)
        for part in parts:
            _row(box, "    " + WORDS[part], number(before[key][part]), number(after[key][part]))
    box = column.box().column(align=True)
    for title, key in COUNTS:
        _row(box, title, str(before[key]), str(after[key]), alert=after[key] > before[key])
    draw_sentence(layout, context, report["stop_reason"], "CHECKMARK" if report["converged"] else "INFO")
    for warning in report["warnings"]:
        draw_sentence(layout, context, warning, "ERROR")


def draw_sentence(
    layout: bpy.types.UILayout, context: bpy.types.Context, sentence: str, icon: str = "NONE"
) -> None:
    """Draw a sentence over as many lines as the region's width asks for."""
    scale = context.preferences.system.ui_scale
    width = max(int((context.region.width / scale - 50) / 6.5), 20)
    column = layout.column(align=True)
    line = ""
    icons = [icon]
    for word in [*sentence.split(), ""]:
        if line and (not word or len(line) + len(word) > width):
            column.label(text=line, icon=icons.pop() if icons else ("BLANK1" if icon != "NONE" else "NONE"))
            line = ""
        line = f"{line} {word}".strip()


def _row(layout: bpy.types.UILayout, title: str, before: str, after: str, alert: bool = False) -> None:
    row = layout.row()
    row.scale_y = 0.75
    split = row.split(factor=0.5)
    split.label(text=title)
    for text in (before, after):
        cell = split.row()
        cell.alignment = "RIGHT"
        cell.alert = alert
        cell.label(text=text)
