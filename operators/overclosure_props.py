# SPDX-License-Identifier: GPL-3.0-or-later
"""The form of the panel Overclosure, `Scene.femors_overclosure`: bodies, pairs, settings, figures.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

from typing import Any

import bpy

from ..femors_addon.overclosure_settings import OverclosureSettings
from . import form
from .props import ARGUMENT, FORM, add_properties, setting_properties

SOURCES = (
    ("SELECTION", "Selection", "The meshes in the list, or the selected ones while it is empty"),
    ("COLLECTION", "Collection", "All meshes of a collection and of those in it"),
)
RESULTS = (
    ("SHAPE_KEY", "Shape Key", "Add a shape key to each body that moved: its slider blends back"),
    ("IN_PLACE", "In Place", "Move the vertices themselves"),
)


def body_arguments() -> dict[str, Any]:
    """Return the operators' arguments that say which bodies and pairs are meant."""
    described = {
        "bodies": "Names of the objects, 'A;B;C'; without them the collection's, or the selected ones",
        "collection": "Name of the collection that holds the bodies, where they are not named",
        "rigid": "Names of bodies that stay as they are, 'A;B', beside those whose role is Rigid",
        "shares": "Shares of single bodies in place of their own, 'A=0.3;B=1'; 0 is rigid; of two bodies "
        "the one that is not named takes the rest of 1",
        "exclude": "Pairs that may overlap, 'A,B;C,D'",
        "gaps": "Gaps of single pairs, 'A,B=0.02;C,D=0'",
    }
    return {
        name: bpy.props.StringProperty(name=name.capitalize(), description=text, options=set(ARGUMENT))
        for name, text in described.items()
    }


def result_property(flags: frozenset[str] = FORM) -> dict[str, Any]:
    """Return the property that says where moved bodies go."""
    return {
        "result": bpy.props.EnumProperty(
            name="Result", description="Where the moved vertices go", items=RESULTS, options=set(flags)
        )
    }


class FEMORS_PG_body(bpy.types.PropertyGroup):
    """An object in the list of bodies."""

    item: bpy.props.PointerProperty(
        type=bpy.types.Object, poll=form.is_mesh, name="Body", description="A body that may overlap others"
    )


class FEMORS_PG_pair(bpy.types.PropertyGroup):
    """Two bodies that overlap or are near each other, as they were measured last."""

    one: bpy.props.StringProperty(name="One", description="Name of the first body")
    two: bpy.props.StringProperty(name="Two", description="Name of the second body")
    least: bpy.props.FloatProperty(
        name="Gap",
        description="Smallest signed distance of a node of one to the other's surface; negative inside",
    )
    depth: bpy.props.FloatProperty(
        name="Depth",
        description="How deep the deepest node of one is inside the other; where none is, how deep an edge",
    )
    over: bpy.props.IntProperty(name="Nodes over", description="Nodes that are closer than the gap")
    crossings: bpy.props.IntProperty(name="Crossings", description="Pairs of triangles that cross")
    shared: bpy.props.FloatProperty(
        name="Shared volume", description="Volume that both take up; -1 where it could not be computed"
    )
    state: bpy.props.StringProperty(name="State", description="clear, too near, overlap or contained")
    where: bpy.props.FloatVectorProperty(
        name="Where", description="Place of the smallest distance, in world coordinates"
    )
    exclude: bpy.props.BoolProperty(
        name="Exclude",
        description="These two may overlap, such as a cartilage tied to its bone: they are left alone",
        options=set(FORM),
    )
    own_gap: bpy.props.BoolProperty(
        name="Own gap", description="Ask another gap of this pair than of the others", options=set(FORM)
    )
    gap: bpy.props.FloatProperty(
        name="Gap",
        description="Least distance of the nodes of each of these two to the other's surface afterwards",
        min=0.0,
        precision=3,
        options=set(FORM),
    )


@add_properties(setting_properties(OverclosureSettings), result_property())
class FEMORS_PG_overclosure(bpy.types.PropertyGroup):
    """The panel's form, `Scene.femors_overclosure`."""

    bodies_from: bpy.props.EnumProperty(
        name="Bodies", description="Which objects are the bodies", items=SOURCES, options=set(FORM)
    )
    bodies: bpy.props.CollectionProperty(type=FEMORS_PG_body, name="Bodies", description="The list of bodies")
    collection: bpy.props.PointerProperty(
        type=bpy.types.Collection, name="Collection", description="All meshes in it are bodies"
    )
    pairs: bpy.props.CollectionProperty(
        type=FEMORS_PG_pair, name="Pairs", description="Pairs of bodies, the deepest first"
    )
    pair_index: bpy.props.IntProperty(
        name="Pair",
        description="Click to select and frame both objects",
        default=-1,
        min=-1,
        update=form.pair_chosen,
        options=set(FORM),
    )
    report: bpy.props.StringProperty(
        name="Report", description="Figures of the last check or removal, as JSON", options={"HIDDEN"}
    )


classes = (FEMORS_PG_body, FEMORS_PG_pair, FEMORS_PG_overclosure)


def register() -> None:
    """Register the form and hang it on scenes."""
    for cls in classes:
        bpy.utils.register_class(cls)
    bpy.types.Scene.femors_overclosure = bpy.props.PointerProperty(type=FEMORS_PG_overclosure)


def unregister() -> None:
    """Take the form back."""
    del bpy.types.Scene.femors_overclosure
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
