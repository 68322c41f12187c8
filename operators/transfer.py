# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator `femors.transfer`: vertex groups onto a target's mesh, and objects carried by a field.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

from typing import Any, ClassVar

import bpy

from ..femors_addon.settings import check, specs
from ..femors_addon.transfer_settings import TransferSettings
from . import (
    dependencies,
    field_operators,
    fields,
    scene,
    transfer_props,
)
from .form import exact
from .job import Compute, JobOperator
from .props import ARGUMENT, add_properties, setting_properties
from .transfer_groups import GroupsTransfer
from .transfer_objects import ObjectsTransfer
from .transfer_props import OPTIONS, transfer_options


@add_properties(setting_properties(TransferSettings, flags=ARGUMENT), transfer_options(ARGUMENT))
class FEMORS_OT_transfer(GroupsTransfer, ObjectsTransfer, JobOperator, bpy.types.Operator):
    """Carry landmarks, regions or whole objects from the field's source to its target"""

    bl_idname = "femors.transfer"
    bl_label = "Transfer"
    bl_options: ClassVar[set[str]] = {"UNDO"}
    title = "Transfer"
    core = ("landmarks", "regions", "transfer", "keptfield")

    field: bpy.props.StringProperty(
        name="Field", description="Name of the field; empty for the newest", options={"SKIP_SAVE"}
    )
    source: bpy.props.StringProperty(
        name="Source",
        description="Name of the object whose vertex groups are carried; empty for the field's own",
        options={"SKIP_SAVE"},
    )
    target: bpy.props.StringProperty(
        name="Target",
        description="Name of the object that gets the groups or is projected onto; empty for the field's own",
        options={"SKIP_SAVE"},
    )
    groups: bpy.props.StringProperty(
        name="Groups",
        description="Names of the vertex groups, with semicolons between; empty for all",
        options={"SKIP_SAVE"},
    )
    objects: bpy.props.StringProperty(
        name="Objects",
        description="Names of the objects, with semicolons between; empty for those selected",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def missing(cls, context: bpy.types.Context) -> str:
        """Say in words what is missing."""
        if context.mode != "OBJECT":
            return "Leave Edit Mode or painting first: the transfer works in Object Mode"
        if not fields.all_fields():
            return "Morph first: a field is what a morph keeps"
        return dependencies.missing()

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Take from the form what the caller has not set, and start in the background."""
        form = context.scene.femors_transfer
        for name in ("field", "source", "target"):
            item = getattr(form, name)
            if not self.properties.is_property_set(name) and item is not None:
                setattr(self, name, item.name)
        for name in (*OPTIONS, *specs(TransferSettings)):
            if not self.properties.is_property_set(name):
                setattr(self, name, getattr(form, name))
        return self.run_modal(context)

    # --- read ---------------------------------------------------------------------------------
    def prepare(self, context: bpy.types.Context) -> Compute:
        """Read the field and what it is to carry; return the transfer as a function of progress."""
        dependencies.require()
        settings = TransferSettings(self.space, exact(self.strength), self.inverse)
        check(settings)
        text = fields.find(self.field)
        self._field, self._head = text.name, fields.head_of(text)
        self._target = None
        if self.what == "GROUPS":
            return self.prepare_groups(context, text, settings)
        return self.prepare_objects(context, text, settings)

    # --- write --------------------------------------------------------------------------------
    def apply(self, context: bpy.types.Context, got: Any) -> tuple[str, str]:
        """Write what was carried; what can be refused is refused first."""
        if self._target is not None:
            scene.unchanged(context, self._target)
        return self.apply_groups(context, got) if self.what == "GROUPS" else self.apply_objects(context, got)


classes = (FEMORS_OT_transfer, *field_operators.classes)


def register() -> None:
    """Register the form and the operators."""
    transfer_props.register()
    for cls in classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take them back."""
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
    transfer_props.unregister()
