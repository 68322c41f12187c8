# SPDX-License-Identifier: GPL-3.0-or-later
"""A real pair of femurs, from their files through Blender's importer and the operator."""

from __future__ import annotations

import json
import os
from pathlib import Path

import bpy
import pytest

DATA = Path(os.environ.get("FEMORS_DATA") or Path(__file__).resolve().parents[3] / "shared" / "data")
LIMITS = {
    "surface_to_target": (0.02, 0.2, 1.0),
    "target_to_surface": (0.05, 0.30, 1.0),
    "hausdorff": (0.67, 1.20),
    "aspect": (1.215, 1.70, 2.4),
    "dihedral": (3.2, 22.0),
}
"""Median, 99th percentile and, where there is one, maximum: millimetres, ratios, degrees."""


def test_a_femur_onto_another(empty):
    folder = DATA / "femur_pair"
    if not folder.is_dir():
        pytest.skip(f"needs {folder}")
    for name in ("source", "target"):
        bpy.ops.wm.stl_import(filepath=str(folder / f"{name}.stl"))
        bpy.context.object.name = name
    vertices = len(bpy.data.objects["source"].data.vertices)
    assert bpy.ops.femors.morph(source="source", target="target") == {"FINISHED"}
    result = bpy.context.object
    assert len(result.data.vertices) == vertices
    report = json.loads(result.femors.report)
    after = report["after"]
    assert report["converged"], report["stop_reason"]
    assert (after["flipped"], after["self_intersecting"]) == (0, 0)
    for name, limits in LIMITS.items():
        seen = [after[name][key] for key in ("median", "p99", "maximum")[: len(limits)]]
        assert all(value <= limit for value, limit in zip(seen, limits, strict=True)), (name, seen, limits)
