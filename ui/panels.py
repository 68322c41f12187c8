# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels of the sidebar tab FEMORS; they draw, and name operators by their bl_idname."""

from __future__ import annotations

import time
from typing import Any, ClassVar

import bpy

from ..femors_addon.morph_settings import PRESETS, MorphSettings
from ..femors_addon.settings import specs
from ..operators import dependencies
from ..operators.form import changed_from_preset
from ..operators.job import Job, JobOperator, time_left
from ..operators.morph import chosen
from .figures import draw_figures, draw_sentence, parsed


class FemorsPanel:
    """Where all panels of FEMORS stand."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "FEMORS"


class FEMORS_PT_morph(FemorsPanel, bpy.types.Panel):
    """Pickers, what matters, and one large button."""

    bl_idname = "FEMORS_PT_morph"
    bl_label = "Morph"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the form, or the running job."""
        layout = self.layout
        form = context.scene.femors
        sentence = dependencies.missing()
        if sentence:
            draw_sentence(layout, context, sentence, "ERROR")
        column = layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        column.enabled = JobOperator.current is None
        draw_pickers(column, context)
        draw_options(column, form)
        if draw_own_job(layout, "Morph"):
            return
        button = layout.column()
        button.scale_y = 1.6
        button.context_pointer_set("femors_form", form)
        button.operator("femors.morph", text="Morph", icon="MOD_SHRINKWRAP")

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        """Draw the menu of saved presets."""
        draw_presets(self, context)


class FEMORS_PT_morph_advanced(FemorsPanel, bpy.types.Panel):
    """Everything that has a good default."""

    bl_idname = "FEMORS_PT_morph_advanced"
    bl_parent_id = "FEMORS_PT_morph"
    bl_label = "Advanced"
    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the advanced settings in their order."""
        layout = self.layout
        form = context.scene.femors
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.enabled = JobOperator.current is None
        column = layout.column()
        if form.source is not None:
            column.prop_search(form, "vertex_group", form.source, "vertex_groups")
        column.prop(form, "use_evaluated")
        column.prop(form, "use_landmarks")
        layout.separator(factor=0.5)
        changed = changed_from_preset(form, MorphSettings, PRESETS)
        column = layout.column(align=True)
        column.label(text="Lengths in scene units")
        for name, (_, spec) in specs(MorphSettings).items():
            if spec.advanced:
                # more room for the words than a property split gives
                row = column.split(factor=0.58)
                row.active = is_used(name, form.correspondence)
                label = row.row()
                label.alignment = "RIGHT"
                label.label(text=spec.label)
                row.prop(form, name, text="")
        if changed:
            row = layout.row()
            preset = form.bl_rna.properties["preset"].enum_items[form.preset].name
            row.label(text=f"{len(changed)} changed from {preset}")
            row.operator("femors.reset_preset", text="", icon="LOOP_BACK")


class FEMORS_PT_morph_figures(FemorsPanel, bpy.types.Panel):
    """The figures of the morph that made the active object's shape."""

    bl_idname = "FEMORS_PT_morph_figures"
    bl_parent_id = "FEMORS_PT_morph"
    bl_label = "Figures"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The active object must come from a morph."""
        item = context.object
        return item is not None and bool(item.femors.report) and JobOperator.current is None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the table."""
        draw_figures(self.layout, parsed(context.object.femors.report), context)


def is_used(name: str, correspondence: str) -> bool:
    """Whether a setting does anything with this way to find vectors: closest points ask for no normals."""
    return "normal_" not in name or correspondence != "surface"


def draw_presets(self: bpy.types.Panel, context: bpy.types.Context) -> None:
    """Draw the menu of saved presets with its + and - in a panel's head."""
    row = self.layout.row(align=True)
    row.emboss = "NONE"
    row.menu("FEMORS_MT_presets", text="", icon="PRESET")
    row.operator("femors.preset_add", text="", icon="ADD")
    row.operator("femors.preset_add", text="", icon="REMOVE").remove_active = True


def draw_pickers(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw source and target, the button that fills them, and what an empty form would take."""
    form = context.scene.femors
    column = layout.column(align=True)
    column.prop(form, "source", icon="MESH_DATA")
    column.prop(form, "target", icon="MESH_DATA")
    row = layout.row()
    row.use_property_split = False
    row.operator("femors.pick_selection", text="Pick from Selection", icon="RESTRICT_SELECT_OFF")
    if form.source is None and form.target is None:
        source, target = chosen(context)
        if source is not None and target is not None:
            layout.label(text=f"Selected: {source.name} onto {target.name}", icon="INFO")
        elif source is not None:
            layout.label(text="Now Shift-click the source", icon="INFO")
        else:
            layout.label(text="Select the target, then the source", icon="INFO")


def draw_options(layout: bpy.types.UILayout, form: Any) -> None:
    """Draw the settings that a user should think of, and where the result goes."""
    simple = [name for name, (_, spec) in specs(MorphSettings).items() if not spec.advanced]
    ticks = [name for name in simple if isinstance(getattr(form, name), bool)]
    column = layout.column(align=True)
    for name in simple:
        if name not in ticks:
            column.prop(form, name)
        if name == "preset" and form.preset == "published":
            hint = column.row()
            hint.alignment = "RIGHT"
            hint.label(text="lengths in mm", icon="INFO")
    column = layout.column(align=True)
    for name in ticks:
        column.prop(form, name)
    layout.prop(form, "result")
    layout.prop(form, "hide_target")


def draw_own_job(layout: bpy.types.UILayout, *titles: str) -> bool:
    """Draw the running job where a panel has started it; whether it did. Other panels keep their buttons."""
    job = JobOperator.current
    if job is None or job.title not in titles:
        return False
    draw_job(layout, job)
    return True


def draw_job(layout: bpy.types.UILayout, job: Job) -> None:
    """Draw progress, what is being done, and Cancel."""
    box = layout.box().column()
    seconds = int(time.monotonic() - job.started)
    box.progress(factor=job.fraction, text=f"{job.title}  {job.fraction:.0%}  ({seconds} s)")
    words = job.text.split(", ")
    lines = box.column(align=True)  # always three, or the button below would move under the mouse
    stage = ", ".join(words[:2])
    lines.label(text=stage[:1].upper() + stage[1:])  # names in it stay as they are
    lines.label(text=", ".join(words[2:]))
    lines.label(text=time_left(job).capitalize())
    row = box.row()
    row.scale_y = 1.4
    row.operator("femors.cancel", text="Cancel", icon="X")


classes = (FEMORS_PT_morph, FEMORS_PT_morph_advanced, FEMORS_PT_morph_figures)
