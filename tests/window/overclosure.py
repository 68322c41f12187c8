# SPDX-License-Identifier: GPL-3.0-or-later
"""The story in a window, overclosures: found, clicked, removed, cancelled, undone."""

from __future__ import annotations

from typing import Any

import bpy
import hands
from hands import (
    Steps,
    away,
    call,
    check,
    click,
    job,
    only,
    pause,
    quiet,
    seen,
    select,
    shot,
    started,
    view,
    wait,
)

NAMES = ("Ball", "Cup", "Ring")
PLACES = ((0.0, 0.0, 0.0), (1.7, 0.1, 0.0), (0.0, 9.0, 0.0))


def overclosures() -> Steps:
    """Check, click a pair, remove; with Esc, undo, redo and an edit meanwhile."""
    space = view()["area"].spaces.active
    space.clip_start, space.clip_end = 0.01, 1000.0
    make()
    check(gap(), "the buttons must be disabled while nothing is selected")
    select(*NAMES)
    call(bpy.ops.ed.undo_push, message="select")
    check(not gap(), "the buttons must be enabled for what is selected")
    hands.frame()
    yield from only("overclosure")
    yield from shot("60_bodies")
    yield from checked()
    yield from cancelled()
    yield from removed()
    yield from excluded()
    yield from edited()
    yield from only()


def make() -> None:
    """Two balls that overlap, fine enough to watch them being parted, and one far away."""
    for name, place in zip(NAMES, PLACES, strict=True):
        bpy.ops.mesh.primitive_uv_sphere_add(segments=320, ring_count=160, location=place)
        bpy.context.object.name = name
        bpy.context.object.select_set(False)


def gap() -> str:
    """What the panel says is missing."""
    with bpy.context.temp_override(**view()):
        return hands.module("operators.overclosure").gap(bpy.context)


def form() -> Any:
    """The panel's form, anew: undo makes all of the scene anew."""
    return bpy.context.scene.femors_overclosure


def remove() -> Steps:
    """Press the right one of the two large buttons."""
    yield from click(where=0.75)
    yield from started()


def keys() -> list[str]:
    """Return the names of the bodies that have shape keys."""
    return [name for name in NAMES if bpy.data.objects[name].data.shape_keys is not None]


def checked() -> Steps:
    """Check; then a click on the pair selects and frames both of its objects."""
    yield from click(where=0.25)
    yield from wait("the check", lambda: quiet() and len(form().pairs))
    check([(p.one, p.two, p.state) for p in form().pairs] == [("Ball", "Cup", "overlap")], "pairs")
    check([row.item.name for row in form().bodies] == sorted(NAMES), "the list of bodies")
    region = view()["area"].spaces.active.region_3d
    before = region.view_location.copy()
    form().pair_index = 0
    yield from wait("a click on the pair to frame it", lambda: (region.view_location - before).length > 0.1)
    yield from pause(0.5)
    chosen = sorted(item.name for item in bpy.context.view_layer.objects if item.select_get())
    check(chosen == ["Ball", "Cup"], f"a click on the pair selected {chosen}")
    yield from shot("61_checked")


def cancelled() -> Steps:
    """Esc ends a removal, and nothing has changed."""
    yield from remove()
    yield from shot("62_running")
    check(job() is not None and job().alive, "it ended before it could be cancelled")
    hands.press("Escape")
    yield from wait("Esc to end the removal", quiet)
    check(not keys(), "a cancelled removal changed the scene")


def removed() -> Steps:
    """Run to the end; one undo takes all of it back, one redo brings it again."""
    yield from remove()
    yield from wait("the removal", quiet)
    check(keys() == ["Ball", "Cup"], f"shape keys on {keys()}")
    check("CERTIFIED" in seen["reports"][-1], f"the report says: {seen['reports'][-1]}")
    check([pair.state for pair in form().pairs] == ["clear"], "the table was not brought up to date")
    yield from shot("63_removed")
    call(bpy.ops.ed.undo)
    yield from pause(0.2)
    check(not keys(), "undo left shape keys")
    call(bpy.ops.ed.redo)
    yield from pause(0.2)
    check(keys() == ["Ball", "Cup"], "redo did not bring the result back")
    yield from gap_map()
    call(bpy.ops.ed.undo)
    yield from pause(0.2)
    while keys():
        call(bpy.ops.ed.undo)
        yield from pause(0.2)


def gap_map() -> Steps:
    """The signed gap between the two as colours."""
    heat = bpy.context.scene.femors_heat
    select("Cup")
    bpy.data.objects["Ball"].hide_set(True)
    heat.quantity, heat.other = "gap", bpy.data.objects["Ball"]
    yield from only("heat")
    with bpy.context.temp_override(**hands.viewport()):
        bpy.ops.view3d.view_axis(type="LEFT")  # on what has given way
    cup = bpy.data.objects["Cup"]
    yield from click(until=lambda: "femors_heat" in cup.data.color_attributes)
    yield from shot("64_gap")
    bpy.data.objects["Ball"].hide_set(False)
    check(call(bpy.ops.femors.hide_heat) == {"FINISHED"}, "no way back")
    yield from only("overclosure")


def excluded() -> Steps:
    """A pair that was unticked in the table is left alone by the button."""
    form().pairs[0].exclude = True
    yield from remove()
    yield from wait("the removal", quiet)
    check(not keys(), "an excluded pair was parted")
    check([(pair.exclude, pair.state) for pair in form().pairs] == [(True, "excluded")], "the row")
    form().pairs[0].exclude = False


def edited() -> Steps:
    """Move a body while the removal runs: nothing is written."""
    yield from remove()
    bpy.data.objects["Cup"].location.z += 0.5
    yield from wait("the end", quiet)
    check(not keys(), "a result was written over an edited scene")
    said = seen["reports"][-1]
    check("'Cup' was edited or moved" in said, f"the report says: {said}")
    yield from away()
