# SPDX-License-Identifier: GPL-3.0-or-later
"""A part of the story in a window: overclosures found, clicked, removed, cancelled, undone."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any

import bpy

NAMES = ("Ball", "Cup", "Ring")
PLACES = ((0.0, 0.0, 0.0), (1.7, 0.1, 0.0), (0.0, 9.0, 0.0))


def steps(story: Any) -> Iterator[None]:
    """Check, click a pair, remove; with Esc, undo, redo and an edit meanwhile.

    Parameters
    ----------
    story : namespace
        The helpers of ``story.py``.
    """
    others = [item.name for item in bpy.context.view_layer.objects if not item.hide_get()]
    for name in others:  # by name: undo makes all objects anew
        bpy.data.objects[name].hide_set(True)
    make()
    story.check(gap(story), "the buttons must be disabled while nothing is selected")
    for name in NAMES:
        bpy.data.objects[name].select_set(True)
    story.check(not gap(story), "the buttons must be enabled for what is selected")
    yield from check(story)
    yield from cancelled(story)
    yield from removed(story)
    yield from excluded(story)
    yield from edited(story)
    for name in NAMES:
        bpy.data.objects.remove(bpy.data.objects[name])
    for name in others:
        bpy.data.objects[name].hide_set(False)


def make() -> None:
    """Two balls that overlap, fine enough to watch them being parted, and one far away."""
    for name, place in zip(NAMES, PLACES, strict=True):
        bpy.ops.mesh.primitive_uv_sphere_add(segments=192, ring_count=96, location=place)
        bpy.context.object.name = name
        bpy.context.object.select_set(False)


def gap(story: Any) -> str:
    """What the panel says is missing."""
    module = importlib.import_module(f"{story.PACKAGE}.operators.overclosure")
    with bpy.context.temp_override(**story.view()):
        return module.gap(bpy.context)


def form() -> Any:
    """The panel's form, anew: undo makes all of the scene anew."""
    return bpy.context.scene.femors_overclosure


def press(story: Any, operator: Any) -> Iterator[None]:
    """Press a button of the panel and wait for the first word of progress."""
    result = story.call(operator, "INVOKE_DEFAULT")
    story.check(result == {"RUNNING_MODAL"}, f"the button gave {result}")
    running = story.job()
    yield from story.wait("first progress", lambda: running.fraction > 0 or not running.alive)


def keys() -> list[str]:
    """Return the names of the bodies that have shape keys."""
    return [name for name in NAMES if bpy.data.objects[name].data.shape_keys is not None]


def check(story: Any) -> Iterator[None]:
    """Check; then a click on the pair selects and frames both of its objects."""
    yield from press(story, bpy.ops.femors.check_overclosure)
    yield from story.wait("the check", story.quiet)
    story.check([(p.one, p.two, p.state) for p in form().pairs] == [("Ball", "Cup", "overlap")], "pairs")
    story.check([row.item.name for row in form().bodies] == sorted(NAMES), "the list of bodies")
    region = story.view()["area"].spaces.active.region_3d
    before = region.view_location.copy()
    form().pair_index = 0
    yield from story.pause(1.0)
    chosen = sorted(item.name for item in bpy.context.view_layer.objects if item.select_get())
    story.check(chosen == ["Ball", "Cup"], f"a click on the pair selected {chosen}")
    story.check((region.view_location - before).length > 0.1, "a click on the pair did not frame it")
    yield from story.shot("o1_checked")


def cancelled(story: Any) -> Iterator[None]:
    """Esc ends a removal, and nothing has changed."""
    yield from press(story, bpy.ops.femors.remove_overclosure)
    yield from story.shot("o2_running")
    story.check(story.job() is not None and story.job().alive, "it ended before it could be cancelled")
    story.press("Escape")
    yield from story.wait("Esc to end the removal", story.quiet)
    story.check(not keys(), "a cancelled removal changed the scene")


def removed(story: Any) -> Iterator[None]:
    """Run to the end; one undo takes all of it back, one redo brings it again."""
    yield from press(story, bpy.ops.femors.remove_overclosure)
    yield from story.wait("the removal", story.quiet)
    story.check(keys() == ["Ball", "Cup"], f"shape keys on {keys()}")
    story.check("CERTIFIED" in story.seen["reports"][-1], f"the report says: {story.seen['reports'][-1]}")
    story.check([pair.state for pair in form().pairs] == ["clear"], "the table was not brought up to date")
    yield from story.shot("o3_removed")
    story.call(bpy.ops.ed.undo)
    yield from story.pause(0.3)
    story.check(not keys(), "undo left shape keys")
    story.call(bpy.ops.ed.redo)
    yield from story.pause(0.3)
    story.check(keys() == ["Ball", "Cup"], "redo did not bring the result back")
    story.call(bpy.ops.ed.undo)
    yield from story.pause(0.3)


def excluded(story: Any) -> Iterator[None]:
    """A pair that was unticked in the table is left alone by the button."""
    form().pairs[0].exclude = True
    yield from press(story, bpy.ops.femors.remove_overclosure)
    yield from story.wait("the removal", story.quiet)
    story.check(not keys(), "an excluded pair was parted")
    story.check([(pair.exclude, pair.state) for pair in form().pairs] == [(True, "excluded")], "the row")
    form().pairs[0].exclude = False


def edited(story: Any) -> Iterator[None]:
    """Move a body while the removal runs: nothing is written."""
    yield from press(story, bpy.ops.femors.remove_overclosure)
    bpy.data.objects["Cup"].location.z += 0.5
    yield from story.wait("the end", story.quiet)
    story.check(not keys(), "a result was written over an edited scene")
    said = story.seen["reports"][-1]
    story.check("'Cup' was edited or moved" in said, f"the report says: {said}")
