#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Screenshots of Blender's window for the manual, taken under Xvfb while the tutorials run in it.

    ~/.cache/femors/blender/run-trixie python3 demo/window_pictures.py --site SITE --files FOLDER --out FOLDER

SITE is what ``tests/prepare_blender.sh`` prints, FILES what ``tutorial.py`` writes. The same file is the
story inside Blender, which finds its options in the environment.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
SIZE = (900, 880)
Steps = Iterator[None]
PANELS: list[Any] = []
STANDING: list[Any] = []
"""The extension's own panels, and those that stand in for them."""


# --- outside: start Xvfb and Blender ------------------------------------------------------------------
def main() -> int:
    """Start Blender with this file in a window of its own."""
    parser = argparse.ArgumentParser(description="Take the manual's screenshots")
    parser.add_argument("--site", required=True)
    parser.add_argument("--files", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--blender", default="blender")
    options = parser.parse_args()
    sys.path.insert(0, str(HERE.parent / "tests" / "window"))
    import run_window

    run_window.SIZE = SIZE
    server, display = run_window.start_display()
    with tempfile.TemporaryDirectory() as resources:
        environment = os.environ | {
            "DISPLAY": display,
            "BLENDER_USER_RESOURCES": resources,
            "TMPDIR": resources,
            "FEMORS_SITE": options.site,
            "FEMORS_FILES": str(options.files.resolve()),
            "FEMORS_WINDOW_OUT": str(options.out.resolve()),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        command = [options.blender, "--factory-startup", "--window-geometry", "0", "0", *map(str, SIZE)]
        try:
            done = subprocess.run([*command, "--python", __file__], env=environment, timeout=300, check=False)
        finally:
            server.terminate()
            server.wait()
    made = sorted(options.out.glob("window_*.png"))
    for path in made:
        print(f"{path}  ({path.stat().st_size / 1024:.0f} kB)")
    return done.returncode or (not made)


# --- inside: the story --------------------------------------------------------------------------------
def pause(seconds: float) -> Steps:
    """Let Blender draw."""
    start = time.monotonic()
    while time.monotonic() - start < seconds:
        yield


def view(bpy: Any) -> dict[str, Any]:
    """Return the context of the 3D view and its sidebar."""
    window = bpy.context.window_manager.windows[0]
    area = next(a for a in window.screen.areas if a.type == "VIEW_3D")
    return {"window": window, "area": area, "region": next(r for r in area.regions if r.type == "UI")}


def shot(bpy: Any, name: str, side: str = "BACK") -> Steps:
    """Write a screenshot."""
    with bpy.context.temp_override(**(view(bpy) | {"region": view(bpy)["area"].regions[-1]})):
        bpy.ops.view3d.view_axis(type=side)  # y is to the front of a body
        bpy.ops.view3d.view_all()
    yield from pause(1.5)
    path = Path(os.environ["FEMORS_WINDOW_OUT"]) / f"window_{name}.png"
    subprocess.run(["scrot", "--overwrite", str(path)], check=True)
    sys.path.insert(0, str(HERE))
    from smallpng import shrink

    shrink(path)


def call(bpy: Any, operator: Callable[..., set[str]], **options: Any) -> None:
    """Call an operator as the sidebar does, and let it run to its end."""
    with bpy.context.temp_override(**view(bpy)):
        operator("EXEC_DEFAULT", True, **options)


def only(bpy: Any, *names: str) -> None:
    """Select these, the last one active."""
    for item in bpy.context.view_layer.objects:
        item.select_set(item.name in names)
    bpy.context.view_layer.objects.active = bpy.data.objects[names[-1]]


def empty(bpy: Any) -> None:
    """Take all objects away; the window stays as it is."""
    for item in list(bpy.data.objects):
        bpy.data.objects.remove(item)
    units = bpy.context.scene.unit_settings
    units.system, units.scale_length, units.length_unit = "METRIC", 0.001, "MILLIMETERS"
    space = view(bpy)["area"].spaces.active
    space.clip_end = 10000.0
    space.shading.color_type = "OBJECT"
    space.overlay.show_floor = space.overlay.show_axis_x = space.overlay.show_axis_y = False


def load(bpy: Any, name: str, colour: tuple[float, ...] = (0.8, 0.74, 0.62, 1.0)) -> Any:
    """Import an STL file."""
    path = str(Path(os.environ["FEMORS_FILES"]) / name)
    with bpy.context.temp_override(**view(bpy)):
        bpy.ops.wm.stl_import(filepath=path)
    item = bpy.context.view_layer.objects.active
    item.color = colour
    return item


def story(bpy: Any) -> Steps:
    """Take all pictures."""
    from checkout import Checkout

    checkout = Checkout()
    yield from pause(1.0)
    checkout.enable()
    with bpy.context.temp_override(**view(bpy)):
        bpy.ops.screen.screen_full_area()
    yield from pause(1.0)
    space = view(bpy)["area"].spaces.active
    space.show_region_ui, space.show_region_toolbar, space.show_gizmo = True, False, False
    yield from pause(0.5)
    view(bpy)["region"].active_panel_category = "FEMORS"
    yield from pause(0.5)
    take_panels(bpy)
    yield from bones(bpy)
    yield from knee(bpy)
    give_back(bpy)
    checkout.disable()


def bones(bpy: Any) -> Steps:
    """The panels Morph and Transfer."""
    empty(bpy)
    load(bpy, "femur.stl")
    load(bpy, "scan.stl", (0.8, 0.45, 0.15, 1.0))
    only(bpy, "scan", "femur")
    call(bpy, bpy.ops.femors.pick_selection)
    unfolded(bpy, "FEMORS_PT_morph")
    yield from shot(bpy, "morph")
    call(bpy, bpy.ops.femors.morph, source="femur", target="scan", hide_target=True)
    yield from shot(bpy, "figures")
    only(bpy, "femur morphed to scan")
    bpy.data.objects["femur"].hide_set(True)
    call(bpy, bpy.ops.femors.show_heat, quantity="displacement")
    unfolded(bpy, "FEMORS_PT_heat")
    yield from shot(bpy, "heat")
    call(bpy, bpy.ops.femors.hide_heat)
    bpy.data.objects["femur"].hide_set(False)
    for name in ("gluteus", "iliopsoas"):
        load(bpy, f"{name}.stl", (0.1, 0.45, 0.55, 1.0))
    folder = os.environ["FEMORS_FILES"]
    call(bpy, bpy.ops.femors.import_landmarks, filepath=f"{folder}/landmarks.csv")
    bpy.context.scene.femors_transfer.what = "OBJECTS"
    names = [item.name for item in bpy.data.objects if item.type == "EMPTY"]
    sites = ["gluteus", "iliopsoas"]
    call(bpy, bpy.ops.femors.transfer, what="OBJECTS", objects=";".join([*names, *sites]))
    apart(bpy)
    bpy.context.scene.femors_transfer.mark = 2
    unfolded(bpy, "FEMORS_PT_transfer")
    yield from shot(bpy, "transfer", "FRONT")


def apart(bpy: Any) -> None:
    """Put what was carried beside the source, unselected, with one set of names, for the eye only."""
    for item in bpy.data.objects:
        item.select_set(False)
        if "carried" in item.name or item.name == "femur morphed to scan":
            item.location.x += 60.0
            item.show_name = False
        if item.name in ("notch", "epicondyle_medial"):
            item.show_name = False  # one would be written over the other


def knee(bpy: Any) -> Steps:
    """The panel Overclosure."""
    empty(bpy)
    bodies = [load(bpy, f"knee_{name}.stl") for name in ("femur", "tibia", "patella")]
    for item in bodies:
        item.femors.role = "RIGID"
    for name in ("femur", "tibia"):
        path = f"{os.environ['FEMORS_FILES']}/knee_cartilage_{name}.inp"
        call(bpy, bpy.ops.femors.import_deck, filepath=path)
    names = [item.name for item in bpy.data.objects if item.type == "MESH"]
    for name in names:
        if name.isupper():
            bpy.data.objects[name].color = (0.1, 0.45, 0.55, 1.0)
    only(bpy, *names)
    call(bpy, bpy.ops.femors.take_bodies)
    call(bpy, bpy.ops.femors.check_overclosure)
    bpy.context.scene.femors_overclosure.pair_index = 0
    yield from pause(0.5)
    unfolded(bpy, "FEMORS_PT_overclosure")
    yield from shot(bpy, "overclosure")


def unfolded(bpy: Any, shown: str) -> None:
    """Open one panel of the tab with what is below it, and fold the others.

    A panel cannot be opened by a script, and Blender remembers how it was: others of new names, open or
    folded by default, stand in for the pictures.
    """
    for cls in reversed(STANDING):
        bpy.utils.unregister_class(cls)
    STANDING.clear()
    for cls in PANELS:
        parent = getattr(cls, "bl_parent_id", "")
        mine = shown in (cls.bl_idname, parent)
        if parent and not mine:
            continue
        closed = not mine or "advanced" in cls.bl_idname
        changed = {
            "bl_idname": f"{cls.bl_idname}_{shown[10:]}",
            "bl_options": {"DEFAULT_CLOSED"} if closed else set(),
        }
        if parent:
            changed["bl_parent_id"] = f"{parent}_{shown[10:]}"
        stand = type(changed["bl_idname"], (cls,), changed)
        bpy.utils.register_class(stand)
        STANDING.append(stand)


def take_panels(bpy: Any) -> None:
    """Take the extension's own panels out, and remember them."""
    PANELS[:] = [getattr(bpy.types, name) for name in dir(bpy.types) if name.startswith("FEMORS_PT_")]
    PANELS.sort(key=lambda cls: (bool(getattr(cls, "bl_parent_id", "")), getattr(cls, "bl_order", 0)))
    for cls in reversed(PANELS):
        bpy.utils.unregister_class(cls)


def give_back(bpy: Any) -> None:
    """Put them back: the extension takes them out itself."""
    for cls in reversed(STANDING):
        bpy.utils.unregister_class(cls)
    for cls in PANELS:
        bpy.utils.register_class(cls)


def inside() -> None:
    """Run the story by a timer, then quit."""
    import traceback

    import bpy

    sys.path[:0] = [str(HERE)]
    sys.path.append(os.environ["FEMORS_SITE"])
    bpy.context.preferences.view.show_splash = False
    bpy.context.preferences.view.use_save_prompt = False
    steps = story(bpy)

    def tick() -> float | None:
        try:
            next(steps)
            return 0.05
        except StopIteration:
            pass
        except Exception:
            traceback.print_exc()
        bpy.ops.wm.quit_blender()
        return None

    bpy.app.timers.register(tick, first_interval=1.0, persistent=True)


if __name__ == "__main__":
    if "FEMORS_FILES" in os.environ:
        inside()
    else:
        sys.exit(main())
