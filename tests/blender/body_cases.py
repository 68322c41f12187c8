# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies that overlap in Blender, and how tests look at them."""

from __future__ import annotations

import json

import bpy
import numpy as np
import pytest
from mathutils import Matrix

GAP = 0.02
TRANSFORMS = {
    "turned": Matrix.Rotation(0.7, 4, (1, 2, 3)) @ Matrix.Translation((3, -2, 1)),
    "scaled": Matrix.Diagonal((0.01, 0.05, 3.0, 1.0)),
    "mirrored": Matrix.Diagonal((-1.0, 1.0, 1.0, 1.0)),
    "far": Matrix.Translation((5000, 0, -3000)),
    "all": Matrix.Translation((30, 1, 2)) @ Matrix.Rotation(2.0, 4, "Y") @ Matrix.Diagonal((-2, 0.3, 1.7, 1)),
}


def ball(tools, name, radius, place, rings=16, segments=24):
    vertices, faces = tools.sphere(rings, segments, (radius,) * 3)
    return tools.add_object(name, vertices + np.asarray(place), faces)


def seen(item) -> np.ndarray:
    """Return the vertices as Blender shows them, in world coordinates, float64."""
    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    out = np.empty(3 * len(evaluated.data.vertices), np.float32)
    evaluated.data.vertices.foreach_get("co", out)
    matrix = np.array(item.matrix_world, dtype=np.float64)
    return out.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def base(item) -> bytes:
    out = np.empty(3 * len(item.data.vertices), np.float32)
    item.data.vertices.foreach_get("co", out)
    return out.tobytes()


def triangles(item) -> np.ndarray:
    item.data.calc_loop_triangles()
    out = np.empty(3 * len(item.data.loop_triangles), np.int32)
    item.data.loop_triangles.foreach_get("vertices", out)
    return out.reshape(-1, 3)


def findings(core, *items, gap=GAP, **options):
    """Run the core's check on what Blender shows."""
    overclosure, mesh = core("overclosure"), core("mesh")
    bodies = [overclosure.Body(o.name, mesh.Surface(seen(o), triangles(o))) for o in items]
    settings = core("overclosure_settings").OverclosureSettings(gap=gap)
    return overclosure.check_overclosure(bodies, settings, **options)


def attribute(item, name="femors_gap") -> np.ndarray:
    held = item.data.attributes[name]
    out = np.empty(len(held.data), np.float32)
    held.data.foreach_get("value", out)
    return out


def form():
    return bpy.context.scene.femors_overclosure


def report() -> dict:
    return json.loads(form().report)


def remove(**options):
    arguments = {"bodies": "Ball;Cup", "gap": GAP} | options
    assert bpy.ops.femors.remove_overclosure(**arguments) == {"FINISHED"}
    return report()


def refused(match: str, tools, operator=None, **options) -> str:
    """Expect one line about `match`, and a file that is as it was."""
    operator = operator or bpy.ops.femors.remove_overclosure

    def state():
        meshes = [(o.name, base(o), [a.name for a in o.data.attributes]) for o in bpy.data.objects]
        return tools.census(), meshes, form().report, len(form().pairs)

    before = state()
    with pytest.raises(RuntimeError, match=match) as caught:
        operator(**{"bodies": "Ball;Cup"} | options)
    line = str(caught.value).removeprefix("Error: ").strip()
    assert "\n" not in line and "Traceback" not in line and "unexpected" not in line, line
    assert state() == before
    return line
