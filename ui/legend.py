# SPDX-License-Identifier: GPL-3.0-or-later
"""The legend of a heat map, drawn over the viewport beside its toolbar."""

from __future__ import annotations

from typing import Any, ClassVar

import bpy

from ..operators import heat
from .figures import length_unit, number

WIDTH, HEIGHT, MARGIN, EDGE = 18, 200, 12, 40
"""Of the bar, around it, and from the viewport's lower edge, in pixels at scale 1."""
TICKS = 5
GROUND = (0.10, 0.10, 0.10, 0.72)
INK = (0.95, 0.95, 0.95, 1.0)


class Legend:
    """The handler that draws."""

    handler: ClassVar[Any] = None


def register() -> None:
    """Draw in every 3D viewport; nothing where no heat map is shown."""
    Legend.handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL")


def unregister() -> None:
    """Draw no more."""
    handler, Legend.handler = Legend.handler, None
    if handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(handler, "WINDOW")


def words(context: bpy.types.Context) -> tuple[list[str], list[str], dict[str, Any]] | None:
    """Return title lines, tick labels from low to high, and the note of what is shown; None for nothing."""
    space = context.space_data
    item = context.object
    note = heat.shown(item)
    if note is None:
        named = [one for one in context.visible_objects if heat.shown(one) is not None]
        item = named[0] if named else None
        note = heat.shown(item)
    if item is None or note is None or not item.visible_get() or space.shading.color_type != "VERTEX":
        return None
    from ..femors_addon.quantities import QUANTITIES

    quantity = QUANTITIES[note["quantity"]]
    factor, unit = length_unit(context.scene.unit_settings) if quantity.unit == "length" else (1.0, "")
    title = f"{quantity.label} ({unit})" if unit else quantity.label
    lines = [title, item.name if len(item.name) < 28 else item.name[:26] + "..."]
    return lines, labels(note, factor), note


def labels(note: dict[str, Any], factor: float = 1.0) -> list[str]:
    """Return what stands beside the bar from low to high; at its ends also how far values go beyond."""
    low, high = note["low"], note["high"]
    out = [number(factor * (low + (high - low) * i / (TICKS - 1))) for i in range(TICKS)]
    for end, beyond, words in ((0, "least", "down to"), (-1, "most", "up to")):
        value = note.get(beyond, note["low" if end == 0 else "high"])  # a map of an older file
        told = number(factor * value)
        if told != out[end] and not low <= value <= high:
            out[end] = f"{out[end]}, {words} {told}"
    return out


def _draw() -> None:
    context = bpy.context
    if not context.space_data.overlay.show_overlays:
        return
    said = words(context)
    if said is None:
        return
    import blf

    lines, ticks, note = said
    scale = context.preferences.system.ui_scale
    size = 12 * scale
    blf.size(0, size)
    left = next((r.width for r in context.area.regions if r.type == "TOOLS"), 0) + 20 * scale
    bottom, wide, tall, margin = EDGE * scale, WIDTH * scale, HEIGHT * scale, MARGIN * scale
    text = max(blf.dimensions(0, line)[0] for line in lines)
    beside = wide + 10 * scale + max(blf.dimensions(0, tick)[0] for tick in ticks)
    signed = "overlap below 0" if note["quantity"] == "gap" else ""
    across = max(text, beside, blf.dimensions(0, signed)[0]) + 2 * margin
    foot = 18 * scale if signed else 0
    top = bottom + margin + foot + tall + 2.2 * margin + 3.2 * size
    _box(left, bottom, left + across, top, GROUND)
    x, y = left + margin, bottom + margin + foot
    _bar(x, y, wide, tall, note["map"])
    for i, tick in enumerate(ticks):
        at = y + tall * i / (len(ticks) - 1)
        _box(x + wide, at - 0.5, x + wide + 4 * scale, at + 0.5, INK)
        _write(tick, x + wide + 9 * scale, at - 0.36 * size)
    _write(lines[0], x, top - margin - 0.9 * size)
    _write(lines[1], x, top - margin - 2.4 * size, (0.75, 0.75, 0.75, 1.0))
    if signed:
        _write(signed, x, bottom + 0.7 * margin, (0.75, 0.75, 0.75, 1.0))


def _write(text: str, x: float, y: float, ink: tuple[float, ...] = INK) -> None:
    import blf

    blf.color(0, *ink)
    blf.position(0, x, y, 0)
    blf.draw(0, text)


def _box(x0: float, y0: float, x1: float, y1: float, colour: tuple[float, ...]) -> None:
    import gpu
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    batch = batch_for_shader(shader, "TRIS", {"pos": corners}, indices=[(0, 1, 2), (0, 2, 3)])
    gpu.state.blend_set("ALPHA")
    shader.uniform_float("color", colour)
    batch.draw(shader)
    gpu.state.blend_set("NONE")


def _bar(x: float, y: float, wide: float, tall: float, name: str) -> None:
    import gpu
    from gpu_extras.batch import batch_for_shader

    from ..femors_addon.colours import table

    shader = gpu.shader.from_builtin("SMOOTH_COLOR")
    colours = table(name)
    corners, inks, faces = [], [], []
    for i, colour in enumerate(colours):
        low, high = y + tall * i / len(colours), y + tall * (i + 1) / len(colours)
        faces += [(4 * i, 4 * i + 1, 4 * i + 2), (4 * i, 4 * i + 2, 4 * i + 3)]
        corners += [(x, low), (x + wide, low), (x + wide, high), (x, high)]
        inks += [(*map(float, colour), 1.0)] * 4
    batch_for_shader(shader, "TRIS", {"pos": corners, "color": inks}, indices=faces).draw(shader)
