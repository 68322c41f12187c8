# SPDX-License-Identifier: GPL-3.0-or-later
"""The transfer's half for whole objects: copies, or shape keys, where a field takes them."""

from __future__ import annotations

from typing import Any

import bpy

from ..femors_addon.progress import FemorsError
from ..femors_addon.transfer_settings import TransferSettings
from . import (
    carried,
    deck_morph,
    deck_store,
    fields,
    marks,
    placing,
    result,
    scene,
    transfer_props,
    transfer_work,
    transfer_write,
)
from .job import Compute
from .lazy import np

KEY_PREFIX = "Carried by "
MOST = 4
"""Objects of which each is reported with its figures."""


class ObjectsTransfer:
    """Mix-in of the operator: reads and writes where *Selected Objects* are carried."""

    def prepare_objects(
        self, context: bpy.types.Context, text: bpy.types.Text, settings: TransferSettings
    ) -> Compute:
        """Read the objects; return the work as a function of progress."""
        names = transfer_props.named(self.objects)
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

    def apply_objects(self, context: bpy.types.Context, got: Any) -> tuple[str, str]:
        """Write what was carried, the table and the report; return a report level and one line."""
        form = context.scene.femors_transfer
        items = [_same(context, *before) for before in self._before]
        made, lines, faults = self._write(context, items, got)
        faults += got.notes
        if got.marks is not None:
            copies, columns = [after for after in made if after.type == "EMPTY"], got.marks.columns()
            for row, (after, name) in enumerate(zip(copies, got.marks.names, strict=True)):
                marks.note(after, name, {key: column[row] for key, column in columns.items()})
            transfer_write.table(form, self._field, got.marks)
        empties = [copy for copy in made if copy.type == "EMPTY"]
        if empties:
            marks.gathered(context, f"{self._field} landmarks", empties)
        after = [item.name for item in (made or items)]
        pairs = dict(zip([name for name, _, _ in self._before], after, strict=True))
        onto = None if self._target is None else self._target.name
        transfer_write.report(form, got.report, field=self._field, target=onto, carried=pairs)
        if len(items) > MOST:
            lines = [f"{len(items)} objects carried by '{self._field}'"]
        if made:
            _select(context, made)
        return ("WARNING" if faults else "INFO"), "; ".join([*lines, *faults])

    def _write(
        self, context: bpy.types.Context, items: list[bpy.types.Object], got: Any
    ) -> tuple[list[bpy.types.Object], list[str], list[str]]:
        """Make the copies or shape keys; return the copies, lines of figures, and faults."""
        made: list[bpy.types.Object] = []
        lines, faults = [], []
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
        return made, lines, faults


def _select(context: bpy.types.Context, made: list[bpy.types.Object]) -> None:
    for item in context.selected_objects:
        item.select_set(False)
    for item in made:
        if placing.seen(context.view_layer, item):
            item.select_set(True)


def _object(name: str) -> bpy.types.Object:
    found = bpy.data.objects.get((name, None)) or bpy.data.objects.get(name)
    if found is None or not found.users_scene:
        hint = ": semicolons stand between names" if "," in name else ""
        raise FemorsError(f"There is no object named '{name}' to be carried{hint}")
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
