# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands and eyes in a windowed Blender: wait, look, click, press keys, take pictures.

What takes time is a generator that yields while it waits; a timer carries it on (`story.py`), so that
Blender stays in charge in between, as it is with a person.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy

ROOT = Path(__file__).resolve().parents[2]
OUT = Path(os.environ["FEMORS_WINDOW_OUT"])
LIMIT = 120.0
"""Seconds that any one thing may take to happen."""
REST = ("640", "640")
"""Where the mouse is left: over the 3D view, away from all that reacts to it."""
LARGE = 24
"""Pixels: buttons that are taller were made large by the panel."""

if os.environ.get("FEMORS_SITE"):
    sys.path.append(os.environ["FEMORS_SITE"])
sys.path.insert(0, str(ROOT / "demo"))

from checkout import INSTALLED, PACKAGE, Checkout  # noqa: E402

__all__ = ["INSTALLED"]
Steps = Iterator[None]
checkout = Checkout()
seen: dict[str, Any] = {"steps": [], "reports": []}
"""What `result.json` tells."""


# --- eyes -------------------------------------------------------------------------------------
def check(truth: object, message: str) -> None:
    """Fail the run with a sentence."""
    if not truth:
        raise AssertionError(message)


def wait(what: str, condition: Callable[[], object], limit: float = LIMIT) -> Steps:
    """Let Blender run until the condition holds, or an error is reported."""
    start, told = time.monotonic(), len(seen["reports"])
    while not condition():
        errors = [line for line in seen["reports"][told:] if line.startswith("ERROR")]
        check(not errors, f"{what} did not come: {errors}")
        check(time.monotonic() - start < limit, f"waited {limit:.0f} s in vain: {what}")
        yield


def pause(seconds: float) -> Steps:
    """Let Blender go on."""
    start = time.monotonic()
    while time.monotonic() - start < seconds:
        yield


class Drawn:
    """How often the viewport and the sidebar were drawn."""

    count = {"WINDOW": 0, "UI": 0}  # noqa: RUF012

    @classmethod
    def begin(cls) -> None:
        """Count from now on."""
        for region in cls.count:
            bpy.types.SpaceView3D.draw_handler_add(cls.drawn, (region,), region, "POST_PIXEL")

    @classmethod
    def drawn(cls, region: str) -> None:
        """Count one."""
        cls.count[region] += 1


def redrawn() -> Steps:
    """Have all of the window drawn twice: the first time, a panel that has changed finds its new height."""
    for _ in range(2):
        before = dict(Drawn.count)
        regions = [r for r in Drawn.count if r == "WINDOW" or view()["region"].width > 1]
        for area in bpy.context.window_manager.windows[0].screen.areas:
            area.tag_redraw()
        yield from wait("a redraw", lambda b=before, rs=regions: all(Drawn.count[r] > b[r] for r in rs))
        yield from pause(0.1)


def shot(name: str) -> Steps:
    """Write a screenshot."""
    yield from redrawn()
    subprocess.run(["scrot", "--overwrite", str(OUT / f"{name}.png")], check=True)


def view(window: Any = None) -> dict[str, Any]:
    """Return the context of a window's 3D view and its sidebar."""
    window = window or bpy.context.window_manager.windows[0]
    area = next(a for a in window.screen.areas if a.type == "VIEW_3D")
    return {"window": window, "area": area, "region": next(r for r in area.regions if r.type == "UI")}


def viewport() -> dict[str, Any]:
    """Return the context of the 3D view itself."""
    return view() | {"region": next(r for r in view()["area"].regions if r.type == "WINDOW")}


def module(name: str) -> Any:
    """Return a module of the extension that is enabled."""
    return importlib.import_module(f"{PACKAGE}.{name}")


def job() -> Any:
    """Return the running job, or None."""
    return module("operators.job").JobOperator.current


def quiet() -> bool:
    """Whether no job and no worker thread is left."""
    return job() is None and not any(t.name == "FEMORS job" for t in threading.enumerate())


def listen() -> None:
    """Keep what is reported to the user."""
    operator = module("operators.job").JobOperator

    def tell(self: Any, level: str, line: str) -> None:
        seen["reports"].append(f"{level}: {line}")
        self.report({level}, line)

    operator.tell = tell


# --- hands ------------------------------------------------------------------------------------
def xdotool(*words: str) -> str:
    """Move the mouse or press a key, through the X server."""
    done = subprocess.run(["xdotool", *words], capture_output=True, text=True, check=False)
    return done.stdout.strip()


def press(key: str) -> None:
    """Press a key with the mouse over the 3D view."""
    window = xdotool("search", "--onlyvisible", "--name", "Blender").split()
    check(window, "xdotool found no window")
    xdotool("mousemove", "500", "400", "windowfocus", window[0], "key", key)


def away() -> Steps:
    """Move the mouse about, as people do: what pops up over a window goes when the mouse leaves it."""
    for place in (("60", "700"), ("300", "100"), REST):
        xdotool("mousemove", *place)
        yield from pause(0.2)


def large_buttons() -> list[int]:
    """Return where the sidebar's large buttons are that can be pressed: pixels from the screen's top."""
    import numpy as np

    region, window = view()["region"], bpy.context.window_manager.windows[0]
    path = Path(bpy.app.tempdir) / "sidebar.png"
    top = window.height - region.y - region.height
    strip = f"{region.x + 45},{top},2,{region.height}"  # right of the icons, left of the words
    subprocess.run(["scrot", "--overwrite", "-a", strip, str(path)], check=True)
    image = bpy.data.images.load(str(path))
    pixels = np.empty(4 * image.size[0] * image.size[1], dtype=np.float32)
    image.pixels.foreach_get(pixels)
    column = pixels.reshape(image.size[1], image.size[0], 4)[::-1, 0, :3]
    bpy.data.images.remove(image)
    colour = np.array(bpy.context.preferences.themes[0].user_interface.wcol_tool.inner[:3])
    same = np.abs(column - colour).max(axis=1) < 0.02
    edges = np.flatnonzero(np.diff(np.concatenate(([False], same, [False])).astype(int)))
    runs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [top + (low + high) // 2 for low, high in runs if high - low >= LARGE]


def click(number: int = 0, where: float = 0.5, until: Callable[[], object] | None = None) -> Steps:
    """Press one of the sidebar's large buttons with the mouse; a second time where nothing comes of it.

    Parameters
    ----------
    number : int
        Which of them, from the top, those that are disabled not counted.
    where : float
        How far to the right, of the sidebar's width: of two buttons in a row.
    until : callable, optional
        Whether the press has had its effect; that a job runs, or has reported, where left out.
    """
    told = len(seen["reports"])
    until = until or (lambda: job() is not None or len(seen["reports"]) > told)
    for attempt in range(2):
        yield from redrawn()
        places, region = large_buttons(), view()["region"]
        check(len(places) > number, f"{len(places)} large buttons are shown: which is no. {number + 1}?")
        x, before, begin = region.x + int(where * (region.width - 30)), Drawn.count["UI"], time.monotonic()
        for shift in (0, 2):  # a button has to notice the mouse before it is pressed, and lights up
            xdotool("mousemove", str(x + shift), str(places[number]))
            yield from pause(0.1)
        while Drawn.count["UI"] == before and time.monotonic() - begin < 3.0:
            yield
        xdotool("click", "1")
        begin = time.monotonic()
        while not until() and time.monotonic() - begin < (15.0 if attempt == 0 else LIMIT):
            yield
        xdotool("mousemove", *REST)
        if until():
            return
        seen["pressed_again"] = seen.get("pressed_again", 0) + 1
    check(False, f"large button no. {number + 1} was pressed, and nothing came of it")


def call(operator: Any, how: str = "EXEC_DEFAULT", window: Any = None, **options: Any) -> set[str]:
    """Call an operator as a button in the sidebar does, with an undo step of its own."""
    with bpy.context.temp_override(**view(window)):
        return operator(how, True, **options)


def started() -> Steps:
    """Wait for a job, and for its first word of progress."""
    yield from wait("a job to start", lambda: job() is not None)
    running = job()
    yield from wait("first progress", lambda: running.fraction > 0 or job() is not running)


def start(window: Any = None) -> Steps:
    """Morph, without the mouse, and wait for the first word of progress."""
    result = call(bpy.ops.femors.morph, "INVOKE_DEFAULT", window)
    check(result == {"RUNNING_MODAL"}, f"the button gave {result}")
    yield from started()


def select(*names: str) -> None:
    """Select these alone, the first one active."""
    for item in bpy.context.view_layer.objects:
        item.select_set(item.name in names)
    bpy.context.view_layer.objects.active = bpy.data.objects[names[0]] if names else None


def clear() -> None:
    """Take all objects away."""
    for item in list(bpy.data.objects):
        bpy.data.objects.remove(item)


def frame(selected: bool = False) -> None:
    """Show all objects, or those selected."""
    with bpy.context.temp_override(**viewport()):
        (bpy.ops.view3d.view_selected if selected else bpy.ops.view3d.view_all)()


# --- the sidebar ------------------------------------------------------------------------------
def show_panel() -> Steps:
    """Open the sidebar at the tab FEMORS."""
    view()["area"].spaces.active.show_region_ui = True
    yield from wait("the sidebar", lambda: view()["region"].width > 1)
    yield from pause(0.2)
    view()["region"].active_panel_category = "FEMORS"
    yield from redrawn()


class Panels:
    """The extension's own panels while others stand in for them, and those others."""

    own: list[type] = []  # noqa: RUF012
    standing: list[type] = []  # noqa: RUF012
    round = 0


def only(*names: str, advanced: bool = False) -> Steps:
    """Show these panels alone, open, with all that is below them; without names, all as they were.

    A script cannot unfold a panel, and Blender remembers those that it has seen: others with new names
    stand in.
    """
    put_back()
    if names:
        Panels.round += 1
        Panels.own = list(module("ui").CLASSES)
        Panels.own = [cls for cls in Panels.own if issubclass(cls, bpy.types.Panel)]
        for cls in reversed(Panels.own):
            bpy.utils.unregister_class(cls)
        for cls in Panels.own:
            parent = getattr(cls, "bl_parent_id", "")
            if (parent or cls.bl_idname).removeprefix("FEMORS_PT_") in names:
                folded = "advanced" in cls.bl_idname and not advanced
                changed: dict[str, Any] = {
                    "bl_idname": f"{cls.bl_idname}_{Panels.round}",
                    "bl_options": {"DEFAULT_CLOSED"} if folded else set(),
                }
                if parent:
                    changed["bl_parent_id"] = f"{parent}_{Panels.round}"
                stand = type(changed["bl_idname"], (cls,), changed)
                bpy.utils.register_class(stand)
                Panels.standing.append(stand)
    yield from show_panel()


def put_back() -> None:
    """Give the extension its own panels back: it takes them out itself as it ends."""
    for cls in reversed(Panels.standing):
        bpy.utils.unregister_class(cls)
    for cls in Panels.own:
        bpy.utils.register_class(cls)
    Panels.own, Panels.standing = [], []
