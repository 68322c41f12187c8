# SPDX-License-Identifier: GPL-3.0-or-later
"""The story in a window, what may come between: edits, deletions, other windows and files, quitting."""

from __future__ import annotations

import os
import time
from typing import Any

import bpy
import hands
from hands import (
    Steps,
    away,
    call,
    check,
    clear,
    frame,
    job,
    only,
    pause,
    quiet,
    seen,
    shot,
    show_panel,
    start,
    view,
    wait,
)
from pulse import Pulse

SMALL = 12000
"""Vertices of the bones here: enough work to come between."""
LARGE = int(os.environ.get("FEMORS_WINDOW_NODES", "70000"))
"""Vertices of the bones by which stalls are measured."""


def scene_state() -> tuple[Any, ...]:
    """Return what must not change: objects, meshes, and the coordinates of the source."""
    mesh = bpy.data.objects["Femur"].data
    positions = [0.0] * (3 * len(mesh.vertices))
    mesh.vertices.foreach_get("co", positions)
    return sorted(bpy.data.objects.keys()), len(bpy.data.meshes), positions


def make_shapes(size: int = SMALL) -> None:
    """Make the source "Femur" and the target "Scan" from the core's own shapes."""
    pair = hands.module("femors_addon.shapes").pair(size, size, posed=True, length=4.0)
    for name, surface in (("Femur", pair.source), ("Scan", pair.target)):
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(surface.vertices.tolist(), [], surface.faces.tolist())
        item = bpy.data.objects.new(name, mesh)
        bpy.context.scene.collection.objects.link(item)


def picked(size: int = SMALL) -> None:
    """Have nothing but two bones, and both in the form."""
    clear()
    make_shapes(size)
    space = view()["area"].spaces.active
    space.clip_start, space.clip_end = 0.01, 1000.0
    form = bpy.context.scene.femors
    form.source, form.target, form.result = bpy.data.objects["Femur"], bpy.data.objects["Scan"], "NEW"
    frame()


def film() -> Steps:
    """Morph to a shape key and make a film of it; one undo takes the film away."""
    picked()
    bpy.context.scene.femors.result = "SHAPE_KEY"
    yield from show_panel()
    yield from start()
    yield from wait("the shape key", quiet)
    source = bpy.data.objects["Femur"]
    check(source.data.shape_keys, "no shape key")
    hands.select("Femur")
    call(bpy.ops.ed.undo_push, message="select")
    yield from only("report")
    yield from hands.click(1, until=lambda: source.data.shape_keys.animation_data)
    key = source.data.shape_keys.key_blocks[-1]
    bpy.context.scene.frame_set(31)
    yield from pause(0.3)
    check(0.3 < key.value < 0.7, f"half way through the slider is at {key.value}")
    yield from shot("51_film")
    call(bpy.ops.ed.undo)
    yield from pause(0.2)
    animation = bpy.data.objects["Femur"].data.shape_keys.animation_data
    check(animation is None or animation.action is None, "one undo did not take the film away")
    yield from only()


def usable() -> Steps:
    """Work on while the job runs: Edit Mode on the source, and back; the result then arrives."""
    picked()
    before = scene_state()
    yield from start()
    running = job()
    bpy.context.view_layer.objects.active = bpy.data.objects["Femur"]
    call(bpy.ops.object.mode_set, mode="EDIT")
    yield from wait("the computation", lambda: not running.alive)
    yield from pause(0.5)
    check(job() is running, "the result was written in Edit Mode")
    yield from shot("52_edit_mode")
    call(bpy.ops.object.mode_set, mode="OBJECT")
    yield from wait("the result", quiet)
    check(len(scene_state()[0]) == len(before[0]) + 1, "no result after Edit Mode")
    bpy.data.objects.remove(bpy.context.view_layer.objects.active)


def deleted() -> Steps:
    """Delete the target while the job runs: nothing is written, nothing is left, and it is told."""
    copy = bpy.data.objects["Scan"].copy()
    copy.name = "Scan copy"
    bpy.context.scene.collection.objects.link(copy)
    form = bpy.context.scene.femors
    form.target = copy
    yield from start()
    with bpy.context.temp_override(**view(), selected_objects=[copy]):
        bpy.ops.object.delete()
    check(not copy.users_scene, "the target was not deleted")
    names = scene_state()[0]
    yield from wait("the end", quiet)
    check(scene_state()[0] == names, "a result appeared for a deleted target")
    check("'Scan copy' was deleted" in seen["reports"][-1], f"the report says: {seen['reports'][-1]}")
    yield from shot("53_deleted")
    yield from away()  # what Blender says of it stands at the mouse until that moves
    yield from shot("54_told")
    form.target = bpy.data.objects["Scan"]


def second_window() -> Steps:
    """Start in a second window and close it."""
    call(bpy.ops.wm.window_new_main)
    yield from pause(1.0)
    window = bpy.context.window_manager.windows[-1]
    yield from start(window)
    with bpy.context.temp_override(window=window):
        bpy.ops.wm.window_close()
    yield from wait("the job to end with its window", quiet, 20)
    check(call(bpy.ops.femors.reset_preset) == {"FINISHED"}, "operators no longer work")


def switched_off() -> Steps:
    """Switch the extension off while a job runs, and on again."""
    yield from start()
    hands.checkout.disable()
    check(quiet(), "the job outlived the extension")
    check(not hasattr(bpy.types.Scene, "femors"), "Scene.femors is still there")
    yield from pause(0.3)
    hands.checkout.enable()
    hands.listen()
    # Blender 4.3 keeps an empty handler of the operator that is gone until the window sees an event, and
    # crashes where another modal operator starts before; a person's mouse is such an event
    yield from away()
    yield from show_panel()


def other_file() -> Steps:
    """Load another file while a job runs."""
    picked()
    yield from start()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
    check(quiet(), "the job outlived its file")
    yield from pause(0.5)
    picked()
    yield from show_panel()


def watched() -> Steps:
    """A job of 70 000 nodes: the preview moves, the source stays, and stalls of the window are measured."""
    picked(LARGE)
    before = scene_state()
    yield from show_panel()
    idle = Pulse()
    for _ in range(5):  # what a redraw of these two objects takes here, with nothing else to do
        view()["area"].tag_redraw()
        yield from pause(0.4)
    seen["idle_window"] = idle.figures()
    pulse = Pulse()
    yield from start()
    running = job()
    moving, moves = running.views[0], []  # moments at which the mesh moves: not in the alignment, nor later

    def past(fraction: float) -> bool:
        if moving.pictures:
            moves.append(time.monotonic())
        return running.fraction > fraction or not running.alive

    yield from wait("half of it", lambda: past(0.5))
    yield from shot("55_preview")
    pulse.go_on()
    yield from wait("the nodes on the target", lambda: past(0.86))
    yield from wait("the end of the computation", lambda: not running.alive)
    yield from wait("the result", quiet)
    seen["window_at_70k"] = pulse.figures()
    span = moves[-1] - moves[0] if moves else 0.0
    seen["preview"] = {"pictures": moving.pictures, "pause_s": round(moving.pause, 2), "of_s": round(span, 2)}
    # the preview waits as long as drawing takes, seconds where that is done in software: more than five
    # pictures, or half of those that there was time for
    fits = span / max(moving.pause, 0.1)
    check(moving.pictures >= min(6, max(3, 0.5 * fits)), f"the preview was drawn {moving.pictures} times")
    check(scene_state()[2] == before[2], "the source moved")
    yield from shot("56_result")


def quitting() -> Steps:
    """Cancel a job, start another and quit Blender while it runs; run_window.py sees whether it ends."""
    picked()
    yield from start()
    call(bpy.ops.femors.cancel)
    yield from wait("the operator to end", lambda: job() is None)
    yield from start()
