# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender properties made from the core's settings: the panel's form and the operators' arguments.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import bpy

from ..femors_addon.morph_settings import MorphSettings
from ..femors_addon.settings import specs
from . import form

T = TypeVar("T")

FORM = frozenset[str]()
"""Options of the form's properties: not animatable, or every field would grow a keyframe dot."""
ARGUMENT = frozenset({"SKIP_SAVE"})
"""Options of an operator's properties: a call starts from the defaults, not from the call before."""

RESULTS = (
    ("NEW", "New Object", "Leave the source as it is and make a morphed copy of it"),
    ("SHAPE_KEY", "Shape Key", "Add a shape key to the source: its slider blends from source to morphed"),
    ("IN_PLACE", "In Place", "Move the vertices of the source itself"),
)

ROLES = (
    ("DEFORMABLE", "Deformable", "Takes its share of the way apart", "MOD_SIMPLEDEFORM", 0),
    ("RIGID", "Rigid", "Stays as it is, to the last bit", "LOCKED", 1),
)
"""What a body does where overclosures are removed."""

RESULT_OPTIONS = ("result", "vertex_group", "use_evaluated", "use_landmarks", "hide_target")
"""Names of `result_properties`."""


def setting_properties(
    cls: type, update: dict[str, Callable] | None = None, flags: frozenset[str] = FORM
) -> dict[str, Any]:
    """Return one Blender property for each setting of a dataclass, by name.

    Parameters
    ----------
    update : dict
        By setting name, a function (self, context) that Blender calls when the value changes.
    flags : set of str
        Blender's property options.
    """
    made = {}
    for name, (field, spec) in specs(cls).items():
        default = field.default
        options: dict[str, Any] = {"name": spec.label, "description": spec.help, "default": default}
        options["options"] = set(flags)
        if update and name in update:
            options["update"] = update[name]
        if spec.choices:
            made[name] = bpy.props.EnumProperty(items=spec.choices, **options)
        elif isinstance(default, bool):
            made[name] = bpy.props.BoolProperty(**options)
        elif isinstance(default, str):
            made[name] = bpy.props.StringProperty(**options)
        else:
            if spec.minimum is not None:
                options["min"] = spec.minimum
            if spec.maximum is not None:
                options["max"] = spec.maximum
            if isinstance(default, int):
                made[name] = bpy.props.IntProperty(**options)
            else:
                made[name] = bpy.props.FloatProperty(**options, **_float_display(default, spec.unit))
    return made


def _float_display(default: float, unit: str) -> dict[str, Any]:
    """Return how a number is shown; small defaults such as 1e-4 need more digits.

    Lengths are plain: with a unit, Blender would write 10 mm as "10 m" in a scene whose scale is 1.
    """
    shown: dict[str, Any] = {"precision": 5 if 0 < abs(default) < 0.01 else 3}
    if unit == "angle":
        shown["subtype"] = "ANGLE"
    return shown


def add_properties(*groups: dict[str, Any]) -> Callable[[type[T]], type[T]]:
    """Class decorator: add property definitions to those that the class body gives."""

    def decorate(cls: type[T]) -> type[T]:
        merged = dict(cls.__dict__.get("__annotations__") or getattr(cls, "__annotations__", {}))
        for group in groups:
            merged.update(group)
        cls.__annotations__ = merged
        return cls

    return decorate


def result_properties(flags: frozenset[str] = FORM, hide_target: bool = False) -> dict[str, Any]:
    """Return the options of a morph that concern Blender only; they are `RESULT_OPTIONS`."""
    options = set(flags)
    return {
        "result": bpy.props.EnumProperty(
            name="Result", description="Where the morphed shape goes", items=RESULTS, options=options
        ),
        "vertex_group": bpy.props.StringProperty(
            name="Vertex Group",
            description=(
                "Vertex group of the source that says where it may move: "
                "0 stays as it was aligned, 1 follows fully"
            ),
            options=options,
        ),
        "use_evaluated": bpy.props.BoolProperty(
            name="Use Modifiers",
            description="Work on the meshes as they are seen, with modifiers and shape keys applied",
            options=options,
        ),
        "use_landmarks": bpy.props.BoolProperty(
            name="Align by landmarks",
            description=(
                "Align first by pairs of landmarks: vertex groups of exactly one vertex, "
                "with the same names on source and target; at least three"
            ),
            options=options,
        ),
        "hide_target": bpy.props.BoolProperty(
            name="Hide target",
            description=(
                "Hide the target in the viewport afterwards: beside the result, "
                "in the same place, it flickers (Alt+H shows it again)"
            ),
            default=hide_target,
            options=options,
        ),
    }


@add_properties(
    setting_properties(MorphSettings, {"preset": form.preset_chosen}), result_properties(hide_target=True)
)
class FEMORS_PG_scene(bpy.types.PropertyGroup):
    """The panel's form, `Scene.femors`."""

    source: bpy.props.PointerProperty(
        type=bpy.types.Object,
        poll=form.is_mesh,
        name="Source",
        description="The mesh that is morphed; the result keeps its vertices, faces and materials",
    )
    target: bpy.props.PointerProperty(
        type=bpy.types.Object,
        poll=form.is_mesh,
        name="Target",
        description="The shape to reach; it stays as it is",
    )


class FEMORS_PG_object(bpy.types.PropertyGroup):
    """What FEMORS keeps with an object, `Object.femors`."""

    report: bpy.props.StringProperty(
        name="Report", description="Figures of the morph that made this shape, as JSON", options={"HIDDEN"}
    )
    quality: bpy.props.StringProperty(
        name="Quality", description="Figures of this mesh as it was measured, as JSON", options={"HIDDEN"}
    )
    role: bpy.props.EnumProperty(
        name="Role",
        description="Whether this body may be moved where overclosures are removed",
        items=ROLES,
        options=set(FORM),
    )
    share: bpy.props.FloatProperty(
        name="Share",
        description="How much of the way apart this body takes: of a pair, each by its share of their sum",
        default=0.5,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
        options=set(FORM),
    )
    field: bpy.props.PointerProperty(
        type=bpy.types.Text,
        name="Field",
        description="The text that keeps the field of the morph that made this shape",
        options={"HIDDEN"},
    )


class FEMORS_PG_mesh(bpy.types.PropertyGroup):
    """Where a mesh belongs in a finite-element model, `Mesh.femors`."""

    deck: bpy.props.PointerProperty(
        type=bpy.types.Text,
        name="Deck",
        description="The text that keeps the files that this mesh was read from",
        options={"HIDDEN"},
    )
    part: bpy.props.StringProperty(
        name="Part", description="Which part of the deck this mesh is", options={"HIDDEN"}
    )


classes = (FEMORS_PG_scene, FEMORS_PG_object, FEMORS_PG_mesh)


def register() -> None:
    """Register the property groups and hang them on scenes, objects and meshes."""
    for cls in classes:
        bpy.utils.register_class(cls)
    bpy.types.Scene.femors = bpy.props.PointerProperty(type=FEMORS_PG_scene)
    bpy.types.Object.femors = bpy.props.PointerProperty(type=FEMORS_PG_object)
    bpy.types.Mesh.femors = bpy.props.PointerProperty(type=FEMORS_PG_mesh)


def unregister() -> None:
    """Take the property groups back."""
    del bpy.types.Mesh.femors
    del bpy.types.Object.femors
    del bpy.types.Scene.femors
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
