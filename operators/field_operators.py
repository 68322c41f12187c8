# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons beside a field in the panel: choose it, delete it.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

from typing import ClassVar

import bpy

from ..femors_addon.progress import FemorsError
from . import fields


class FEMORS_OT_choose_field(bpy.types.Operator):
    """Choose this field for the next transfer"""

    bl_idname = "femors.choose_field"
    bl_label = "Choose Field"
    bl_options: ClassVar[set[str]] = {"UNDO", "INTERNAL"}

    name: bpy.props.StringProperty(name="Field", description="Its name", options={"SKIP_SAVE"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Set the form's field."""
        context.scene.femors_transfer.field = bpy.data.texts.get(self.name)
        return {"FINISHED"}


class FEMORS_OT_remove_field(bpy.types.Operator):
    """Delete this field from the file"""

    bl_idname = "femors.remove_field"
    bl_label = "Delete Field"
    bl_options: ClassVar[set[str]] = {"UNDO", "INTERNAL"}

    name: bpy.props.StringProperty(name="Field", description="Its name", options={"SKIP_SAVE"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove the text."""
        try:
            bpy.data.texts.remove(fields.find(self.name))
        except FemorsError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


classes = (FEMORS_OT_choose_field, FEMORS_OT_remove_field)
