# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator `femors.morph`: snapshot, morph, apply.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

import json
from typing import Any, ClassVar

import bpy

from ..femors_addon.morph_settings import PRESETS, MorphSettings
from ..femors_addon.progress import FemorsError, counted
from ..femors_addon.settings import check, specs
from . import deck_morph, dependencies, fields, result, scene
from .form import fill_from_preset, read_settings
from .job import Compute, JobOperator
from .lazy import np
from .props import ARGUMENT, RESULT_OPTIONS, add_properties, result_properties, setting_properties

DISTANCE = "femors_surface_distance"
DISPLACEMENT = "femors_displacement"
NOTHING = 1e-9
"""Lengths below this are rounding: shown as 0."""


def chosen(context: bpy.types.Context) -> tuple[bpy.types.Object | None, bpy.types.Object | None]:
    """Return source and target: those of the panel's pickers, or of the selection if both are empty."""
    form = context.scene.femors
    # a deleted object that a picker still points at stays in the file, in no scene
    source, target = (item if item and item.users_scene else None for item in (form.source, form.target))
    return (source, target) if source or target else from_selection(context)


def gap(context: bpy.types.Context) -> str:
    """Return what is missing for the panel's button, in words, or ""."""
    source, target = chosen(context)
    if source is None:
        return "Choose the source: the mesh that is morphed"
    if target is None:
        return "Choose the target: the shape to reach"
    if source == target:
        return "Source and target are the same object: choose two"
    return ""


@add_properties(setting_properties(MorphSettings, flags=ARGUMENT), result_properties(ARGUMENT))
class FEMORS_OT_morph(JobOperator, bpy.types.Operator):
    """Give the source mesh the target's shape; the source's vertices, faces and materials stay"""

    bl_idname = "femors.morph"
    bl_label = "Morph"
    # no REGISTER: the redo panel would run a long job again at each change
    bl_options: ClassVar[set[str]] = {"UNDO"}
    title = "Morph"
    core = ("morph", "volume_morph", "deck_morph")

    source: bpy.props.StringProperty(
        name="Source", description="Name of the object to morph", options={"SKIP_SAVE"}
    )
    target: bpy.props.StringProperty(
        name="Target", description="Name of the shape to reach", options={"SKIP_SAVE"}
    )

    @classmethod
    def missing(cls, context: bpy.types.Context) -> str:
        """Say in words what is missing; the form counts only for the button that is drawn with it."""
        if context.mode != "OBJECT":
            return "Leave Edit Mode or painting first: the morph works in Object Mode"
        return dependencies.missing() or (gap(context) if hasattr(context, "femors_form") else "")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Take from the form what the caller has not set, and start in the background."""
        form = context.scene.femors
        for name, item in zip(("source", "target"), chosen(context), strict=True):
            if not self.properties.is_property_set(name) and item is not None:
                setattr(self, name, item.name)
                setattr(form, name, item)  # the result will be selected, the pair stays
        for name in (*RESULT_OPTIONS, *specs(MorphSettings)):
            if not self.properties.is_property_set(name):
                setattr(self, name, getattr(form, name))
        return self.run_modal(context)

    def prepare(self, context: bpy.types.Context) -> Compute:
        """Read source and target; return the morph as a function of progress."""
        dependencies.require()
        from ..femors_addon.mesh import Surface
        from ..femors_addon.morph import morph

        settings = read_settings(self.properties, MorphSettings, PRESETS)
        check(settings)
        source = scene.find(self.source, "source")
        target = scene.find(self.target, "target")
        if source == target:
            raise FemorsError(f"Source and target are the same object, '{source.name}': choose two")
        result.check_writable(source, self.result, self.use_evaluated)
        seen = self.use_evaluated and self.result == "NEW"
        paired = self.use_landmarks or settings.steer
        self._source = scene.snapshot(context, source, seen, self.vertex_group, paired)
        self._target = scene.snapshot(context, target, self.use_evaluated, landmarks=paired)
        pairs = scene.paired_landmarks(self._source, self._target) if paired else (None, None, None)
        landmarks = dict(zip(("source_landmarks", "target_landmarks", "landmark_names"), pairs, strict=True))
        aim = deck_morph.surface_of(target, self._target)
        part = deck_morph.source_of(source, self._source)
        preview = self.watch(self._source.vertices, self._source.triangles)
        if part is not None:
            return lambda progress: deck_morph.morph(part, aim, settings, progress, landmarks, preview)
        surface, weights = Surface(self._source.vertices, self._source.triangles), self._source.weights
        return lambda progress: morph(
            surface, aim, settings, progress, weights=weights, preview=preview, **landmarks
        )

    def apply(self, context: bpy.types.Context, morphed: Any) -> tuple[str, str]:
        """Write the shape, its figures and its attributes; what can be refused is refused first."""
        source = scene.unchanged(context, self._source)
        target = scene.unchanged(context, self._target)
        result.check_writable(source, self.result, self.use_evaluated)
        local = self._source.to_local(morphed.vertices)
        report = json.dumps({"source": self._source.name, "target": self._target.name, **morphed.report()})
        inside_out = float(np.linalg.det(morphed.transform[:3, :3])) < 0
        if inside_out and self.result == "SHAPE_KEY":
            raise FemorsError(
                f"'{source.name}' was mirrored, and a shape key cannot turn its faces, "
                "which would point inward: choose New Object or In Place"
            )
        attributes = {DISTANCE: morphed.surface_distance, DISPLACEMENT: morphed.displacement}
        item, note = source, ""
        if self.result == "NEW":
            name = f"{source.name} morphed to {self._target.name}"
            item = result.new_object(context, source, self._source, local, attributes, name, inside_out)
        elif self.result == "SHAPE_KEY":
            note = result.shape_key(source, local, attributes, self._target.name)
        else:
            note = result.in_place(source, local, attributes, inside_out)
        if isinstance(morphed, deck_morph.PartMorph):
            deck_morph.remember(item, morphed, self.result)
        item.femors.report = report
        item.femors.field = fields.keep(morphed.kept(self._source.name, self._target.name, fields.now()))
        if self.hide_target and target.visible_get():
            target.hide_set(True)
        return self._line(item, morphed, note)

    def _line(self, item: bpy.types.Object, morphed: Any, note: str) -> tuple[str, str]:
        """Return the report's level and text.

        The distance is that from the target: the other one is nothing where vertices are laid onto it.
        """
        from ..femors_addon.quality import Stat

        after, around, distance = morphed.after, "", morphed.after.target_to_surface
        if morphed.settings.partial == "source":  # much of the target then has no counterpart
            around, distance = " around it", Stat.of(morphed.residual)
        figures = (distance.median, distance.p99, distance.maximum)
        median, p99, most = (f"{x:.3g}" if abs(x) > NOTHING else "0" for x in figures)
        elements, faults = deck_morph.sentences(morphed)
        distances = f"distance from '{self._target.name}'{around}: median {median}, 99 % {p99}, max {most}"
        steered = [morphed.steering.sentence()] if morphed.steering is not None else []
        line = "; ".join([f"'{item.name}': {distances}", *elements, *steered, f"{morphed.stop_reason}{note}"])
        faults += morphed.warnings
        if not morphed.faults:  # which count faces that fold over or cross together: not once more by kind
            bad = ((after.flipped, "flipped face"), (after.self_intersecting, "self-intersecting face"))
            faults += [counted(count, words) for count, words in bad if count]
        return ("WARNING" if faults or not morphed.converged else "INFO"), "; ".join([line, *faults])


class FEMORS_OT_pick_selection(bpy.types.Operator):
    """Take the active mesh as source and the other selected mesh as target"""

    bl_idname = "femors.pick_selection"
    bl_label = "Pick from Selection"
    bl_options: ClassVar[set[str]] = {"UNDO", "INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A mesh must be active or selected."""
        if any(item.type == "MESH" for item in context.selected_objects):
            return True
        cls.poll_message_set("Select the target, then Shift-click the source")
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Fill the pickers."""
        form = context.scene.femors
        source, target = from_selection(context)
        form.source = source
        if target is not None:
            form.target = target
        if form.vertex_group and (source is None or form.vertex_group not in source.vertex_groups):
            form.vertex_group = ""
        return {"FINISHED"}


class FEMORS_OT_reset_preset(bpy.types.Operator):
    """Give all advanced settings the values of the chosen preset"""

    bl_idname = "femors.reset_preset"
    bl_label = "Reset to Preset"
    bl_options: ClassVar[set[str]] = {"UNDO", "INTERNAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Fill the form."""
        fill_from_preset(context.scene.femors, MorphSettings, PRESETS)
        return {"FINISHED"}


def from_selection(context: bpy.types.Context) -> tuple[bpy.types.Object | None, bpy.types.Object | None]:
    """Return the active mesh and the other selected mesh, where there is exactly one."""
    meshes = [item for item in context.selected_objects if item.type == "MESH"]
    active = context.active_object
    source = active if active in meshes else (meshes[0] if meshes else None)
    others = [item for item in meshes if item != source]
    return source, others[0] if len(others) == 1 else None


classes = (FEMORS_OT_morph, FEMORS_OT_pick_selection, FEMORS_OT_reset_preset)
