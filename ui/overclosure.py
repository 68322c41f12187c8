# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel Overclosure: bodies and their roles, pairs, Check and Remove, and the figures afterwards."""

from __future__ import annotations

from typing import Any, ClassVar

import bpy

from ..femors_addon.overclosure_settings import OverclosureSettings
from ..femors_addon.settings import specs
from ..operators import bodies, dependencies
from ..operators.job import JobOperator
from ..operators.overclosure import gap
from .figures import (
    draw_beside,
    draw_figure,
    draw_row,
    draw_sentence,
    fixed,
    length_unit,
    narrow,
    number,
    parsed,
)
from .overclosure_figures import draw_removal
from .panels import FemorsPanel, draw_own_job

BODY, BODY_NARROW = 0.55, 0.45
"""Of the width of the list of bodies: their names."""
LINE = 0.6
"""Height of each of the two names: for the mouse a row of a list is one line high."""
ROWS = 5
"""Of the table of pairs, before it is scrolled."""
SHOWN = 12
"""Bodies that the panel lists."""
ICONS = {"clear": "CHECKMARK", "too near": "ERROR", "overlap": "CANCEL", "contained": "CANCEL"}
WORDS = {"clear": "clear", "too near": "too near", "overlap": "overlap", "contained": "one inside the other"}


class FEMORS_UL_pairs(bpy.types.UIList):
    """Pairs of bodies with depth and state; all else is told of the one that is clicked."""

    bl_idname = "FEMORS_UL_pairs"

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index=0, flag=0):
        """Draw a row; a tick says whether the pair counts."""
        factor, _ = length_unit(context.scene.unit_settings)
        row = layout.row(align=True)
        if not narrow(context):  # else the names have the room; both are below the table too
            tick = "CHECKBOX_DEHLT" if item.exclude else "CHECKBOX_HLT"
            row.prop(item, "exclude", text="", icon=tick, emboss=False)
        cells = row.row(align=True)
        cells.active = not item.exclude
        names = cells.column(align=True)
        for name in (item.one, item.two):
            line = names.row()
            line.scale_y = LINE
            line.label(text=name)
        names.separator(factor=0.5)
        if not narrow(context):
            draw_figure(cells, fixed(factor * item.depth) if item.depth > 0 else "-")
        cells.label(text="", icon=ICONS.get(item.state, "BLANK1"))

    def filter_items(self, context, data, name):
        """Keep the order; find a body by its name."""
        pairs = getattr(data, name)
        wanted = self.filter_name.lower()
        shown = [wanted in f"{pair.one} - {pair.two}".lower() for pair in pairs]
        return [self.bitflag_filter_item if one else 0 for one in shown], []


class FEMORS_PT_overclosure(FemorsPanel, bpy.types.Panel):
    """Bodies, what matters, and two large buttons."""

    bl_idname = "FEMORS_PT_overclosure"
    bl_label = "Overclosure"
    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the form, or the running job."""
        layout = self.layout
        form = context.scene.femors_overclosure
        sentence = dependencies.missing()
        if sentence:
            draw_sentence(layout, context, sentence, "ERROR")
        column = layout.column()
        column.enabled = JobOperator.current is None
        draw_bodies(column, context)
        settings = column.column(align=True)
        settings.use_property_split = True
        settings.use_property_decorate = False
        settings.prop(form, "gap")
        settings.prop(form, "method")
        if form.method == "published":
            hint = settings.row()
            hint.alignment = "RIGHT"
            hint.label(text="lengths in mm", icon="INFO")
        settings.prop(form, "result")
        if draw_own_job(layout, "Check", "Overclosure"):
            return
        missing = gap(context)
        if missing:
            draw_sentence(layout, context, missing, "INFO")
        buttons = layout.row(align=True)
        buttons.scale_y = 1.6
        buttons.context_pointer_set("femors_form", form)
        buttons.operator("femors.check_overclosure", text="Check", icon="VIEWZOOM")
        buttons.operator("femors.remove_overclosure", text="Remove", icon="MOD_EXPLODE")


class FEMORS_PT_overclosure_pairs(FemorsPanel, bpy.types.Panel):
    """The table of pairs, and the one that was clicked."""

    bl_idname = "FEMORS_PT_overclosure_pairs"
    bl_parent_id = "FEMORS_PT_overclosure"
    bl_label = "Pairs"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A check must have been made."""
        return bool(context.scene.femors_overclosure.report)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the table."""
        layout = self.layout
        layout.enabled = JobOperator.current is None
        form = context.scene.femors_overclosure
        report = parsed(form.report)
        if report["kind"] == "check":
            for warning in report.get("warnings", ()):
                draw_sentence(layout, context, warning, "ERROR")
        if not len(form.pairs):
            layout.label(text="No two bodies are near each other", icon="CHECKMARK")
            return
        column = layout.column(align=True)
        heading = column.row(align=True)
        heading.scale_y = 0.7
        if narrow(context):
            heading.label(text="Pair")
        else:
            heading.label(text="", icon="BLANK1")
            heading.label(text="Pair")
            draw_figure(heading, "Depth")
            heading.label(text="", icon="BLANK1")
        draw_beside(heading, len(form.pairs) > ROWS)
        column.template_list(
            FEMORS_UL_pairs.bl_idname,
            "",
            form,
            "pairs",
            form,
            "pair_index",
            rows=min(max(len(form.pairs), 2), ROWS),
        )
        if 0 <= form.pair_index < len(form.pairs):
            draw_pair(layout, context, form.pairs[form.pair_index])


class FEMORS_PT_overclosure_figures(FemorsPanel, bpy.types.Panel):
    """The certificate in words, and the figures before and after."""

    bl_idname = "FEMORS_PT_overclosure_figures"
    bl_parent_id = "FEMORS_PT_overclosure"
    bl_label = "Figures"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A removal must have been made last."""
        report = context.scene.femors_overclosure.report
        return bool(report) and JobOperator.current is None and parsed(report)["kind"] == "removal"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the certificate and the tables."""
        draw_removal(self.layout, context, parsed(context.scene.femors_overclosure.report))


class FEMORS_PT_overclosure_advanced(FemorsPanel, bpy.types.Panel):
    """Everything that has a good default."""

    bl_idname = "FEMORS_PT_overclosure_advanced"
    bl_parent_id = "FEMORS_PT_overclosure"
    bl_label = "Advanced"
    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the advanced settings in their order."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.enabled = JobOperator.current is None
        column = layout.column(align=True)
        for name, (_, spec) in specs(OverclosureSettings).items():
            if spec.advanced:
                column.prop(context.scene.femors_overclosure, name)


# --- parts ------------------------------------------------------------------------------------------
def draw_bodies(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw where the bodies come from, and each with its role."""
    form = context.scene.femors_overclosure
    layout.row().prop(form, "bodies_from", expand=True)
    if form.bodies_from == "COLLECTION":
        layout.prop(form, "collection", text="")
    else:
        row = layout.row(align=True)
        row.operator("femors.take_bodies", icon="RESTRICT_SELECT_OFF")
        if form.bodies:
            row.operator("femors.take_bodies", text="", icon="X").clear = True
    items = bodies.chosen(context)
    if not items:
        return
    box = layout.box().column(align=True)
    little = narrow(context)
    heading = box.split(factor=BODY_NARROW if little else BODY, align=True)
    heading.scale_y = 0.7
    heading.label(text="Body")
    heading.label(text="Gives" if little else "Gives way by")
    for item in items[:SHOWN]:
        split = box.split(factor=BODY_NARROW if little else BODY, align=True)
        split.label(text=item.name, icon="NONE" if little else "MESH_DATA")
        role = split.row(align=True)
        if bodies.is_linked(item):
            role.label(text="Rigid (linked)", icon="LINKED")
            continue
        role.prop(item.femors, "role", text="", icon_only=True)
        if item.femors.role == "RIGID":
            role.label(text="Rigid")
        else:
            role.prop(item.femors, "share", text="")
    if len(items) > SHOWN:
        box.label(text=f"and {len(items) - SHOWN} more")


def draw_pair(layout: bpy.types.UILayout, context: bpy.types.Context, pair: Any) -> None:
    """Draw a pair in full, with what may be asked of it."""
    factor, unit = length_unit(context.scene.unit_settings)
    named, cubed = ("", "") if unit == "scene units" else (f" ({unit})", f" ({unit}³)")
    box = layout.box().column(align=True)
    box.label(text=pair.one, icon="MESH_DATA")
    box.label(text=pair.two, icon="MESH_DATA")
    if pair.state in WORDS:
        box.label(text=WORDS[pair.state].capitalize(), icon=ICONS[pair.state])
        deep = pair.depth > 0
        lines = [("Depth" if deep else "Gap", number(factor * (pair.depth if deep else pair.least)), named)]
        lines += [("Nodes too near", str(pair.over), "")] if pair.over else []
        lines += [("Crossing triangles", str(pair.crossings), "")] if pair.crossings else []
        lines += [("Shared volume", number(factor**3 * pair.shared), cubed)] if pair.shared > 0 else []
        for words, value, its_unit in lines:
            draw_row(box, words + its_unit, value, factor=0.68)
    box.prop(pair, "exclude", text="May overlap" if narrow(context) else "May overlap (excluded)")
    row = box.split(factor=0.6, align=True)
    row.active = not pair.exclude
    row.prop(pair, "own_gap")
    value = row.row(align=True)
    value.enabled = pair.own_gap
    value.prop(pair, "gap", text="")


classes = (
    FEMORS_UL_pairs,
    FEMORS_PT_overclosure,
    FEMORS_PT_overclosure_pairs,
    FEMORS_PT_overclosure_figures,
    FEMORS_PT_overclosure_advanced,
)
