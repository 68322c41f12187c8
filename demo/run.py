# SPDX-License-Identifier: GPL-3.0-or-later
"""``make demo``: two bones of its own making, one morphed onto the other by the real operator.

    .venv/bin/python demo/run.py [--out demo_output] [--nodes 3000] [--no-picture]
    blender -b --factory-startup --python demo/run.py -- [the same]

Writes femors_demo.blend, femors_demo.stl, femors_demo.png and report.json, and says where. The two
bones are meshed independently, but the target's shape is a known smooth map of the source's, so that
the error of every vertex is known and goes into the report.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import importlib
import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
if os.environ.get("FEMORS_SITE"):  # SciPy, for a blender binary that has none
    sys.path.append(os.environ["FEMORS_SITE"])

from checkout import PACKAGE, Checkout

SOURCE, TARGET = "Source bone", "Target bone"


def arguments() -> argparse.Namespace:
    """Read the command line; inside a blender binary, what stands after ``--``."""
    parser = argparse.ArgumentParser(prog="demo", description="Morph one made-up bone onto another")
    parser.add_argument("--out", type=Path, default=Path("demo_output"), help="folder for the results")
    parser.add_argument("--nodes", type=int, default=3000, help="vertices of the source, about")
    parser.add_argument("--samples", type=int, default=16, help="of the picture, per pixel")
    parser.add_argument("--width", type=int, default=1600, help="of the picture, in pixels")
    parser.add_argument("--no-picture", action="store_true", help="leave the rendering out")
    inside = "--" in sys.argv
    embedded = Path(sys.argv[0]).suffix == ".py"
    return parser.parse_args(
        sys.argv[sys.argv.index("--") + 1 :] if inside else sys.argv[1:] if embedded else []
    )


def add_object(name: str, surface: Any) -> Any:
    """Make a mesh object of a surface, shaded smooth."""
    import bpy

    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(surface.vertices.tolist(), [], surface.faces.tolist())
    mesh.shade_smooth()
    item = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(item)
    return item


def colour_parts(item: Any) -> None:
    """Colour head, trochanter and condyles of the plain femur, as a user may mark regions: an attribute."""
    z = np.array([v.co[:] for v in item.data.vertices])
    head = np.linalg.norm(z - (-14, 4, 377), axis=1) < 25
    trochanter = np.linalg.norm((z - (43, -5, 343)) / (14, 20, 27), axis=1) < 1.12
    condyles = z[:, 2] < 38
    colour = np.tile((0.86, 0.78, 0.64, 1.0), (len(z), 1))
    for where, rgb in (
        (head, (0.80, 0.24, 0.16)),
        (trochanter, (0.90, 0.55, 0.10)),
        (condyles, (0.10, 0.42, 0.50)),
    ):
        colour[where, :3] = rgb
    attribute = item.data.color_attributes.new("parts", "FLOAT_COLOR", "POINT")
    attribute.data.foreach_set("color", colour.astype(np.float32).ravel())


def positions(item: Any) -> np.ndarray:
    """Return an object's vertices (n, 3) in the world."""
    out = np.empty(3 * len(item.data.vertices), dtype=np.float32)
    item.data.vertices.foreach_get("co", out)
    matrix = np.array(item.matrix_world)
    return out.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def figures(item: Any, truth: np.ndarray, wall: float) -> dict[str, Any]:
    """Return the morph's own report and the error against the true place of each vertex."""
    error = np.linalg.norm(positions(item) - truth, axis=1)
    known = {"median": np.median(error), "p99": np.percentile(error, 99), "maximum": error.max()}
    return {
        **json.loads(item.femors.report),
        "error_against_known_correspondence": {key: round(float(value), 4) for key, value in known.items()},
        "wall_seconds": round(wall, 2),
    }


def morph(core: ModuleType, nodes: int) -> tuple[Any, Any, Any, dict[str, Any]]:
    """Build the scene and run the operator; return source, target, result and figures."""
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True)
    units = bpy.context.scene.unit_settings
    units.system, units.scale_length, units.length_unit = "METRIC", 0.001, "MILLIMETERS"
    pair = core.pair(nodes, int(1.15 * nodes), seed=2, strength=2.0, posed=True)
    source, target = add_object(SOURCE, pair.source), add_object(TARGET, pair.target)
    colour_parts(source)
    begin = time.perf_counter()
    bpy.ops.femors.morph(source=SOURCE, target=TARGET)
    wall = time.perf_counter() - begin
    result = bpy.context.view_layer.objects.active
    return source, target, result, figures(result, pair.truth, wall)


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Lead what Blender itself writes to stdout (a line for each part of a picture) into nothing.

    Errors, on stderr and as exceptions, still show. Blender writes past Python's stream, so the
    file descriptor below both is turned.
    """
    sys.stdout.flush()
    kept = os.dup(1)
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.close(null)
    try:
        yield
    finally:
        with contextlib.suppress(AttributeError, OSError, TypeError):  # C's own buffer too
            ctypes.CDLL(None).fflush(None)
        os.dup2(kept, 1)
        os.close(kept)


def write(options: argparse.Namespace, objects: tuple[Any, Any, Any], report: dict[str, Any]) -> list[Path]:
    """Write the files and return their paths."""
    import bpy

    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / name for name in ("femors_demo.blend", "femors_demo.stl", "report.json")]
    bpy.ops.wm.stl_export(filepath=str(paths[1]), export_selected_objects=True)
    paths[2].write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    if not options.no_picture:
        import picture

        scene = picture.compose(*objects, report)
        paths.append(out / "femors_demo.png")
        print("Rendering the picture ...", flush=True)
        with silenced():
            picture.render(scene, paths[-1], options.samples, options.width)
    # the target coincides with the result: seen as wire, both can be told apart
    objects[1].display_type = "WIRE"
    bpy.ops.wm.save_as_mainfile(filepath=str(paths[0]), compress=True)
    return paths


def main() -> int:
    """Run the demonstration."""
    options = arguments()
    checkout = Checkout()
    try:
        import bpy
    except ModuleNotFoundError:
        print("Blender is missing: run `make setup`, which installs it into .venv as bpy", file=sys.stderr)
        return 1
    checkout.enable()
    try:
        print(f"Blender {bpy.app.version_string}: morphing one made-up bone onto another ...", flush=True)
        core = importlib.import_module(f"{PACKAGE}.femors_addon.shapes")
        source, target, result, report = morph(core, options.nodes)
        paths = write(options, (source, target, result), report)
    finally:
        checkout.disable()
    after, error = report["after"], report["error_against_known_correspondence"]
    distance = after["target_to_surface"]  # the other way is zero: the last step lays nodes on the target
    print(f"Done in {report['wall_seconds']} s: {report['stop_reason']}.")
    print(f"  target to result, surface   median {distance['median']:.3f}, max {distance['maximum']:.2f} mm")
    print(f"  nodes to their true places  median {error['median']:.2f}, 99 % {error['p99']:.2f} mm")
    print(f"  flipped faces {after['flipped']}, self-intersections {after['self_intersecting']}")
    print("Written:")
    for path in paths:
        print(f"  {path}  ({path.stat().st_size / 1024:.0f} kB)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
