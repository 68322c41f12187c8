# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator `femors.transfer`: vertex groups onto a target's mesh, and objects carried by a field.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

from typing import Any, ClassVar

import bpy

from ..femors_addon.progress import FemorsError
from ..femors_addon.settings import check, specs
from ..femors_addon.transfer_settings import TransferSettings
from . import (
    carried,
    deck_morph,
    deck_store,
    dependencies,
    field_operators,
    fields,
    marks,
    result,
    scene,
    transfer_props,
    transfer_work,
    transfer_write,
)
from .form import exact
from .job import Compute, JobOperator
from .lazy import np
from .props import ARGUMENT, add_properties, setting_properties
from .transfer_props import OPTIONS, transfer_options

KEY_PREFIX = "Carried by "
MOST = 4
"""Objects of which each is reported with its figures."""


def named(text: str) -> list[str]:
    """Return names that stand in one string, with semicolons between."""
    return [name.strip() for name in text.split(";") if name.strip()]


@add_properties(setting_properties(TransferSettings, flags=ARGUMENT), transfer_options(ARGUMENT))
class FEMORS_OT_transfer(JobOperator, bpy.types.Operator):
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
    def poll(cls, context: bpy.types.Context) -> bool:
        """Say in words what is missing."""
        if JobOperator.current is not None:
            message = "A FEMORS job is running: wait or cancel it"
        elif context.mode != "OBJECT":
            message = "Leave Edit Mode or painting first: the transfer works in Object Mode"
        elif not fields.all_fields():
            message = "Morph first: a field is what a morph keeps"
        else:
            message = dependencies.missing()
        if message:
            cls.poll_message_set(message)
        return not message

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
            return self._prepare_groups(context, text, settings)
        return self._prepare_objects(context, text, settings)

    def _prepare_groups(
        self, context: bpy.types.Context, text: bpy.types.Text, settings: TransferSettings
    ) -> Compute:
        if not (self.use_groups or self.use_empties):
            raise FemorsError("Nothing is to be made: tick groups on the target, or empties at landmarks")
        target = scene.find(self.target or self._head.get("target", ""), "target")
        result.check_groups(target)
        self._target = scene.snapshot(context, target)
        source = scene.find(self.source or self._head.get("source", ""), "source")
        if source == target:
            raise FemorsError(f"Source and target are the same object, '{source.name}': choose two")
        self._empty: list[str] = []
        templates = [self._template(context, text, source)]
        self._passed: list[str] = []
        if self.use_templates:
            templates += self._others(context, text, source)
        aim = deck_morph.surface_of(target, self._target)
        if len(aim.vertices) != len(self._target.vertices):  # keep the numbers of the object's own vertices
            from ..femors_addon.mesh import Surface

            aim = Surface(self._target.vertices, self._target.triangles)
        project, name = self.project, target.name
        return lambda progress: transfer_work.groups(templates, aim, name, settings, project, progress)

    def _others(
        self, context: bpy.types.Context, text: bpy.types.Text, source: bpy.types.Object
    ) -> list[transfer_work.Template]:
        """The newest field of every other source to the same target; a source that is gone is noted."""
        out, seen = [], {source.name}
        for other in fields.all_fields():
            head = fields.head_of(other)
            name = head.get("source", "")
            if other == text or name in seen or head.get("target") != self._head.get("target"):
                continue
            seen.add(name)
            item = bpy.data.objects.get(name)
            if item is None or not item.users_scene:
                self._passed.append(f"'{name}' of the field '{other.name}' is gone and was passed over")
            else:
                out.append(self._template(context, other, scene.find(name, "source")))
        return out

    def _template(
        self, context: bpy.types.Context, text: bpy.types.Text, source: bpy.types.Object
    ) -> transfer_work.Template:
        shot = scene.snapshot(context, source)
        wanted = named(self.groups)
        missing = [name for name in wanted if name not in source.vertex_groups]
        if missing:
            raise FemorsError(f"'{source.name}' has no vertex group named '{missing[0]}'")
        weights = scene.all_group_weights(source)
        chosen = {name: w for name, w in weights.items() if not wanted or name in wanted}
        self._empty += [name for name, w in chosen.items() if not (w > 0).any()]
        chosen = {name: w for name, w in chosen.items() if (w > 0).any()}
        if not chosen:
            words = f"'{self._empty[0]}' is empty" if self._empty else "there are none"
            raise FemorsError(
                f"'{source.name}' has no vertex group to carry ({words}): assign vertices to one first"
            )
        return transfer_work.Template(
            text.name, fields.data_of(text), source.name, shot.vertices, shot.triangles, chosen
        )

    def _prepare_objects(
        self, context: bpy.types.Context, text: bpy.types.Text, settings: TransferSettings
    ) -> Compute:
        names = named(self.objects)
        items = [_object(name) for name in names] if names else list(context.selected_objects)
        if not items:
            raise FemorsError("No object to carry: select some, or pass objects='<name>; <name>'")
        onto = None
        if self.project:
            target = scene.find(self.target or self._head.get("target", ""), "target")
            self._target = scene.snapshot(context, target)
            onto = (target.name, deck_morph.surface_of(target, self._target))
        self._before, things = [], []
        depsgraph = context.evaluated_depsgraph_get()
        for item in items:
            if self.result == "SHAPE_KEY":
                if item.type != "MESH":
                    raise FemorsError(f"'{item.name}' is no mesh and has no shape keys: choose Copies")
                result.check_writable(item, "SHAPE_KEY", False)
            matrix = scene.world_matrix(item, depsgraph)
            points = carried.points_of(item, matrix)
            part = None
            if deck_store.is_part(item):
                part = deck_morph.source_of(item, scene.snapshot(context, item))
            mark = marks.name_of(item) if item.type == "EMPTY" else ""
            things.append(transfer_work.Thing(item.name, points, part, mark))
            self._before.append((item.name, matrix, points))
        data, name = fields.data_of(text), text.name
        return lambda progress: transfer_work.things(data, name, things, settings, onto, progress)

    # --- write --------------------------------------------------------------------------------
    def apply(self, context: bpy.types.Context, got: Any) -> tuple[str, str]:
        """Write what was carried; what can be refused is refused first."""
        if self._target is not None:
            scene.unchanged(context, self._target)
        return (
            self._apply_groups(context, got) if self.what == "GROUPS" else self._apply_objects(context, got)
        )

    def _apply_groups(self, context: bpy.types.Context, got: Any) -> tuple[str, str]:
        target = scene.unchanged(context, self._target)
        result.check_groups(target)
        weights = {name: region.weights for name, region in got.regions.items()}
        if got.marks is not None:
            for name, vertex in zip(got.marks.names, got.nearest, strict=True):
                weights[name] = np.zeros(len(self._target.vertices))
                weights[name][vertex] = got.weights[name]
        made = transfer_write.groups(target, weights) if self.use_groups else []
        if self.use_empties and got.marks is not None:
            title = f"{self._field} landmarks"
            marks.add(context, title, got.marks.names, got.marks.points, got.marks.columns(), again=True)
        if got.marks is not None:
            transfer_write.table(context.scene.femors_transfer, self._field, got.marks)
        level, line = self._groups_line(target, got, made)
        regions = dict(zip(weights, made, strict=False)) if made else {}
        transfer_write.report(
            context.scene.femors_transfer,
            got.report,
            field=self._field,
            source=self.source or self._head.get("source"),
            target=target.name,
            groups={name: regions.get(name) for name in got.regions},
            carried={},
        )
        return level, line

    def _groups_line(self, target: bpy.types.Object, got: Any, made: list[str]) -> tuple[str, str]:
        parts, faults = [], list(got.notes)
        if got.marks is not None:
            residual = float(np.nanmax(got.marks.residual))
            parts.append(
                f"{marks.counted(len(got.marks.names))} (nearest vertex up to {got.missed.max():.3g} away, "
                f"residual up to {residual:.3g})"
            )
        for name, region in got.regions.items():
            words = f"region '{name}': area {region.area:.4g}"
            if np.isfinite(region.area_error):
                words += (
                    f" ({region.area_error:+.1%} of the carried), centroid off by {region.centroid_error:.3g}"
                )
            parts.append(words)
        faults += self._passed
        faults += [f"the group '{name}' is empty and was passed over" for name in self._empty]
        renamed = [
            name for name in made if name not in (*got.regions, *(got.marks.names if got.marks else ()))
        ]
        if renamed:
            faults.append(f"names were taken on the target: {', '.join(renamed)}")
        line = f"'{target.name}' by '{self._field}': " + "; ".join([*parts, *faults])
        return ("WARNING" if faults else "INFO"), line

    def _apply_objects(self, context: bpy.types.Context, got: Any) -> tuple[str, str]:
        made: list[bpy.types.Object] = []
        lines, faults = [], []
        items = [_same(context, *before) for before in self._before]
        prediction = got.marks
        try:
            for item, (_, matrix, _), (moved, known) in zip(items, self._before, got.moved, strict=True):
                if self.result == "SHAPE_KEY":
                    inverse = np.linalg.inv(matrix)
                    local = moved.points @ inverse[:3, :3].T + inverse[:3, 3]
                    result.shape_key(item, local, {}, self._field, KEY_PREFIX)
                    after = item
                else:
                    after = carried.copy_of(context, item, f"{item.name} carried", moved.points, matrix)
                    made.append(after)
                if known is not None:
                    deck_morph.remember_nodes(after, known, self.result)
                lines.append(f"'{after.name}': {moved.summary()}")
                faults += [f"'{item.name}': {words}" for words in (*moved.notes, *moved.faults)]
        except Exception:
            for item in made:
                carried.remove(item, item.data)
            raise
        faults += got.notes
        if prediction is not None:
            copies = [after for after in made if after.type == "EMPTY"]
            for after, name in zip(copies, prediction.names, strict=True):
                marks.note(
                    after, name, {key: v[copies.index(after)] for key, v in prediction.columns().items()}
                )
            transfer_write.table(context.scene.femors_transfer, self._field, prediction)
        after = [item.name for item in (made or items)]
        pairs = dict(zip([name for name, _, _ in self._before], after, strict=True))
        onto = None if self._target is None else self._target.name
        transfer_write.report(
            context.scene.femors_transfer, got.report, field=self._field, target=onto, carried=pairs
        )
        if len(items) > MOST:
            lines = [f"{len(items)} objects carried by '{self._field}'"]
        if made:
            for item in context.selected_objects:
                item.select_set(False)
            for item in made:
                if item.name in context.view_layer.objects:
                    item.select_set(True)
        return ("WARNING" if faults else "INFO"), "; ".join([*lines, *faults])


def _object(name: str) -> bpy.types.Object:
    found = bpy.data.objects.get((name, None)) or bpy.data.objects.get(name)
    if found is None or not found.users_scene:
        raise FemorsError(f"There is no object named '{name}' to be carried")
    return found


def _same(context: bpy.types.Context, name: str, matrix: Any, points: Any) -> bpy.types.Object:
    """Return an object, as it was when the job began."""
    item = bpy.data.objects.get(name)
    if item is None or not item.users_scene:
        raise FemorsError(f"'{name}' was deleted or renamed while the job ran: nothing was changed")
    now = scene.world_matrix(item, context.evaluated_depsgraph_get())
    if not np.array_equal(now, matrix) or not np.array_equal(carried.points_of(item, now), points):
        raise FemorsError(
            f"'{name}' was edited or moved while the job ran: nothing was changed, run it again"
        )
    return item


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
