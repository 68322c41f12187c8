# SPDX-License-Identifier: GPL-3.0-or-later
"""The viewports' shading for a heat map, and the way back to how they were."""

from __future__ import annotations

import bpy

SHADING = "femors_shading"
"""Name of the note on a screen: how its viewports were shaded."""
REMEMBERED = ("type", "color_type", "show_specular_highlight")


def shade(context: bpy.types.Context) -> None:
    """Let the viewports of the window show colour attributes; remember how they were."""
    screen = context.screen or (context.window.screen if context.window else None)
    if screen is None:
        return
    before = dict(screen.get(SHADING, {}))
    for number, area in enumerate(screen.areas):
        if area.type != "VIEW_3D":
            continue
        shading = area.spaces.active.shading
        before.setdefault(str(number), {name: getattr(shading, name) for name in REMEMBERED})
        shading.type, shading.color_type, shading.show_specular_highlight = "SOLID", "VERTEX", False
    screen[SHADING] = before


def unshade() -> None:
    """Give all viewports the shading back that they had."""
    for screen in bpy.data.screens:
        if SHADING not in screen:
            continue
        for number, kept in dict(screen[SHADING]).items():
            area = screen.areas[int(number)] if int(number) < len(screen.areas) else None
            if area is None or area.type != "VIEW_3D":
                continue
            shading = area.spaces.active.shading
            # color_type can only be set while the shading is solid
            shading.color_type = kept["color_type"]
            shading.show_specular_highlight = bool(kept["show_specular_highlight"])
            shading.type = kept["type"]
        del screen[SHADING]


def redraw(context: bpy.types.Context) -> None:
    """Draw all viewports anew."""
    for window in context.window_manager.windows if context.window_manager else ():
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
