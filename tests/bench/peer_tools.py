# SPDX-License-Identifier: GPL-3.0-or-later
"""What users would pick instead: each takes the aligned pair and returns the source's moved vertices.

Run by `bench_peers` in a process of its own: ``python peer_tools.py NAME IN.npz OUT.npz``. Set as well as we
could (../shared/notes/peers.md); every tool may do better in the hands of those who made it.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from typing import Any

import numpy as np

SOFT = [[0.01, 0, 0.5, 10], [0.005, 0, 0.5, 10], [0.002, 0, 0, 10], [0.0005, 0, 0, 10]]
RBF = ((200, 6), (800, 6), (2500, 6))  # centres, iterations
RBF_STEP, RBF_NEIGHBOURS = 0.75, 60
CPD_POINTS, CPD_UNIT, CPD_SIGMA = 3000, 10.0, 5.0  # mm

Pair = dict[str, Any]


def amberg(pair: Pair, steps: list[list[float]] | None = None) -> np.ndarray:
    """trimesh's non-rigid ICP after Amberg et al."""
    import trimesh

    source, target = (
        trimesh.Trimesh(pair[f"{side}_vertices"], pair[f"{side}_faces"], process=False)
        for side in ("source", "target")
    )
    return np.asarray(trimesh.registration.nricp_amberg(source, target, steps=steps))


def amberg_soft(pair: Pair) -> np.ndarray:
    """The same with softer and softer steps, the strongest peer of the table."""
    return amberg(pair, SOFT)


def rbf(pair: Pair) -> np.ndarray:
    """Thin-plate splines on SciPy's RBFInterpolator, on more and more centres, as in the paper."""
    import trimesh
    from scipy.interpolate import RBFInterpolator

    target = trimesh.Trimesh(pair["target_vertices"], pair["target_faces"], process=False)
    points = pair["source_vertices"].copy()
    for count, iterations in RBF:
        chosen = slice(None, None, max(len(points) // count, 1))
        for _ in range(iterations):
            centres = points[chosen]
            found = trimesh.proximity.closest_point(target, centres)[0]
            field = RBFInterpolator(centres, RBF_STEP * (found - centres), neighbors=RBF_NEIGHBOURS)
            points = points + field(points)
    return points


def cpd(pair: Pair) -> np.ndarray:
    """pycpd's deformable registration of some points, carried to all."""
    from pycpd import DeformableRegistration
    from scipy.spatial.distance import cdist

    ours, theirs = (pair[f"{side}_vertices"] / CPD_UNIT for side in ("source", "target"))
    some = [points[:: max(len(points) // CPD_POINTS, 1)] for points in (theirs, ours)]
    register = DeformableRegistration(
        X=some[0], Y=some[1], sigma2=(CPD_SIGMA / CPD_UNIT) ** 2, max_iterations=60
    )
    register.register()
    # its own transform_point_cloud takes no other points than those that it was made with
    kernel = np.exp(-cdist(ours, some[1], "sqeuclidean") / (2.0 * register.beta**2))
    return np.asarray(ours + kernel @ register.W) * CPD_UNIT


def shrinkwrap(pair: Pair) -> np.ndarray:
    """Blender's modifier, onto the nearest surface point."""
    import bpy

    objects = []
    for side in ("source", "target"):
        mesh = bpy.data.meshes.new(side)
        mesh.from_pydata(pair[f"{side}_vertices"].tolist(), [], pair[f"{side}_faces"].tolist())
        objects.append(bpy.data.objects.new(side, mesh))
        bpy.context.scene.collection.objects.link(objects[-1])
    modifier = objects[0].modifiers.new("wrap", "SHRINKWRAP")
    modifier.target, modifier.wrap_method = objects[1], "NEAREST_SURFACEPOINT"
    moved = objects[0].evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    out = np.empty(3 * len(moved.vertices), np.float32)
    moved.vertices.foreach_get("co", out)
    return out.reshape(-1, 3).astype(float)


TOOLS = {
    "shrinkwrap": shrinkwrap,
    "rbf": rbf,
    "amberg_soft": amberg_soft,
    "amberg": amberg,
    "cpd": cpd,
}


def main() -> int:
    """Run one tool on a pair in a file; print seconds and memory as JSON."""
    name, given, wanted = sys.argv[1:]
    with np.load(given) as data:
        pair = dict(data)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    cpu, wall = time.process_time(), time.perf_counter()
    vertices = TOOLS[name](pair)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    peak = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    np.savez(wanted, vertices=vertices)
    print(json.dumps({"seconds": cpu, "wall": wall, "megabytes": peak}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
