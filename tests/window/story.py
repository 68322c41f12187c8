# SPDX-License-Identifier: GPL-3.0-or-later
"""Inside a windowed Blender: a morph as a person does it, asserted on state, with screenshots.

Started by ``run_window.py``. The bones are those of ``femur_pair`` where the data is there, else made-up
ones. What is done with the results is in ``panels.py`` and ``overclosure.py``, what may come between in
``meanwhile.py``.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))

import hands
import meanwhile
import overclosure
import panels
from hands import (
    OUT,
    Steps,
    away,
    call,
    check,
    clear,
    click,
    frame,
    job,
    only,
    pause,
    quiet,
    seen,
    shot,
    show_panel,
    started,
    view,
    wait,
    xdotool,
)
from meanwhile import scene_state

DATA = Path(os.environ.get("FEMORS_DATA", hands.ROOT.parent / "shared" / "data")) / "femur_pair"


def enable() -> Steps:
    """Switch the extension on, where Blender has not; that imports neither NumPy nor SciPy."""
    already = set(sys.modules)
    begin = time.process_time()
    hands.checkout.enable()
    if "enable_ms" not in seen:
        seen["enable_ms"] = round(1000 * (time.process_time() - begin), 1)
        heavy = {"numpy", "scipy", "fast_simplification", "meshio"} & set(sys.modules)
        check(not (heavy if hands.INSTALLED else heavy - already), f"enabling has imported {heavy}")
    hands.listen()
    yield


def shapes() -> Steps:
    """Two bones, and the panel without anything picked."""
    clear()
    seen["bones"] = "femur_pair" if DATA.is_dir() else "made up"
    if DATA.is_dir():
        for name, file in (("Femur", "source.stl"), ("Scan", "target.stl")):
            with bpy.context.temp_override(**hands.viewport()):
                bpy.ops.wm.stl_import(filepath=str(DATA / file))
            bpy.context.view_layer.objects.active.name = name
        space = view()["area"].spaces.active
        space.clip_start, space.clip_end = 1.0, 20000.0
        units = bpy.context.scene.unit_settings
        units.system, units.scale_length, units.length_unit = "METRIC", 0.001, "MILLIMETERS"
    else:
        meanwhile.make_shapes(24000)
    hands.select()
    frame()
    yield from show_panel()
    yield from shot("01_panel")
    region = view()["region"]  # what the disabled button says, for the eye only
    place = bpy.context.window_manager.windows[0].height - region.y - region.height + 312
    x = region.x + region.width // 2 - 10
    for shift in (0, 3):
        xdotool("mousemove", str(x + shift), str(place + shift))
        yield from pause(0.7)
    yield from shot("02_tooltip")
    yield from away()
    yield from only("transfer")
    yield from shot("03_transfer_before")
    yield from only("overclosure")
    yield from shot("04_overclosure_before")
    yield from only("quality", "heat", "report")
    yield from shot("05_quality_before")
    yield from only()


def pick() -> Steps:
    """Fill the pickers from the selection."""
    source, target = bpy.data.objects["Femur"], bpy.data.objects["Scan"]
    check(not enabled(), "the button must be disabled while nothing is picked")
    hands.select("Femur", "Scan")
    call(bpy.ops.ed.undo_push, message="select")
    check(enabled(), "the button must be enabled when the selection says what to do")
    yield from shot("06_selected")
    call(bpy.ops.femors.pick_selection)
    form = bpy.context.scene.femors
    check((form.source, form.target) == (source, target), "the pickers were not filled from the selection")
    check(enabled(), "the button must be enabled when both are picked")
    yield from only("morph")


def enabled() -> bool:
    """Whether the panel enables its button."""
    with bpy.context.temp_override(**view()):
        return not hands.module("operators.morph").gap(bpy.context)


def cancel() -> Steps:
    """Press the button, watch it progress, press Esc: nothing has changed. Then with the button Cancel."""
    before = scene_state()
    yield from click()
    yield from started()
    running = job()
    fractions, texts = set(), set()
    while len(fractions) < 5 and job() is running:
        fractions.add(running.fraction)
        texts.add(running.text)
        yield
    seen["progress_texts"] = sorted(texts)
    check(len(fractions) >= 3, f"the progress did not move: {fractions}")
    check(
        job() is running and running.alive,
        "the job ended before it could be cancelled: make the shapes larger",
    )
    hands.press("Escape")
    begin = time.monotonic()
    yield from wait("Esc to end the job", quiet)
    seen["cancel_s"] = round(time.monotonic() - begin, 2)
    check(scene_state() == before, "a cancelled job changed the scene")
    yield from shot("08_cancelled")
    yield from click()
    yield from started()
    yield from click(until=lambda: job() is None)  # which is Cancel by now
    yield from wait("the Cancel button to end the job", quiet)
    check(seen["reports"][-2:] == 2 * ["INFO: Morph: cancelled, nothing was changed"], str(seen["reports"]))
    check(scene_state() == before, "a job that was cancelled by its button changed the scene")


def finish() -> Steps:
    """Run to the end: one new object, selected, with figures."""
    names, _, positions = scene_state()
    yield from click()
    yield from started()
    running = job()
    moving = running.views[0]
    yield from wait("a picture of the preview", lambda: moving.pictures or not running.alive)
    yield from shot("07_running")
    yield from wait("the morph to finish", quiet)
    after = scene_state()
    check(len(after[0]) == len(names) + 1 and after[2] == positions, f"objects now: {after[0]}")
    item = bpy.context.view_layer.objects.active
    check(item.name == "Femur morphed to Scan" and item.select_get(), f"the active object is {item.name}")
    check(item.femors.report, "the result has no figures")
    check(bpy.data.objects["Scan"].hide_get(), "the target was not hidden, as the form asks for")
    check(moving.pictures, "the preview was never drawn")
    seen["report"] = {k: json.loads(item.femors.report).get(k) for k in ("stop_reason", "warnings")}
    yield from shot("09_figures")
    yield from only()


def undo() -> Steps:
    """One undo takes the result away, one redo brings it back."""
    names = scene_state()[0]
    call(bpy.ops.ed.undo)
    yield from pause(0.2)
    left = scene_state()[0]
    check(left == [n for n in names if n != "Femur morphed to Scan"], f"after undo: {left}")
    check(not bpy.data.objects["Scan"].hide_get(), "undo did not show the target again")
    form = bpy.context.scene.femors
    check(form.source and form.target, "undo emptied the form: it went back too far")
    yield from shot("10_undone")
    call(bpy.ops.ed.redo)
    yield from pause(0.2)
    check(scene_state()[0] == names, f"after redo: {scene_state()[0]}")
    yield from shot("11_redone")


STORY = (
    enable,
    shapes,
    pick,
    cancel,
    finish,
    undo,
    panels.quality,
    panels.heat,
    panels.transfer,
    panels.report,
    panels.advanced,
    overclosure.overclosures,
    meanwhile.film,
    meanwhile.usable,
    meanwhile.deleted,
    meanwhile.second_window,
    meanwhile.switched_off,
    meanwhile.other_file,
    meanwhile.watched,
    meanwhile.quitting,
)


def whole() -> Steps:
    """All steps, one after the other."""
    yield from pause(0.5)
    hands.Drawn.begin()
    wanted, without = (os.environ.get(f"FEMORS_WINDOW_{w}", "").split(",") for w in ("STEPS", "WITHOUT"))
    for step in STORY:
        if (wanted != [""] and step.__name__ not in wanted) or step.__name__ in without:
            continue
        print(f"window: {step.__name__}", flush=True)
        begin = time.monotonic()
        yield from step()
        seen["steps"].append([step.__name__, round(time.monotonic() - begin, 1)])


run = whole()


def tick() -> float | None:
    """Carry the story on; at its end, or at a failure, write what was seen and quit."""
    try:
        next(run)
        return 0.03
    except StopIteration:
        pass
    except Exception as error:
        traceback.print_exc()
        hands.subprocess.run(["scrot", "--overwrite", str(OUT / "failed.png")], check=False)
        hands.put_back()
        seen["error"] = f"{type(error).__name__}: {error}"
    (OUT / "result.json").write_text(json.dumps(seen, indent=1))
    bpy.ops.wm.quit_blender()
    return None


preferences = bpy.context.preferences
preferences.view.show_splash = False
preferences.view.use_save_prompt = False
preferences.system.viewport_aa = "FXAA"  # else each change is drawn eight times, in software here
bpy.app.timers.register(tick, first_interval=0.5, persistent=True)
