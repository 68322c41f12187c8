# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators `femors.quality` and `femors.select_bad_faces`.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

import json
from typing import Any, ClassVar

import bpy

from ..femors_addon.progress import FemorsError, counted
from . import deck_scene, deck_store, dependencies, heat_values, scene
from .job import Compute, JobOperator
from .lazy import Array, np

BAD = "femors_bad"
"""Face attribute: whether the face has a fault."""


def chosen(context: bpy.types.Context) -> tuple[bpy.types.Object | None, bpy.types.Object | None]:
    """Return the mesh to be measured, that of the picker or the active one, and the one beside it."""
    form = context.scene.femors_heat
    mesh, other = (item if item and item.users_scene else None for item in (form.mesh, form.other))
    active = context.active_object
    if mesh is None and active is not None and active.type == "MESH":
        mesh = active
    return mesh, other


class FEMORS_OT_quality(JobOperator, bpy.types.Operator):
    """Measure a mesh: shapes of faces and elements, faults, volume, and its distance from another mesh"""

    bl_idname = "femors.quality"
    bl_label = "Measure Quality"
    bl_options: ClassVar[set[str]] = {"UNDO"}
    title = "Quality"
    core = ("examine", "volume_quality")

    mesh: bpy.props.StringProperty(
        name="Mesh", description="Name of the object to measure", options={"SKIP_SAVE"}
    )
    other: bpy.props.StringProperty(
        name="Compare with", description="Name of the object to compare it with", options={"SKIP_SAVE"}
    )
    worst_aspect: bpy.props.FloatProperty(
        name="Worst Aspect Ratio",
        description="Faces with a larger ratio of longest to shortest side count as bad",
        default=10.0,
        min=1.0,
        options={"SKIP_SAVE"},
    )

    @classmethod
    def missing(cls, context: bpy.types.Context) -> str:
        """Say in words what is missing; the form counts only for the button that is drawn with it."""
        if context.mode != "OBJECT":
            return "Leave Edit Mode or painting first: quality is measured in Object Mode"
        if hasattr(context, "femors_form") and chosen(context)[0] is None:
            return dependencies.missing() or "Choose a mesh, or make one active"
        return dependencies.missing()

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Take from the form what the caller has not set."""
        for name, item in zip(("mesh", "other"), chosen(context), strict=True):
            if not self.properties.is_property_set(name) and item is not None:
                setattr(self, name, item.name)
        return self.run_modal(context)

    def prepare(self, context: bpy.types.Context) -> Compute:
        """Read the meshes."""
        dependencies.require()
        from ..femors_addon.examine import examine

        item = scene.find(self.mesh, "mesh")
        self._shot = scene.snapshot(context, item)
        surface, self._polygon = heat_values.surface_of(item)
        surface = _used(surface)
        other = None
        if self.other:
            beside = scene.find(self.other, "mesh to compare with")
            if beside == item:
                raise FemorsError(f"'{item.name}' cannot be compared with itself: choose another")
            scene.snapshot(context, beside)  # refuses what is no surface
            other = _used(heat_values.surface_of(beside)[0])
        model, limit = _model_of(item), self.worst_aspect

        def compute(progress: Any) -> Any:
            return examine(surface, other, model(), limit, progress)

        return compute

    def apply(self, context: bpy.types.Context, found: Any) -> tuple[str, str]:
        """Keep the figures with the object and mark its bad faces."""
        item = scene.unchanged(context, self._shot)
        local = item.library is None and item.data.library is None and item.data.override_library is None
        if local:
            marked = np.zeros(len(item.data.polygons), dtype=bool)
            marked[self._polygon[found.bad]] = True
            attribute = item.data.attributes.get(BAD)
            if attribute is not None and (attribute.data_type, attribute.domain) != ("BOOLEAN", "FACE"):
                item.data.attributes.remove(attribute)
                attribute = None
            if attribute is None:
                attribute = item.data.attributes.new(BAD, "BOOLEAN", "FACE")
            attribute.data.foreach_set("value", marked)
        report = {"mesh_name": self.mesh, "other_name": self.other, **found.as_dict()}
        if item.library is None:
            item.femors.quality = json.dumps(report)
        faults = [f"{number} {name.replace('_', '-')}" for name, number in report["faults"].items() if number]
        if found.elements is not None and found.elements.inverted:
            faults.append(counted(found.elements.inverted, "inverted element"))
        line = f"'{item.name}': aspect ratio {found.aspect}; {', '.join(faults) or 'no faults'}"
        if not local:
            line += "; linked from another file, so its bad faces are not marked"
        return ("WARNING" if faults else "INFO"), line


def _used(surface: Any) -> Any:
    """Return a surface without the vertices that no face uses, such as the nodes inside a model."""
    from ..femors_addon.mesh import Surface

    used, faces = np.unique(surface.faces, return_inverse=True)
    return Surface(surface.vertices[used], faces.reshape(-1, 3))


def _model_of(item: bpy.types.Object) -> Any:
    """Return a function, for the worker, that gives the figures of an FE part's elements, or None."""
    if not deck_store.is_part(item):
        return lambda: None
    archive, shot = deck_store.archive_of(item), deck_scene.shot(item)

    def figures() -> Any:
        from ..femors_addon.volume_quality import VolumeQuality

        deck = deck_store.unpacked(archive)
        part = shot.of(deck)
        coordinates = np.array(deck.coordinates)
        coordinates[part.nodes] = shot.nodes(deck)
        mesh, _ = deck.with_coordinates(coordinates).submesh(part)
        return VolumeQuality.of(mesh) if mesh.solid else None

    return figures


class FEMORS_OT_select_bad_faces(bpy.types.Operator):
    """Enter Edit Mode with the bad faces selected: crossing, folded, without area, or too slender"""

    bl_idname = "femors.select_bad_faces"
    bl_label = "Select Bad Faces"
    bl_options: ClassVar[set[str]] = {"UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The mesh must have been measured."""
        mesh, _ = chosen(context)
        message = ""
        if context.mode != "OBJECT":
            message = "Leave Edit Mode or painting first"
        elif mesh is None or BAD not in mesh.data.attributes:
            message = "Measure the quality of a mesh first"
        elif not mesh.visible_get():
            message = "The mesh is hidden: show it first (Alt+H)"
        if message:
            cls.poll_message_set(message)
        return not message

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Select, and go where a selection of faces is seen."""
        item, _ = chosen(context)
        mesh = item.data
        attribute = mesh.attributes[BAD]
        bad = np.zeros(len(mesh.polygons), dtype=bool)
        if len(attribute.data) != len(bad):
            self.report({"ERROR"}, f"'{item.name}' has changed: measure its quality again")
            return {"CANCELLED"}
        attribute.data.foreach_get("value", bad)
        if not bad.any():
            self.report({"INFO"}, f"'{item.name}' has no bad faces")
            return {"CANCELLED"}
        for other in context.selected_objects:
            other.select_set(False)
        item.select_set(True)
        context.view_layer.objects.active = item
        sizes, corners = scene.polygons(mesh)
        vertices = np.zeros(len(mesh.vertices), dtype=bool)
        vertices[corners[np.repeat(bad, sizes)]] = True
        _select(mesh, ".select_vert", "POINT", vertices)
        _select(mesh, ".select_poly", "FACE", bad)
        context.tool_settings.mesh_select_mode = (False, False, True)
        bpy.ops.object.mode_set(mode="EDIT")
        self.report({"INFO"}, f"{counted(int(bad.sum()), 'bad face')} of '{item.name}' selected")
        return {"FINISHED"}


def _select(mesh: bpy.types.Mesh, name: str, domain: str, chosen: Array) -> None:
    """Write a selection as the attribute that it is; edges follow the faces in Edit Mode.

    Setting the edges' own ``select`` crashes Blender 5.0.1.
    """
    attribute = mesh.attributes.get(name) or mesh.attributes.new(name, "BOOLEAN", domain)
    attribute.data.foreach_set("value", chosen.tolist())


classes = (FEMORS_OT_quality, FEMORS_OT_select_bad_faces)
