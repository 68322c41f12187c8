# SPDX-License-Identifier: GPL-3.0-or-later
"""Inside a windowed Blender: a morph as a person does it, asserted on state, with screenshots.

Started by ``run_window.py``. The steps are generators that yield while they wait; a timer carries
them on, so that Blender stays in charge in between, as it is with a person.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy

HERE = Path(__file__).resolve().parent
OUT = Path(os.environ["FEMORS_WINDOW_OUT"])
LIMIT = 120.0
"""Seconds that any one thing may take to happen."""

if os.environ.get("FEMORS_SITE"):
    sys.path.append(os.environ["FEMORS_SITE"])

sys.path.insert(0, str(HERE.parents[1] / "demo"))

from checkout import PACKAGE, Checkout  # noqa: E402

checkout = Checkout()
Steps = Iterator[None]
SIZE = 30000
"""Vertices of the bones: enough work to watch and to cancel."""
LARGE = int(os.environ.get("FEMORS_WINDOW_NODES", "70000"))
"""Vertices of the bones by which stalls are measured."""

seen: dict[str, Any] = {"steps": []}
opened: list[type] = []
folded: list[type] = []


# --- hands and eyes ---------------------------------------------------------------------------
def check(truth: object, message: str) -> None:
    """Fail the run with a sentence."""
    if not truth:
        raise AssertionError(message)


def wait(what: str, condition: Callable[[], object], limit: float = LIMIT) -> Steps:
    """Let Blender run until the condition holds."""
    start = time.monotonic()
    while not condition():
        check(time.monotonic() - start < limit, f"waited {limit:.0f} s in vain: {what}")
        yield


def pause(seconds: float) -> Steps:
    """Let Blender draw."""
    start = time.monotonic()
    while time.monotonic() - start < seconds:
        yield


def shot(name: str) -> Steps:
    """Write a screenshot."""
    for area in bpy.context.window_manager.windows[0].screen.areas:
        area.tag_redraw()
    yield from pause(0.8)
    subprocess.run(["scrot", "--overwrite", str(OUT / f"{name}.png")], check=True)


def press(key: str) -> None:
    """Press a key with the mouse over the 3D view, through the X server."""
    listed = subprocess.run(
        ["xdotool", "search", "--onlyvisible", "--name", "Blender"],
        capture_output=True,
        text=True,
        check=False,
    )
    check(listed.stdout.split(), f"xdotool found no window: {listed.stderr}")
    window = listed.stdout.split()[0]
    subprocess.run(["xdotool", "mousemove", "500", "400", "windowfocus", window, "key", key], check=True)


def view(window: Any = None) -> dict[str, Any]:
    """Return the context of a window's 3D view and its sidebar."""
    window = window or bpy.context.window_manager.windows[0]
    area = next(a for a in window.screen.areas if a.type == "VIEW_3D")
    return {"window": window, "area": area, "region": next(r for r in area.regions if r.type == "UI")}


def call(operator: Any, how: str = "EXEC_DEFAULT", window: Any = None, **options: Any) -> set[str]:
    """Call an operator as a button in the sidebar does, with an undo step of its own."""
    with bpy.context.temp_override(**view(window)):
        return operator(how, True, **options)


def job() -> Any:
    """Return the running job, or None."""
    return importlib.import_module(f"{PACKAGE}.operators.job").JobOperator.current


def quiet() -> bool:
    """Whether no job and no worker thread is left."""
    return job() is None and not any(t.name == "FEMORS job" for t in threading.enumerate())


def start(window: Any = None) -> Steps:
    """Press Morph and wait for the first word of progress."""
    result = call(bpy.ops.femors.morph, "INVOKE_DEFAULT", window)
    check(result == {"RUNNING_MODAL"}, f"the button gave {result}")
    running = job()
    check(running is not None, "no job is running")
    yield from wait("first progress", lambda: running.fraction > 0)


def scene_state() -> tuple[Any, ...]:
    """Return what must not change: objects, meshes, and the coordinates of the source."""
    mesh = bpy.data.objects["Femur"].data
    positions = [0.0] * (3 * len(mesh.vertices))
    mesh.vertices.foreach_get("co", positions)
    return sorted(bpy.data.objects.keys()), len(bpy.data.meshes), positions


def show_panel() -> Steps:
    """Open the sidebar at the tab FEMORS."""
    context = view()
    space = context["area"].spaces.active
    space.show_region_ui = True
    yield from pause(0.5)
    context["region"].active_panel_category = "FEMORS"
    yield from pause(0.5)


# --- the story --------------------------------------------------------------------------------
def enable() -> Steps:
    """Switch the extension on; doing so must not import SciPy."""
    begin = time.perf_counter()
    checkout.enable()
    seen.setdefault("enable_ms", round(1000 * (time.perf_counter() - begin), 1))
    listen()
    yield


def listen() -> None:
    """Keep what the morph reports to the user."""
    operator = importlib.import_module(f"{PACKAGE}.operators.job").JobOperator

    def tell(self: Any, level: str, line: str) -> None:
        seen.setdefault("reports", []).append(f"{level}: {line}")
        self.report({level}, line)

    operator.tell = tell


def shapes() -> Steps:
    """Two bones side by side, and the panel without anything picked."""
    check("scipy" not in sys.modules, "enabling the extension imported SciPy")
    for item in list(bpy.data.objects):
        bpy.data.objects.remove(item)
    make_shapes()
    with bpy.context.temp_override(**(view() | {"region": view()["area"].regions[-1]})):
        bpy.ops.view3d.view_all()
    yield from show_panel()
    yield from shot("1_panel")
    region = view()["region"]  # what the disabled button says, for the eye only
    x = region.x + region.width // 2 - 10
    subprocess.run(["xdotool", "mousemove", str(x), "330", "mousemove", str(x + 2), "336"], check=True)
    yield from pause(1.5)
    subprocess.run(["scrot", "--overwrite", str(OUT / "1_tooltip.png")], check=True)
    subprocess.run(["xdotool", "mousemove", "300", "600"], check=True)
    yield from pause(0.5)


def make_shapes(size: int = SIZE) -> None:
    """Make the source "Femur" and the target "Scan" from the core's own shapes."""
    core = importlib.import_module(f"{PACKAGE}.femors_addon.shapes")
    pair = core.pair(size, size, posed=True, length=4.0)
    for name, surface in (("Femur", pair.source), ("Scan", pair.target)):
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(surface.vertices.tolist(), [], surface.faces.tolist())
        item = bpy.data.objects.new(name, mesh)
        bpy.context.scene.collection.objects.link(item)


def pick() -> Steps:
    """Fill the pickers from the selection."""
    source, target = bpy.data.objects["Femur"], bpy.data.objects["Scan"]
    check(not enabled(), "the button must be disabled while nothing is picked")
    for item in (source, target):
        item.select_set(True)
    bpy.context.view_layer.objects.active = source
    check(enabled(), "the button must be enabled when the selection says what to do")
    yield from shot("2_selected")
    call(bpy.ops.femors.pick_selection)
    form = bpy.context.scene.femors
    check((form.source, form.target) == (source, target), "the pickers were not filled from the selection")
    check(enabled(), "the button must be enabled when both are picked")
    yield from shot("2_picked")


def enabled() -> bool:
    """Whether the panel enables its button."""
    morph = importlib.import_module(f"{PACKAGE}.operators.morph")
    with bpy.context.temp_override(**view()):
        return not morph.gap(bpy.context)


def cancel() -> Steps:
    """Start, watch it progress, press Esc: nothing has changed."""
    before = scene_state()
    yield from start()
    running = job()
    fractions, texts, last, gap = set(), set(), time.monotonic(), 0.0
    while len(fractions) < 5 and running.alive:
        fractions.add(running.fraction)
        texts.add(running.text)
        now = time.monotonic()
        gap, last = max(gap, now - last), now
        yield
    seen["progress_texts"] = sorted(texts)
    seen["longest_stall_s"] = round(gap, 3)
    check(len(fractions) >= 3, f"the progress did not move: {fractions}")
    yield from shot("3_running")
    check(
        job() is running and running.alive,
        "the job ended before it could be cancelled: make the shapes larger",
    )
    press("Escape")
    begin = time.monotonic()
    yield from wait("Esc to end the job", quiet)
    seen["cancel_s"] = round(time.monotonic() - begin, 2)
    check(scene_state() == before, "a cancelled job changed the scene")
    yield from start()
    call(bpy.ops.femors.cancel)
    yield from wait("the Cancel button to end the job", quiet)
    check(scene_state() == before, "a job that was cancelled by its button changed the scene")
    yield from shot("4_cancelled")


class Pulse:
    """Ticks of the window, every 5 ms while it has nothing to do: what comes late was a stall."""

    def __init__(self) -> None:
        self.late: list[tuple[float, float, str, str]] = []
        self.drawn = self.before = ""
        add = bpy.types.SpaceView3D.draw_handler_add
        self.handlers = {
            "WINDOW": add(self.draw, ("viewport",), "WINDOW", "PRE_VIEW"),
            "UI": add(self.draw, ("sidebar",), "UI", "POST_PIXEL"),
        }
        self.begun = self.last = time.monotonic()
        bpy.app.timers.register(self.tick)

    def draw(self, what: str) -> None:
        self.drawn = self.drawn if self.drawn == "viewport" else what

    def tick(self) -> float | None:
        running, now = job(), time.monotonic()
        if self.last is None:
            return None
        text = running.text if running else ""
        # the display may be waited for in the tick after the drawing
        self.late.append((now - self.last, now - self.begun, text, self.drawn or self.before or "nothing"))
        self.last, self.before, self.drawn = now, self.drawn, ""
        return 0.005

    def figures(self) -> dict[str, Any]:
        """End, and return the gaps between ticks in ms, by what was drawn in them."""
        self.last = None
        for region, handler in self.handlers.items():
            bpy.types.SpaceView3D.draw_handler_remove(handler, region)
        out: dict[str, Any] = {}
        for name in ("viewport", "sidebar", "nothing"):
            mine = sorted((one for one in self.late if one[3] == name), reverse=True)
            gaps = [round(1000 * one[0]) for one in mine]
            if gaps:
                out[name] = {"ticks": len(gaps), "median_ms": gaps[len(gaps) // 2], "longest_ms": gaps[0]}
                out[name]["over_100_ms"] = sum(gap > 100 for gap in gaps)
                out[name]["worst"] = [f"{1000 * g:.0f} at {at:.1f} s: {t}" for g, at, t, _ in mine[:3]]
        return out


def watched() -> Steps:
    """A job of 70 000 nodes: the preview moves, the window does not stall, the source stays."""
    for item in list(bpy.data.objects):
        bpy.data.objects.remove(item)
    make_shapes(LARGE)
    form = bpy.context.scene.femors
    form.source, form.target = bpy.data.objects["Femur"], bpy.data.objects["Scan"]
    with bpy.context.temp_override(**(view() | {"region": view()["area"].regions[-1]})):
        bpy.ops.view3d.view_all()
    before = scene_state()
    yield from show_panel()
    idle = Pulse()
    for _ in range(8):  # what a redraw of these two objects takes here, with nothing else to do
        view()["area"].tag_redraw()
        yield from pause(0.5)
    seen["idle_window"] = idle.figures()
    yield from start()
    running, pulse = job(), Pulse()
    moving = running.views[0]
    yield from wait("two pictures of the preview", lambda: moving.pictures >= 2)
    yield from shot("8_preview")
    yield from wait("half of it", lambda: running.fraction > 0.5)
    yield from shot("8_preview_later")
    yield from wait("the end of the computation", lambda: not running.alive)
    seen["window_at_70k"] = pulse.figures()
    seen["preview"] = {"pictures": moving.pictures, "pause_s": round(moving.pause, 2)}
    yield from wait("the result", quiet)
    check(moving.pictures > 5, f"the preview was drawn {moving.pictures} times")
    after = scene_state()
    check(after[2] == before[2], "the source moved")
    yield from shot("8_result")


def only(*names: str) -> Steps:
    """Show these panels of the sidebar alone, open: a script can neither scroll it nor unfold a panel."""
    for stand in opened:
        bpy.utils.unregister_class(stand)
    opened.clear()
    for cls in reversed(folded):
        bpy.utils.register_class(cls)
    folded.clear()
    if names:
        mine = [c for c in bpy.types.Panel.__subclasses__() if getattr(c, "bl_category", "") == "FEMORS"]
        mine += [c for base in mine for c in base.__subclasses__()]
        roots = [c for c in mine if c.is_registered and not getattr(c, "bl_parent_id", "")]
        children = [c for c in mine if c.is_registered and getattr(c, "bl_parent_id", "")]
        for cls in (*children, *roots):
            bpy.utils.unregister_class(cls)
            folded.append(cls)
        for cls in roots:
            if cls.__name__.removeprefix("FEMORS_PT_") in names:
                key = cls.bl_idname + "_open"
                stand = type(key, (cls,), {"bl_idname": key, "bl_options": set()})
                bpy.utils.register_class(stand)
                opened.append(stand)
    yield from show_panel()


def measured() -> Steps:
    """Measure the result beside its target, show heat maps with their legend, and go back."""
    call(bpy.ops.object.select_all, action="DESELECT")
    item = next(o for o in bpy.data.objects if o.name.startswith("Femur morphed"))
    item.select_set(True)
    bpy.context.view_layer.objects.active = item
    form = bpy.context.scene.femors_heat
    form.mesh, form.other = item, bpy.data.objects["Scan"]
    yield from only("quality")
    check(call(bpy.ops.femors.quality, "INVOKE_DEFAULT") == {"RUNNING_MODAL"}, "the button did not start")
    yield from wait("the figures", quiet)
    check(item.femors.quality, "no figures were kept")
    yield from shot("9_quality")
    yield from only("heat")
    shading = view()["area"].spaces.active.shading
    before = {name: getattr(shading, name) for name in ("type", "color_type", "show_specular_highlight")}
    legend = importlib.import_module(f"{PACKAGE}.ui.legend")
    for number, quantity in enumerate(("displacement", "aspect", "gap")):
        form.quantity = quantity
        check(call(bpy.ops.femors.show_heat) == {"FINISHED"}, f"{quantity} was not shown")
        check(shading.color_type == "VERTEX", "the viewport does not show the colours")
        with bpy.context.temp_override(**(view() | {"region": view()["area"].regions[-1]})):
            bpy.ops.view3d.view_selected()
            check(legend.words(bpy.context), "there is no legend")
        yield from shot(f"9_heat_{number + 1}_{quantity}")
    check(call(bpy.ops.femors.hide_heat) == {"FINISHED"}, "no way back")
    check(all(getattr(shading, name) == old for name, old in before.items()), "the shading is another")
    check("femors_heat" not in item.data.color_attributes, "the colours are still there")
    yield from shot("9_heat_4_back")
    yield from only()


def kept() -> Steps:
    """Write the report with the viewport in it, morph to a shape key and make a film of it; undo that."""
    yield from only("report")
    path = OUT / "report.html"
    path.unlink(missing_ok=True)
    check(call(bpy.ops.femors.report, filepath=str(path)) == {"FINISHED"}, "no report")
    text = path.read_text(encoding="utf-8")
    check("As the viewport showed it" in text and text.count("<svg") > 5, "the page lacks pictures or plots")
    form = bpy.context.scene.femors
    form.result = "SHAPE_KEY"
    source = bpy.data.objects["Femur"]
    yield from start()
    yield from wait("the shape key", quiet)
    check(source.data.shape_keys, "no shape key")
    bpy.ops.object.select_all(action="DESELECT")
    source.select_set(True)
    bpy.context.view_layer.objects.active = source
    call(bpy.ops.ed.undo_push, message="select")
    check(call(bpy.ops.femors.animate) == {"FINISHED"}, "no film")
    key = source.data.shape_keys.key_blocks[-1]
    bpy.context.scene.frame_set(31)
    yield from pause(0.3)
    check(0.3 < key.value < 0.7, f"half way through the slider is at {key.value}")
    yield from shot("9_film")
    call(bpy.ops.ed.undo)
    yield from pause(0.3)
    source = bpy.data.objects["Femur"]
    animation = source.data.shape_keys.animation_data
    check(animation is None or animation.action is None, "one undo did not take the film away")
    bpy.context.scene.femors.result = "NEW"
    yield from only()


def finish() -> Steps:
    """Run to the end: one new object, selected, with figures."""
    names, _, positions = scene_state()
    yield from start()
    yield from wait("the morph to finish", quiet)
    after = scene_state()
    check(len(after[0]) == len(names) + 1 and after[2] == positions, f"objects now: {after[0]}")
    item = bpy.context.view_layer.objects.active
    check(item.name == "Femur morphed to Scan" and item.select_get(), f"the active object is {item.name}")
    check(item.femors.report, "the result has no figures")
    check(bpy.data.objects["Scan"].hide_get(), "the target was not hidden, as the form asks for")
    seen["report"] = {k: json.loads(item.femors.report).get(k) for k in ("stop_reason", "warnings")}
    yield from shot("5_figures")


def undo() -> Steps:
    """One undo takes the result away, one redo brings it back."""
    names = scene_state()[0]
    call(bpy.ops.ed.undo)
    yield from pause(0.3)
    check(
        scene_state()[0] == [n for n in names if n != "Femur morphed to Scan"],
        f"after undo: {scene_state()[0]}",
    )
    check(not bpy.data.objects["Scan"].hide_get(), "undo did not show the target again")
    form = bpy.context.scene.femors
    check(form.source and form.target, "undo emptied the form: it went back too far")
    yield from shot("6_undone")
    call(bpy.ops.ed.redo)
    yield from pause(0.3)
    check(scene_state()[0] == names, f"after redo: {scene_state()[0]}")
    bpy.data.objects.remove(bpy.data.objects["Femur morphed to Scan"])
    call(bpy.ops.ed.undo_push, message="tidy")


def advanced() -> Steps:
    """Look at the Advanced panel."""
    form = bpy.context.scene.femors
    form.preset = "published"
    check(form.correspondence == "nearest", "choosing a preset did not fill the form")
    closed = importlib.import_module(f"{PACKAGE}.ui.panels").FEMORS_PT_morph_advanced
    # a panel cannot be opened by a script: the same one, open by default, stands in for the picture
    opened = type("FEMORS_PT_open", (closed,), {"bl_idname": "FEMORS_PT_open", "bl_options": set()})
    bpy.utils.unregister_class(closed)
    bpy.utils.register_class(opened)
    yield from show_panel()
    yield from shot("7_advanced")
    bpy.utils.unregister_class(opened)
    bpy.utils.register_class(closed)
    form.preset = "standard"


def usable() -> Steps:
    """Work on while the job runs: Edit Mode on the source, and back; the result then arrives."""
    before = scene_state()
    yield from start()
    running = job()
    bpy.context.view_layer.objects.active = bpy.data.objects["Femur"]
    call(bpy.ops.object.mode_set, mode="EDIT")
    yield from wait("the computation", lambda: not running.alive)
    yield from pause(0.5)
    check(job() is running, "the result was written in Edit Mode")
    call(bpy.ops.object.mode_set, mode="OBJECT")
    yield from wait("the result", quiet)
    check(len(scene_state()[0]) == len(before[0]) + 1, "no result after Edit Mode")
    bpy.data.objects.remove(bpy.context.view_layer.objects.active)


def deleted() -> Steps:
    """Delete the target while the job runs: nothing is written, nothing is left."""
    copy = bpy.data.objects["Scan"].copy()
    copy.name = "Scan copy"
    bpy.context.scene.collection.objects.link(copy)
    form = bpy.context.scene.femors
    kept, form.target = form.target, copy
    yield from start()
    with bpy.context.temp_override(**view(), selected_objects=[copy]):
        bpy.ops.object.delete()
    check(not copy.users_scene, "the target was not deleted")
    names = scene_state()[0]
    yield from wait("the end", quiet)
    check(scene_state()[0] == names, "a result appeared for a deleted target")
    check("'Scan copy' was deleted" in seen["reports"][-1], f"the report says: {seen['reports'][-1]}")
    form.target = kept


def overclosures() -> Steps:
    """Overclosures found and removed; see ``overclosure.py``."""
    sys.path.insert(0, str(HERE))
    overclosure = importlib.import_module("overclosure")
    yield from overclosure.steps(SimpleNamespace(**globals()))


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
    checkout.disable()
    check(quiet(), "the job outlived the extension")
    check(not hasattr(bpy.types.Scene, "femors"), "Scene.femors is still there")
    yield from pause(0.5)
    yield from enable()
    yield from show_panel()


def other_file() -> Steps:
    """Load another file while a job runs."""
    yield from start()
    bpy.ops.wm.read_homefile(use_empty=True)
    check(quiet(), "the job outlived its file")
    yield from pause(0.5)
    make_shapes()
    form = bpy.context.scene.femors
    form.source, form.target = bpy.data.objects["Femur"], bpy.data.objects["Scan"]
    yield from pause(0.5)


def quitting() -> Steps:
    """Cancel a job, start another and quit Blender while it runs; run_window.py sees whether it ends."""
    yield from start()
    call(bpy.ops.femors.cancel)
    yield from wait("the operator to end", lambda: job() is None)
    yield from start()


STORY = (
    enable,
    shapes,
    pick,
    cancel,
    finish,
    undo,
    advanced,
    usable,
    deleted,
    overclosures,
    second_window,
    switched_off,
    other_file,
    watched,
    measured,
    kept,
    quitting,
)


def whole() -> Steps:
    """All steps, one after the other."""
    yield from pause(1.0)
    wanted = os.environ.get("FEMORS_WINDOW_STEPS", "").split(",")
    for step in STORY:
        if wanted != [""] and step.__name__ not in wanted:
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
        return 0.05
    except StopIteration:
        pass
    except Exception as error:
        traceback.print_exc()
        seen["error"] = f"{type(error).__name__}: {error}"
    (OUT / "result.json").write_text(json.dumps(seen, indent=1))
    bpy.ops.wm.quit_blender()
    return None


bpy.context.preferences.view.show_splash = False
bpy.context.preferences.view.use_save_prompt = False
bpy.app.timers.register(tick, first_interval=1.0, persistent=True)
