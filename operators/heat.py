# SPDX-License-Identifier: GPL-3.0-or-later
"""Heat maps: a quantity as a colour attribute, the viewport's shading for it, and the way back.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

from typing import Any, ClassVar

import bpy

from ..femors_addon.progress import FemorsError, counted
from . import deck_store, dependencies, form, heat_form, scene
from .heat_shading import SHADING, redraw, shade, unshade
from .heat_values import values_of
from .lazy import Array, np

COLOURS = "femors_heat"
"""Name of the colour attribute, and of the note on a mesh that says what it shows."""
BEFORE = "femors_heat_before"
"""Name of the note on a mesh: its active colour attribute from before, or ""."""
ROUNDING = 1e-5
"""Of an object's size: differences below this are not spread over all colours."""

CHOICES = (
    ("surface_distance", "Distance to Target", "From each vertex to the surface it was laid on: mostly 0"),
    ("displacement", "Displacement", "How far each vertex was moved, after the alignment"),
    ("gap", "Gap", "Signed distance to the other mesh: negative where the two overlap"),
    ("aspect", "Aspect Ratio", "Longest side of a face over its shortest: 1 is best"),
    ("skewness", "Skewness", "0 is an equilateral triangle, 1 has no area"),
    ("scaled_jacobian", "Scaled Jacobian", "1 is regular, 0 flat, negative inside out; of FE parts by node"),
)
"""The keys of `femors_addon.quantities.QUANTITIES`, which takes SciPy to import; a test compares them."""


class FEMORS_PG_heat(bpy.types.PropertyGroup):
    """What the panels Quality and Heat Map ask for, `Scene.femors_heat`."""

    mesh: bpy.props.PointerProperty(
        type=bpy.types.Object,
        poll=form.is_mesh,
        name="Mesh",
        description="The mesh to be measured; empty takes the active object",
    )
    other: bpy.props.PointerProperty(
        type=bpy.types.Object,
        poll=form.is_mesh,
        name="Compare with",
        description="Another mesh, for distances and the volume in which the two differ; may be empty",
    )
    quantity: bpy.props.EnumProperty(
        name="Quantity",
        description="What the colours show",
        items=CHOICES,
        default="displacement",  # distances from what vertices were laid on would show next to nothing
        update=heat_form.changed,
    )
    automatic: bpy.props.BoolProperty(
        name="Automatic Range",
        description="From the 1st to the 99th percentile of what is shown; about zero for a signed quantity",
        default=True,
        update=heat_form.changed,
    )
    low: bpy.props.FloatProperty(
        name="From",
        description="Value of the first colour, in scene units",
        default=0.0,
        precision=3,
        update=heat_form.changed,
    )
    high: bpy.props.FloatProperty(
        name="To",
        description="Value of the last colour, in scene units",
        default=1.0,
        precision=3,
        update=heat_form.changed,
    )


def meshes(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the mesh objects that are to be shown: the selected ones, else the active one."""
    found = [item for item in context.selected_objects if item.type == "MESH"]
    active = context.active_object
    return found or ([active] if active is not None and active.type == "MESH" else [])


def shown(item: bpy.types.Object | None) -> dict[str, Any] | None:
    """Return what an object shows as a heat map: quantity, low, high, least, most, map; None for nothing."""
    if item is None or item.type != "MESH" or COLOURS not in item.data.color_attributes:
        return None
    note = item.data.get(COLOURS)
    return None if note is None else dict(note)


def paint(item: bpy.types.Object, key: str, values: Array, low: float, high: float, name: str) -> None:
    """Write the colours of values, by vertex or by polygon, and the note of what they show."""
    from ..femors_addon.colours import linear, painted

    mesh = item.data
    colours = np.ones((len(values), 4), dtype=np.float32)
    colours[:, :3] = linear(painted(values, low, high, name))
    domain = "POINT"
    if len(values) != len(mesh.vertices) or (key in FACE_KEYS and not deck_store.is_part(item)):
        domain = "CORNER"
        colours = np.repeat(colours, scene.polygons(mesh)[0], axis=0)
    if BEFORE not in mesh:
        active = mesh.color_attributes.active_color
        mesh[BEFORE] = active.name if active is not None and active.name != COLOURS else ""
    layer = mesh.color_attributes.get(COLOURS)
    if layer is not None and layer.domain != domain:
        mesh.color_attributes.remove(layer)
        layer = None
    if layer is None:
        layer = mesh.color_attributes.new(COLOURS, "FLOAT_COLOR", domain)
    layer.data.foreach_set("color", colours.ravel())
    mesh.color_attributes.active_color = layer
    note = {"low": low, "high": high, "least": np.nanmin(values), "most": np.nanmax(values)}
    mesh[COLOURS] = {"quantity": key, **{end: float(value) for end, value in note.items()}, "map": name}
    mesh.update()


FACE_KEYS = ("aspect", "skewness", "scaled_jacobian")


def unpaint(item: bpy.types.Object) -> None:
    """Take colours and notes from a mesh, and make the colours from before active again."""
    mesh = item.data
    layer = mesh.color_attributes.get(COLOURS)
    if layer is not None:
        mesh.color_attributes.remove(layer)
    before = mesh.color_attributes.get(mesh.get(BEFORE, ""))
    if before is not None:
        mesh.color_attributes.active_color = before
    for note in (COLOURS, BEFORE):
        if note in mesh:
            del mesh[note]
    mesh.update()


def show(context: bpy.types.Context, items: list[bpy.types.Object]) -> tuple[float, float]:
    """Paint objects with what the form asks for, in one range for all; return the range."""
    from ..femors_addon.colours import DIVERGING, span
    from ..femors_addon.quantities import QUANTITIES

    form = context.scene.femors_heat
    key = form.quantity
    for item in items:
        if item.data.library is not None or item.data.override_library is not None:
            raise FemorsError(f"'{item.name}' is linked from another file: make it local to colour it")
        if not len(item.data.polygons):
            raise FemorsError(f"'{item.name}' has no faces to be coloured")
    values = [values_of(item, key, form.other) for item in items]
    signed = QUANTITIES[key].signed
    length = QUANTITIES[key].unit == "length"
    least = ROUNDING * max(max(item.dimensions) for item in items) if length else ROUNDING
    low, high = span(np.concatenate(values), signed, least) if form.automatic else (form.low, form.high)
    if not high > low:
        raise FemorsError(f"The range ends at {high:g} and begins at {low:g}: make To larger than From")
    for item, one in zip(items, values, strict=True):
        paint(item, key, one, low, high, DIVERGING if signed else colour_map(context))
    return low, high


def repaint(context: bpy.types.Context) -> None:
    """Paint anew, in the form's quantity and range, what is shown; leave it where that cannot be."""
    items = [item for item in context.scene.objects if shown(item) is not None]
    if items:
        try:
            show(context, items)
        except FemorsError:
            return
        redraw(context)


def colour_map(context: bpy.types.Context) -> str:
    """Return the colour map that the preferences name."""
    addon = context.preferences.addons.get(__package__.rpartition(".")[0])
    return getattr(addon.preferences if addon else None, "colour_map", "lagoon")


class FEMORS_OT_show_heat(bpy.types.Operator):
    """Colour the selected meshes by a quantity and show a legend; the mesh itself stays as it is"""

    bl_idname = "femors.show_heat"
    bl_label = "Show Heat Map"
    bl_options: ClassVar[set[str]] = {"UNDO"}

    quantity: bpy.props.EnumProperty(
        name="Quantity", description="What the colours show", items=CHOICES, options={"SKIP_SAVE"}
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A mesh must be selected, in Object Mode."""
        message = dependencies.missing()
        if context.mode != "OBJECT":
            message = "Leave Edit Mode or painting first: heat maps are shown in Object Mode"
        elif not meshes(context):
            message = "Select a mesh"
        if message:
            cls.poll_message_set(message)
        return not message

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Paint, shade, and say the range."""
        form = context.scene.femors_heat
        if self.properties.is_property_set("quantity"):
            form.quantity = self.quantity
        items = list({item.data: item for item in meshes(context)}.values())
        try:
            dependencies.require()
            low, high = show(context, items)
        except FemorsError as error:
            self.report({"ERROR"}, " ".join(str(error).split()))
            return {"CANCELLED"}
        shade(context)
        redraw(context)
        name = form.bl_rna.properties["quantity"].enum_items[form.quantity].name
        self.report(
            {"INFO"},
            f"{name} of {counted(len(items), 'mesh', 'meshes')}, colours from {low:.3g} to {high:.3g}",
        )
        return {"FINISHED"}


class FEMORS_OT_hide_heat(bpy.types.Operator):
    """Take the colours away and give the viewport the shading that it had"""

    bl_idname = "femors.hide_heat"
    bl_label = "Hide Heat Map"
    bl_options: ClassVar[set[str]] = {"UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Something must be shown."""
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave Edit Mode or painting first")
            return False
        if any(shown(item) is not None for item in context.scene.objects):
            return True
        if any(SHADING in screen for screen in bpy.data.screens):
            return True
        cls.poll_message_set("No heat map is shown")
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Undo what `show_heat` has done."""
        for item in bpy.data.objects:
            if shown(item) is not None and item.data.library is None:
                unpaint(item)
        unshade()
        redraw(context)
        return {"FINISHED"}


classes = (FEMORS_PG_heat, FEMORS_OT_show_heat, FEMORS_OT_hide_heat)


def register() -> None:
    """Register the operators and hang the form on scenes."""
    for cls in classes:
        bpy.utils.register_class(cls)
    bpy.types.Scene.femors_heat = bpy.props.PointerProperty(type=FEMORS_PG_heat)
    heat_form.Listener.repaint = repaint


def unregister() -> None:
    """Take everything back; what is shown stays coloured."""
    heat_form.Listener.repaint = None
    del bpy.types.Scene.femors_heat
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
