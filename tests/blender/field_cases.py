# SPDX-License-Identifier: GPL-3.0-or-later
"""What a field has carried in Blender, as tests look at it."""

from __future__ import annotations

import numpy as np

FIELD = "Femur to Scan"


def put_group(item, name: str, weights: dict[int, float]) -> None:
    group = item.vertex_groups.new(name=name)
    for vertex, weight in weights.items():
        group.add([vertex], weight, "REPLACE")


def weights_of(item, name: str) -> np.ndarray:
    index = item.vertex_groups[name].index
    out = np.zeros(len(item.data.vertices))
    for vertex in item.data.vertices:
        for member in vertex.groups:
            if member.group == index:
                out[vertex.index] = member.weight
    return out


def area(item, points: np.ndarray, weights: np.ndarray) -> float:
    """Weighted area of a mesh, by Blender's triangles."""
    item.data.calc_loop_triangles()
    faces = np.array([tuple(t.vertices) for t in item.data.loop_triangles])
    a, b, c = np.moveaxis(points[faces], 1, 0)
    size = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return float((size * weights[faces].mean(axis=1)).sum())
