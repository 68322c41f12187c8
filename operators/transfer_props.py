# SPDX-License-Identifier: GPL-3.0-or-later
"""The form of the panel Transfer, `Scene.femors_transfer`, and what the operator shares with it.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

from typing import Any

import bpy

from ..femors_addon.transfer_settings import TransferSettings
from . import form
from .props import FORM, add_properties, setting_properties

WHAT = (
    ("GROUPS", "Vertex Groups", "Landmarks and regions of the source, as vertex groups on the target's mesh"),
    ("OBJECTS", "Selected Objects", "Meshes, curves, point clouds, armatures and empties"),
)
RESULTS = (
    ("COPY", "Copies", "Leave the objects as they are and make carried copies"),
    (
        "SHAPE_KEY",
        "Shape Keys",
        "Add a shape key to each mesh: its slider carries it along",
    ),
)
SORTS = (
    ("ORDER", "Order", "As they came"),
    ("NAME", "Name", "By name"),
    ("distance", "Away", "Farthest from the source's surface first"),
    ("residual", "Fit", "Where the target is farthest from the morphed surface first"),
    ("stretch", "Scale", "Most stretched or squeezed first"),
    ("spread", "Spread", "Largest spread of the templates first"),
)
OPTIONS = ("what", "result", "use_groups", "use_empties", "use_templates", "project")
"""Names of `transfer_options`."""


def named(text: str) -> list[str]:
    """Return names that stand in one string, with semicolons between."""
    return [name.strip() for name in text.split(";") if name.strip()]


def transfer_options(flags: frozenset[str] = FORM) -> dict[str, Any]:
    """Return the options of a transfer that concern Blender only; they are `OPTIONS`."""
    options = set(flags)
    return {
        "what": bpy.props.EnumProperty(
            name="Carry", description="What the field is applied to", items=WHAT, options=options
        ),
        "result": bpy.props.EnumProperty(
            name="Result", description="What becomes of the objects", items=RESULTS, options=options
        ),
        "use_groups": bpy.props.BoolProperty(
            name="Groups on target",
            description="Landmarks and regions become vertex groups of the target's own mesh",
            default=True,
            options=options,
        ),
        "use_empties": bpy.props.BoolProperty(
            name="Empties at landmarks",
            description="Each landmark also becomes an empty, at the very point that was predicted",
            options=options,
        ),
        "use_templates": bpy.props.BoolProperty(
            name="Median of templates",
            description=(
                "Predict the landmarks from the source of every field to the same target, "
                "and take the median; their spread tells how far they agree"
            ),
            options=options,
        ),
        "project": bpy.props.BoolProperty(
            name="Project onto target",
            description="Lay what is carried onto the target's surface",
            options=options,
        ),
    }


class FEMORS_PG_mark(bpy.types.PropertyGroup):
    """A row of the table of landmarks; -1 stands for a figure that is not known."""

    distance: bpy.props.FloatProperty(name="Distance", description="From the source's surface")
    residual: bpy.props.FloatProperty(
        name="Residual", description="How far the target is from the morphed surface around it"
    )
    stretch: bpy.props.FloatProperty(name="Stretch", description="Of the surface there, source to target")
    projected: bpy.props.FloatProperty(name="Projected", description="Moved onto the target's surface")
    spread: bpy.props.FloatProperty(name="Spread", description="Of the templates", default=-1.0)
    templates: bpy.props.IntProperty(name="Templates", description="How many have predicted it", default=1)
    point: bpy.props.FloatVectorProperty(name="Point", description="Where it was predicted", size=3)


@add_properties(setting_properties(TransferSettings), transfer_options())
class FEMORS_PG_transfer(bpy.types.PropertyGroup):
    """The panel's form, `Scene.femors_transfer`."""

    field: bpy.props.PointerProperty(
        type=bpy.types.Text,
        poll=form.is_field,
        name="Field",
        description="What a morph has kept: it carries things from its source to its target",
    )
    source: bpy.props.PointerProperty(
        type=bpy.types.Object,
        poll=form.is_mesh,
        name="Source",
        description="The mesh whose vertex groups are carried; empty for the field's own",
    )
    target: bpy.props.PointerProperty(
        type=bpy.types.Object,
        poll=form.is_mesh,
        name="Target",
        description="The mesh that receives the groups, or is projected onto; empty for the field's own",
    )
    marks: bpy.props.CollectionProperty(type=FEMORS_PG_mark)
    mark: bpy.props.IntProperty(name="Landmark", description="The row that is chosen", options={"HIDDEN"})
    report: bpy.props.StringProperty(
        name="Report", description="What is known of the last transfer, as JSON", options={"HIDDEN"}
    )
    title: bpy.props.StringProperty(name="Title", description="Whose landmarks the table lists")
    sort: bpy.props.EnumProperty(
        name="Sort", description="How the table is sorted", items=SORTS, options=set(FORM)
    )


classes = (FEMORS_PG_mark, FEMORS_PG_transfer)


def register() -> None:
    """Register the form and hang it on scenes."""
    for cls in classes:
        bpy.utils.register_class(cls)
    bpy.types.Scene.femors_transfer = bpy.props.PointerProperty(type=FEMORS_PG_transfer)


def unregister() -> None:
    """Take the form back."""
    del bpy.types.Scene.femors_transfer
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
