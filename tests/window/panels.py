# SPDX-License-Identifier: GPL-3.0-or-later
"""The story in a window, what is done with a result: figures, heat maps, transfer, report."""

from __future__ import annotations

import bpy
import hands
from hands import (
    OUT,
    Steps,
    call,
    check,
    click,
    frame,
    module,
    only,
    quiet,
    select,
    shot,
    show_panel,
    view,
    viewport,
    wait,
)

RESULT = "Femur morphed to Scan"


def quality() -> Steps:
    """Measure the result beside its target."""
    select(RESULT)
    item, form = bpy.data.objects[RESULT], bpy.context.scene.femors_heat
    form.mesh, form.other = item, bpy.data.objects["Scan"]
    yield from only("quality")
    yield from click()
    yield from wait("the figures", lambda: quiet() and item.femors.quality)
    yield from shot("20_quality")


def heat() -> Steps:
    """Show heat maps with their legend, and go back."""
    item, form = bpy.data.objects[RESULT], bpy.context.scene.femors_heat
    bpy.data.objects["Femur"].hide_set(True)
    yield from only("heat")
    frame(selected=True)
    shading = view()["area"].spaces.active.shading
    before = {name: getattr(shading, name) for name in ("type", "color_type", "show_specular_highlight")}
    for number, quantity in enumerate(("displacement", "surface_distance", "scaled_jacobian")):
        form.quantity = quantity
        if not number:
            yield from click(until=lambda: "femors_heat" in item.data.color_attributes)
        else:
            check(call(bpy.ops.femors.show_heat) == {"FINISHED"}, f"{quantity} was not shown")
        check(shading.color_type == "VERTEX", "the viewport does not show the colours")
        with bpy.context.temp_override(**viewport()):
            check(module("ui.legend").words(bpy.context), "there is no legend")
        yield from shot(f"{21 + number}_heat_{quantity}")
    check(call(bpy.ops.femors.hide_heat) == {"FINISHED"}, "no way back")
    check(all(getattr(shading, name) == old for name, old in before.items()), "the shading is another")
    check("femors_heat" not in item.data.color_attributes, "the colours are still there")
    yield from shot("24_heat_back")
    bpy.data.objects["Femur"].hide_set(False)


def transfer() -> Steps:
    """Carry landmarks and a region, then an object, by the field of the morph."""
    femur, scan = bpy.data.objects["Femur"], bpy.data.objects["Scan"]
    scan.hide_set(False)
    bpy.data.objects[RESULT].hide_set(True)
    count, names = len(femur.data.vertices), ("Head", "Neck", "Greater trochanter", "Shaft", "Notch")
    for number, name in enumerate(names):
        femur.vertex_groups.new(name=name).add([number * (count - 1) // len(names)], 1.0, "REPLACE")
    femur.vertex_groups.new(name="Cut").add(list(range(count // 3)), 1.0, "REPLACE")
    form = bpy.context.scene.femors_transfer
    form.what, form.use_empties = "GROUPS", True
    yield from only("transfer")
    yield from shot("30_transfer")
    yield from click()
    yield from wait("the landmarks", lambda: quiet() and len(form.marks) == len(names))
    check({*names, "Cut"} <= set(scan.vertex_groups.keys()), f"groups: {scan.vertex_groups.keys()}")
    form.sort = "stretch"
    yield from shot("31_landmarks")
    ball = _ball(femur)
    form.what = "OBJECTS"
    select(ball.name)
    before = len(bpy.data.objects)
    yield from click()
    yield from wait("the carried object", lambda: quiet() and len(bpy.data.objects) == before + 1)
    yield from shot("32_carried")


def _ball(femur: bpy.types.Object) -> bpy.types.Object:
    """Return a ball at the bone, as a muscle's attachment."""
    size = max(femur.dimensions)
    place = femur.data.vertices[len(femur.data.vertices) // 2].co
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=0.05 * size, location=place)
    bpy.context.object.name = "Muscle"
    return bpy.context.object


def report() -> Steps:
    """Write the report, with the viewport in it."""
    bpy.data.objects[RESULT].hide_set(False)
    select(RESULT)
    yield from only("report")
    yield from shot("40_report")
    path = OUT / "report.html"
    path.unlink(missing_ok=True)
    check(call(bpy.ops.femors.report, filepath=str(path)) == {"FINISHED"}, "no report")
    text = path.read_text(encoding="utf-8")
    check("As the viewport showed it" in text and text.count("<svg") > 5, "the page lacks pictures or plots")


def advanced() -> Steps:
    """Look at the Advanced panel."""
    form = bpy.context.scene.femors
    form.preset = "published"
    check(form.correspondence == "nearest", "choosing a preset did not fill the form")
    select()
    yield from only("morph", advanced=True)
    yield from shot("41_advanced")
    form.preset = "standard"
    yield from only()
    hands.clear()
    yield from show_panel()
