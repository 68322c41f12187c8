# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel Report and Film of the sidebar tab FEMORS."""

from __future__ import annotations

from typing import ClassVar

import bpy

from ..operators.report import reported
from .panels import FemorsPanel


class FEMORS_PT_report(FemorsPanel, bpy.types.Panel):
    """What to take away from a result."""

    bl_idname = "FEMORS_PT_report"
    bl_label = "Report and Film"
    bl_order = 32
    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw two buttons, and which result they are about."""
        layout = self.layout
        item = context.object
        if reported(item):
            layout.label(text=item.name, icon="MESH_DATA")
        else:
            layout.label(text="Select a result", icon="INFO")
        column = layout.column()
        column.scale_y = 1.3
        column.context_pointer_set("femors_form", context.scene.femors)
        column.operator("femors.report", text="Write Report...", icon="FILE_TEXT")
        column.operator("femors.animate", icon="KEYFRAME_HLT")


classes = (FEMORS_PT_report,)
