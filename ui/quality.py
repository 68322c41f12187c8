# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels Quality and Heat Map of the sidebar tab FEMORS."""

from __future__ import annotations

from typing import Any, ClassVar

import bpy

from ..operators import heat
from ..operators.job import JobOperator
from ..operators.quality import BAD, chosen
from .figures import draw_row, draw_sentence, length_unit, number, parsed
from .panels import FemorsPanel, draw_own_job

SHAPE = (
    ("Edge length", "edge", "length"),
    ("Aspect ratio", "aspect", ""),
    ("Skewness", "skewness", ""),
    ("Dihedral angle (°)", "dihedral", ""),
)
ROUNDING = 1e-6
"""Of the size: shorter distances between two meshes are single precision."""
FAULTS = (
    ("Self-intersecting", "self_intersecting"),
    ("Folded over", "folded"),
    ("Without area", "degenerate"),
    ("Too slender", "slender"),
)
BESIDE = (
    ("Mesh to other", "mesh_to_other"),
    ("Other to mesh", "other_to_mesh"),
    ("Nearest vertex", "hausdorff"),
)


class FEMORS_PT_quality(FemorsPanel, bpy.types.Panel):
    """Pickers, one button, and the figures."""

    bl_idname = "FEMORS_PT_quality"
    bl_label = "Quality"
    bl_order = 30
    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the form, or the running job, and what was measured."""
        layout = self.layout
        form = context.scene.femors_heat
        mesh, _ = chosen(context)
        column = layout.column(align=True)
        column.use_property_split = True
        column.use_property_decorate = False
        column.enabled = JobOperator.current is None
        column.prop(form, "mesh", icon="MESH_DATA")
        column.prop(form, "other", icon="MESH_DATA")
        if form.mesh is None and mesh is not None:
            layout.label(text=f"Active: {mesh.name}", icon="INFO")
        elif mesh is None:
            layout.label(text="Choose or select a mesh", icon="INFO")
        if draw_own_job(layout, "Quality"):
            return
        button = layout.column()
        button.scale_y = 1.6
        button.context_pointer_set("femors_form", form)
        button.operator("femors.quality", icon="VIEWZOOM")
        if mesh is not None and mesh.femors.quality:
            draw_quality(layout, parsed(mesh.femors.quality), context)
            if BAD in mesh.data.attributes and any(parsed(mesh.femors.quality)["faults"].values()):
                layout.operator("femors.select_bad_faces", icon="FACESEL")


def draw_quality(layout: bpy.types.UILayout, found: dict[str, Any], context: bpy.types.Context) -> None:
    """Draw the figures of a measured mesh."""
    factor, unit = length_unit(context.scene.unit_settings)
    column = layout.column(align=True)
    box = column.box().column(align=True)
    for title, key in FAULTS:
        count = found["faults"][key]
        _line(box, title, (str(count),), alert=count > 0)
    if "elements" in found:
        count = found["elements"]["inverted"]
        _line(box, "Inverted elements", (str(count),), alert=count > 0)
    box = column.box().column(align=True)
    mesh = found["mesh"]
    _line(box, "Vertices, triangles", (str(mesh["vertices"]), str(mesh["faces"])))
    given = mesh.get("given_vertices", mesh["vertices"])
    if given > mesh["vertices"]:
        _line(box, "Before merging", (str(given), ""))
    _line(box, "Pieces", (str(mesh["pieces"]),))
    _line(box, "Open edges", (str(mesh["open_edges"]),))
    if mesh.get("nonmanifold_edges"):
        _line(box, "Non-manifold edges", (str(mesh["nonmanifold_edges"]),))
    plain = unit == "scene units"
    _line(box, "Area" if plain else f"Area ({unit}²)", (number(factor**2 * mesh["area"]),))
    volume = "open" if mesh["volume"] is None else number(factor**3 * mesh["volume"])
    _line(box, "Volume" if plain else f"Volume ({unit}³)", (volume,))
    box = column.box().column(align=True)
    _line(box, "", ("median", "99 %", "max"), factor=0.04)
    for title, key, kind in SHAPE:
        _stat(box, title, found["shape"][key], factor if kind == "length" else 1.0)
    jacobian = found["shape"]["scaled_jacobian"]
    _line(box, "", ("median", "1 %"), factor=0.36)
    _line(box, "Sc. Jacobian", (number(jacobian["median"]), number(jacobian["p01"])), factor=0.36)
    if "elements" in found:
        one = found["elements"]
        box = column.box().column(align=True)
        _title(box, "Scaled Jacobian of elements")
        _line(box, "", ("min", "1 %", "median"), factor=0.04)
        _line(box, "", tuple(f"{one[key]:.3f}" for key in ("minimum", "p01", "median")), factor=0.04)
    if "against" in found:
        _draw_against(column, found, factor, unit, context)


def _draw_against(
    column: bpy.types.UILayout,
    found: dict[str, Any],
    factor: float,
    unit: str,
    context: bpy.types.Context,
) -> None:
    beside = found["against"]
    box = column.box().column(align=True)
    _title(box, f"Beside {found['other_name']} ({unit})")
    _line(box, "", ("median", "99 %", "max"), factor=0.04)
    for title, key in BESIDE:
        _stat(box, title, beside[key], factor, ROUNDING * found["mesh"]["size"])
    if beside["movement"] is not None:
        _stat(box, "Movement", beside["movement"], factor)
        _line(box, "Flipped faces", (str(beside["flipped"]),), alert=beside["flipped"] > 0)
    _line(box, "Faces crossing it", (str(beside["crossing"]),))
    both = beside["overlap"]
    if both is None:
        draw_sentence(box, context, f"No XOR volume: {beside['no_overlap']}", "INFO")
        return
    error = f" ± {number(factor**3 * both['xor_uncertainty'])}"
    plain = unit == "scene units"
    _line(box, "XOR volume" if plain else f"XOR volume ({unit}³)", (number(factor**3 * both["xor"]) + error,))
    _line(box, "Dice coefficient", (f"{both['dice']:.4f}",))


def _stat(
    box: bpy.types.UILayout, title: str, one: dict[str, float], factor: float = 1.0, least: float = 0.0
) -> None:
    """Draw a title, and below it three numbers, for which a narrow sidebar has no room beside it.

    What is below `least` is rounding, and is shown as 0.
    """
    _title(box, title)
    values = (one[key] if abs(one[key]) >= least else 0.0 for key in ("median", "p99", "maximum"))
    _line(box, "", tuple(number(factor * value) for value in values), factor=0.04)


def _line(
    box: bpy.types.UILayout, title: str, values: tuple[str, ...], alert: bool = False, factor: float = 0.0
) -> None:
    draw_row(box, title, *values, alert=alert, factor=factor or (0.5 if len(values) < 3 else 0.4))


def _title(box: bpy.types.UILayout, title: str) -> None:
    row = box.row()
    row.scale_y = 0.7
    row.label(text=title)


class FEMORS_PT_heat(FemorsPanel, bpy.types.Panel):
    """What to show as colours, its range, and the way back."""

    bl_idname = "FEMORS_PT_heat"
    bl_label = "Heat Map"
    bl_order = 31
    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the form and its two buttons."""
        layout = self.layout
        form = context.scene.femors_heat
        column = layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        column.prop(form, "quantity")
        if form.quantity == "gap":
            column.prop(form, "other", text="To", icon="MESH_DATA")
        column.prop(form, "automatic")
        ends = column.column(align=True)
        ends.active = not form.automatic
        ends.prop(form, "low")
        ends.prop(form, "high")
        addon = context.preferences.addons.get(__package__.rpartition(".")[0])
        if form.quantity != "gap" and hasattr(addon and addon.preferences, "colour_map"):
            column.prop(addon.preferences, "colour_map")
        button = layout.column()
        button.scale_y = 1.6
        button.operator("femors.show_heat", icon="COLOR")
        layout.operator("femors.hide_heat", text="Back to Old Shading", icon="LOOP_BACK")
        note = heat.shown(context.object)
        if note is not None and form.automatic:
            factor = length_unit(context.scene.unit_settings)[0]
            factor = factor if note["quantity"] in ("surface_distance", "displacement", "gap") else 1.0
            ends = " to ".join(number(factor * note[key]) for key in ("low", "high"))
            layout.label(text=f"Colours from {ends}", icon="INFO")


classes = (FEMORS_PT_quality, FEMORS_PT_heat)
