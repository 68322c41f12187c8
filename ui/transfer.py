# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel Transfer: choose a field, choose what, go; and the table of landmarks."""

from __future__ import annotations

from typing import Any, ClassVar

import bpy

from ..operators import fields
from ..operators.job import JobOperator
from ..operators.lazy import np
from .figures import draw_beside, draw_figure, draw_row, draw_sentence, fixed, length_unit, narrow, number
from .panels import FemorsPanel, draw_own_job

FIGURES = {
    "distance": ("Away", "Away from the source"),
    "residual": ("Fit", "Target away from the morph"),
    "stretch": ("Scale", "Scale of the surface"),
    "projected": ("Projected", "Projected by"),
    "spread": ("Spread", "Spread of templates"),
}
"""Of a landmark: the head of the table's column, and the words below the table."""
NAMES = 0.74  # of the width of a landmark's figures
ROWS = 6
LENGTHS = ("distance", "residual", "projected", "spread")


class FEMORS_UL_marks(bpy.types.UIList):
    """Landmarks, each with one figure that tells how far to trust it; the others are below the table."""

    bl_idname = "FEMORS_UL_marks"

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index=0, flag=0):
        """Draw a row."""
        factor, _ = length_unit(context.scene.unit_settings)
        draw_cells(layout, item.name, figure(item, column(data), factor))

    def filter_items(self, context, data, name):
        """Sort as the form says; the largest figures first."""
        marks = list(getattr(data, name))
        flags = bpy.types.UI_UL_list.filter_items_by_name(
            self.filter_name, self.bitflag_filter_item, marks, "name", reverse=False
        )
        rows = sorted_rows(marks, data.sort)
        order = [0] * len(rows)
        for place, row in enumerate(rows):
            order[row] = place
        return flags, order


def sorted_rows(marks: list[Any], sort: str) -> list[int]:
    """Return the rows of the table in the order that the form asks for."""
    rows = list(range(len(marks)))
    if sort == "NAME":
        rows.sort(key=lambda row: marks[row].name.lower())
    elif sort != "ORDER":
        rows.sort(key=lambda row: -_weight(sort, getattr(marks[row], sort)))
    return rows


def _weight(name: str, value: float) -> float:
    """How much a figure calls for a look."""
    if name == "stretch":
        return abs(float(np.log(max(value, 1e-9))))
    return abs(value) if name == "distance" else value


def column(form: Any) -> str:
    """Return the figure that the table shows: the one that it is sorted by, else the fit."""
    return form.sort if form.sort in FIGURES else "residual"


def figure(mark: Any, name: str, factor: float) -> str:
    """Return a landmark's figure in the scene's unit; "-" where it is not known."""
    value = getattr(mark, name)
    if (name == "spread" and value < 0) or not np.isfinite(value):
        return "-"
    return fixed(value * (factor if name in LENGTHS else 1.0))


def draw_cells(layout: bpy.types.UILayout, title: str, text: str) -> None:
    """Draw a name and a figure to the right."""
    row = layout.row(align=True)
    row.label(text=title)
    draw_figure(row, text)


class FEMORS_PT_transfer(FemorsPanel, bpy.types.Panel):
    """Fields, what is carried, and one large button."""

    bl_idname = "FEMORS_PT_transfer"
    bl_label = "Transfer"
    bl_order = 10
    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the fields and the form, or the running job."""
        layout, form = self.layout, context.scene.femors_transfer
        known = fields.all_fields()
        if not known:
            draw_sentence(layout, context, "Morph first: the morph's field is kept and listed here", "INFO")
            draw_files(layout)
            return
        chosen = form.field if form.field in known else known[0]
        body = layout.column()
        body.enabled = JobOperator.current is None
        draw_fields(body, context, known, chosen)
        draw_form(body, form, fields.head_of(chosen))
        if draw_own_job(layout, "Transfer"):
            return
        button = layout.column()
        button.scale_y = 1.6
        button.operator("femors.transfer", text="Transfer", icon="TRACKING_FORWARDS_SINGLE")
        if form.report:
            layout.operator("femors.report", text="Write Report...", icon="FILE_TEXT").transfer = True
        draw_files(layout)


class FEMORS_PT_marks(FemorsPanel, bpy.types.Panel):
    """The landmarks that were predicted last."""

    bl_idname = "FEMORS_PT_marks"
    bl_parent_id = "FEMORS_PT_transfer"
    bl_label = "Landmarks"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be some."""
        return len(context.scene.femors_transfer.marks) > 0

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the table, and the button that writes it."""
        layout, form = self.layout, context.scene.femors_transfer
        factor, unit = length_unit(context.scene.unit_settings)
        words = layout.column(align=True)
        words.scale_y = 0.8
        words.label(text=form.title)
        words.label(text=f"lengths in {unit}")
        row = layout.row()
        row.use_property_split = True
        row.use_property_decorate = False
        row.prop(form, "sort", text="Sort by")
        head = layout.row(align=True)
        head.scale_y = 0.7
        draw_cells(head.row(), "Name", FIGURES[column(form)][0])
        draw_beside(head, len(form.marks) > ROWS)
        layout.template_list("FEMORS_UL_marks", "", form, "marks", form, "mark", rows=ROWS)
        if 0 <= form.mark < len(form.marks):
            draw_mark(layout, form.marks[form.mark], factor, narrow(context))
        export = layout.operator("femors.export_landmarks", text="Export Table", icon="EXPORT")
        export.use_table = export.use_figures = True


def draw_mark(layout: bpy.types.UILayout, mark: Any, factor: float, little: bool) -> None:
    """Draw all figures of a landmark, in words; in those of the table's head where there is little room."""
    box = layout.box().column(align=True)
    box.label(text=mark.name, icon="EMPTY_AXIS")
    for name, (head, words) in FIGURES.items():
        if (name == "spread" and mark.spread < 0) or (name == "projected" and not mark.projected):
            continue  # there were no several templates, or no projection
        draw_row(box, head if little else words, figure(mark, name, factor), factor=NAMES)


def draw_fields(
    layout: bpy.types.UILayout, context: bpy.types.Context, known: list[Any], chosen: Any
) -> None:
    """Draw the fields of this file, the chosen one pressed, with its date and figures below."""
    column = layout.box().column(align=True)
    for text in known:
        row = column.row(align=True)
        row.operator("femors.choose_field", text=text.name, depress=text == chosen).name = text.name
        row.operator("femors.remove_field", text="", icon="X").name = text.name
    head = fields.head_of(chosen)
    factor, unit = length_unit(context.scene.unit_settings)
    figures = head.get("figures", {}).get("target_to_surface", {})
    lines = layout.column(align=True)
    lines.scale_y = 0.7
    lines.label(text=str(head.get("date", ""))[:16].replace("T", "  "), icon="TIME")
    if figures:
        median, p99 = (number(factor * figures[key]) for key in ("median", "p99"))
        named = "" if unit == "scene units" else f" {unit}"
        lines.label(text=f"fit: median {median}, 99 % {p99}{named}", icon="BLANK1")


def draw_form(layout: bpy.types.UILayout, form: Any, head: dict[str, Any]) -> None:
    """Draw what is carried, and how."""
    row = layout.row()
    row.prop(form, "what", expand=True)
    column = layout.column()
    column.use_property_split = True
    column.use_property_decorate = False
    if form.what == "GROUPS":
        column.prop(form, "source", icon="MESH_DATA")
        column.prop(form, "target", icon="MESH_DATA")
        if form.source is None and form.target is None:
            column.label(text=f"{head.get('source', '?')} onto {head.get('target', '?')}", icon="INFO")
        ticks = column.column(align=True)
        for name in ("use_groups", "use_empties", "use_templates", "project"):
            ticks.prop(form, name)
        return
    column.prop(form, "result")
    column.prop(form, "strength", slider=True)
    ticks = column.column(align=True)
    ticks.prop(form, "inverse")
    ticks.prop(form, "project")
    if form.project:
        column.prop(form, "target", icon="MESH_DATA")


def draw_files(layout: bpy.types.UILayout) -> None:
    """Draw the buttons for landmark files."""
    column = layout.column(align=True)
    heading = column.row()
    heading.scale_y = 0.7
    heading.label(text="Landmark files")
    row = column.row(align=True)
    row.operator("femors.import_landmarks", text="Import", icon="IMPORT")
    row.operator("femors.export_landmarks", text="Export", icon="EXPORT")


classes = (FEMORS_UL_marks, FEMORS_PT_transfer, FEMORS_PT_marks)
