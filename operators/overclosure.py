# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators `femors.check_overclosure` and `femors.remove_overclosure`.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

import json
from collections.abc import Iterable
from typing import Any, ClassVar

import bpy

from ..femors_addon.overclosure_settings import OverclosureSettings
from ..femors_addon.progress import FemorsError, counted
from ..femors_addon.settings import check, specs
from . import bodies, bodies_write, body_names, dependencies, overclosure_props, overclosure_work
from .form import exact, given_settings
from .job import Compute, JobOperator
from .overclosure_props import body_arguments, result_property
from .props import ARGUMENT, add_properties, setting_properties

EXCLUDED, FAR = "excluded", "apart"
"""States of pairs in the table, beside those of the core."""


def gap(context: bpy.types.Context) -> str:
    """Return what is missing for the panel's buttons, in words, or ""."""
    form = context.scene.femors_overclosure
    if form.bodies_from == "COLLECTION" and form.collection is None:
        return "Choose the collection that holds the bodies"
    count = len(bodies.chosen(context))
    if form.bodies_from == "COLLECTION":
        held = counted(count, "mesh", "meshes")
        return "" if count > 1 else f"The collection holds {held}: at least two are needed"
    return "" if count > 1 else f"Select the bodies: two meshes or more (so far {count})"


def _numbers() -> dict[str, Any]:
    """Return the settings as arguments; a gap below 0 is refused in words, not made 0 by Blender."""
    made = setting_properties(OverclosureSettings, flags=ARGUMENT)
    field, spec = specs(OverclosureSettings)["gap"]
    made["gap"] = bpy.props.FloatProperty(
        name=spec.label, description=spec.help, default=field.default, precision=3, options=set(ARGUMENT)
    )
    return made


class BodiesOperator(JobOperator):
    """What check and removal share: which bodies, which pairs, how far apart."""

    core = ("overclosure", "volume_quality")

    @classmethod
    def missing(cls, context: bpy.types.Context) -> str:
        """Say in words what is missing; the form counts only for the button that is drawn with it."""
        if context.mode != "OBJECT":
            return "Leave Edit Mode or painting first: this works in Object Mode"
        return dependencies.missing() or (gap(context) if hasattr(context, "femors_form") else "")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Take from the form what the caller has not set, and start in the background."""
        form = context.scene.femors_overclosure
        items = bodies.chosen(context)
        if form.bodies_from == "SELECTION" and not form.bodies:
            fill_bodies(form, items)  # a click on a pair selects others, the list stays
        names = {item.name for item in items}
        pairs = [pair for pair in form.pairs if {pair.one, pair.two} <= names]
        values = {name: getattr(form, name) for name in (*specs(OverclosureSettings), "result")}
        values["bodies"] = body_names.joined(item.name for item in items)
        values["exclude"] = body_names.text_of_pairs((p.one, p.two) for p in pairs if p.exclude)
        values["gaps"] = body_names.text_of_gaps(
            {(p.one, p.two): exact(p.gap) for p in pairs if p.own_gap and not p.exclude}
        )
        for name, value in values.items():
            if name in self.properties.bl_rna.properties and not self.properties.is_property_set(name):
                setattr(self, name, value)
        return self.run_modal(context)

    def read(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        """Read the bodies into `_shots` and what is asked of them into `_ask`; return their objects."""
        dependencies.require()
        settings = given_settings(self.properties, OverclosureSettings())
        check(settings)
        items = bodies.found(context, self.bodies, self.collection)
        names = [item.name for item in items]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise FemorsError(f"'{twice}' is named twice: every body counts once")
        shares = bodies.shares(items, self.rigid, self.shares)
        self._ask = overclosure_work.Ask(
            settings,
            tuple(body_names.pairs(self.exclude, names, "Exclude")),
            body_names.pair_numbers(self.gaps, names, "Gaps"),
        )
        self._shots = [bodies.shot(context, item, share) for item, share in zip(items, shares, strict=True)]
        self._notes = [
            f"the modifiers of '{item.name}' do not count"
            for item in items
            if any(modifier.show_viewport for modifier in item.modifiers)
        ]
        return items

    def unchanged(self, context: bpy.types.Context) -> dict[str, bpy.types.Object]:
        """Return the bodies' objects by name; raise `FemorsError` where one is not as it was."""
        return {shot.name: bodies.unchanged(context, shot) for shot in self._shots}


@add_properties(body_arguments(), _numbers())
class FEMORS_OT_check_overclosure(BodiesOperator, bpy.types.Operator):
    """Find the pairs of bodies that overlap or are too near; nothing is moved"""

    bl_idname = "femors.check_overclosure"
    bl_label = "Check Overclosure"
    bl_options: ClassVar[set[str]] = {"UNDO"}
    title = "Check"

    def prepare(self, context: bpy.types.Context) -> Compute:
        """Read the bodies; return the check as a function of progress."""
        self.read(context)
        shots, ask = self._shots, self._ask
        return lambda progress: overclosure_work.check(shots, ask, progress)

    def apply(self, context: bpy.types.Context, checked: Any) -> tuple[str, str]:
        """Fill the table, write the gaps."""
        items = self.unchanged(context)
        note = bodies_write.write_gaps(items, checked.gaps)
        form = context.scene.femors_overclosure
        fill_pairs(form, checked.findings, self._ask)
        pairs = [finding.as_dict() for finding in checked.findings]
        notes = [*self._notes, *checked.notes]
        form.report = json.dumps({"kind": "check", "pairs": pairs, "warnings": notes})
        bad = [finding for finding in checked.findings if not finding.clear]
        if not bad:
            line = (
                f"No overclosure: {len(items)} bodies, {counted(len(pairs), 'pair')} near each "
                "other, all clear"
            )
        else:
            words = "pair overlaps or is too near", "pairs overlap or are too near"
            line = f"{counted(len(bad), *words)}; {bad[0]}"
        return ("WARNING" if notes else "INFO"), "; ".join([line + note, *notes])


@add_properties(body_arguments(), _numbers(), result_property(ARGUMENT))
class FEMORS_OT_remove_overclosure(BodiesOperator, bpy.types.Operator):
    """Push overlapping bodies apart until a certificate says that none crosses another any more"""

    bl_idname = "femors.remove_overclosure"
    bl_label = "Remove Overclosure"
    # no REGISTER: the redo panel would run a long job again at each change
    bl_options: ClassVar[set[str]] = {"UNDO"}
    title = "Overclosure"

    def prepare(self, context: bpy.types.Context) -> Compute:
        """Read the bodies; return the removal as a function of progress."""
        items = self.read(context)
        if all(bodies.is_linked(item) for item in items):
            raise FemorsError(
                "all bodies are linked from another file, and so rigid: make one local (Object > Relations)"
            )
        for item, shot in zip(items, self._shots, strict=True):
            if shot.share:
                bodies_write.check_writable(item, self.result)
        shots, ask = self._shots, self._ask
        previews = {
            shot.seen.name: self.watch(shot.seen.vertices, shot.seen.triangles)
            for shot in shots
            if shot.share
        }
        return lambda progress: overclosure_work.remove(shots, ask, progress, previews)

    def apply(self, context: bpy.types.Context, removed: Any) -> tuple[str, str]:
        """Move the bodies, write gaps, table and figures; what can be refused is refused first."""
        items = self.unchanged(context)
        for name in removed.moved:
            bodies_write.check_writable(items[name], self.result)
        notes = [
            bodies_write.write(items[name], self.result, local, known)
            for name, (local, known) in removed.moved.items()
        ]
        notes.append(bodies_write.write_gaps(items, removed.gaps))
        form = context.scene.femors_overclosure
        fill_pairs(form, removed.result.after, self._ask, removed.result.excluded)
        report = removed.result.report()
        report["warnings"] += self._notes
        form.report = json.dumps({"kind": "removal", **report})
        return self._line(removed.result, "".join(notes))

    def _line(self, result: Any, note: str) -> tuple[str, str]:
        """Return the report's level and text."""
        moved = sum(1 for body in result.bodies if body.moved)
        line = f"{result.certificate}; {moved} of {len(result.bodies)} bodies moved{note}"
        faults = [*result.losses, *result.notes, *self._notes]
        return ("WARNING" if faults or not result.certified else "INFO"), "; ".join([line, *faults])


class FEMORS_OT_take_bodies(bpy.types.Operator):
    """Make the selected meshes the list of bodies"""

    bl_idname = "femors.take_bodies"
    bl_label = "List from Selection"
    bl_options: ClassVar[set[str]] = {"UNDO", "INTERNAL"}

    clear: bpy.props.BoolProperty(name="Clear", description="Empty the list instead", options={"SKIP_SAVE"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Fill or empty the list."""
        fill_bodies(context.scene.femors_overclosure, [] if self.clear else bodies.selected(context))
        return {"FINISHED"}


# --- into the form ----------------------------------------------------------------------------------
def fill_bodies(form: Any, items: Iterable[bpy.types.Object]) -> None:
    """Write the list of bodies."""
    form.bodies.clear()
    for item in items:
        form.bodies.add().item = item


def fill_pairs(
    form: Any, findings: Iterable[Any], ask: overclosure_work.Ask, excluded: Iterable[Any] = ()
) -> None:
    """Write the table of pairs: what was found, then pairs that were excluded or have their own gap.

    Those have the depths of `excluded`; where they are not in it, those that stood in the table before.
    """
    depths = {frozenset((row.one, row.two)): row.depth for row in form.pairs}
    depths |= {frozenset((pair.one, pair.two)): pair.depth_after for pair in excluded}
    gaps = {frozenset(pair): value for pair, value in ask.gaps.items()}
    form.pairs.clear()
    for finding in findings:
        row = form.pairs.add()
        for name in ("one", "two", "least", "crossings", "state", "where"):
            setattr(row, name, getattr(finding, name))
        row.depth = finding.depth or finding.edge_depth
        row.over = sum(finding.over)
        row.shared = -1.0 if finding.shared is None else finding.shared
    listed = {frozenset((row.one, row.two)) for row in form.pairs}
    for pair in (*ask.exclude, *ask.gaps):
        if frozenset(pair) not in listed:
            row = form.pairs.add()
            row.one, row.two = pair
            row.exclude = pair in ask.exclude
            row.state = EXCLUDED if row.exclude else FAR
            row.depth = depths.get(frozenset(pair), 0.0)
            listed.add(frozenset(pair))
    for row in form.pairs:
        own = gaps.get(frozenset((row.one, row.two)))
        row.own_gap, row.gap = own is not None, ask.settings.gap if own is None else own
    form.pair_index = -1


classes = (FEMORS_OT_check_overclosure, FEMORS_OT_remove_overclosure, FEMORS_OT_take_bodies)


def register() -> None:
    """Register the form and the operators."""
    overclosure_props.register()
    for cls in classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take them back."""
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
    overclosure_props.unregister()
