# SPDX-License-Identifier: GPL-3.0-or-later
"""The transfer's half for landmarks and regions: vertex groups of sources onto a target's mesh."""

from __future__ import annotations

from typing import Any

import bpy

from ..femors_addon.progress import FemorsError, counted
from ..femors_addon.transfer_settings import TransferSettings
from . import deck_morph, fields, marks, result, scene, transfer_props, transfer_work, transfer_write
from .job import Compute
from .lazy import np


class GroupsTransfer:
    """Mix-in of the operator: reads and writes where *Vertex Groups* are carried."""

    def prepare_groups(
        self, context: bpy.types.Context, text: bpy.types.Text, settings: TransferSettings
    ) -> Compute:
        """Read target and templates; return the work as a function of progress."""
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
        wanted = transfer_props.named(self.groups)
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

    def apply_groups(self, context: bpy.types.Context, got: Any) -> tuple[str, str]:
        """Write the groups, the empties and the table; return a report level and one line."""
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
                f"{counted(len(got.marks.names), 'landmark')} (nearest vertex up to "
                f"{got.missed.max():.3g} away, residual up to {residual:.3g})"
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
