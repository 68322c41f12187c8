# SPDX-License-Identifier: GPL-3.0-or-later
"""A morph from a script, and how tests look at what it made."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector

RESULTS = ("NEW", "SHAPE_KEY", "IN_PLACE")


def morph(**options):
    assert bpy.ops.femors.morph(source="Femur", target="Scan", **options) == {"FINISHED"}
    return bpy.context.view_layer.objects.active


def values(mesh, name: str) -> np.ndarray:
    out = np.empty(len(mesh.vertices), dtype=np.float32)
    mesh.attributes[name].data.foreach_get("value", out)
    return out


def key_positions(key) -> np.ndarray:
    out = np.empty(3 * len(key.data), dtype=np.float32)
    key.data.foreach_get("co", out)
    return out.reshape(-1, 3)


def off_target(points: np.ndarray, target) -> np.ndarray:
    """Distance of world points to the target's surface, found by Blender."""
    inverse = target.matrix_world.inverted()
    out = []
    for point in map(Vector, points):
        _, near, _, _ = target.closest_point_on_mesh(inverse @ point)
        out.append((target.matrix_world @ near - point).length)
    return np.array(out)
