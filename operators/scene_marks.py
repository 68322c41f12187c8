# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks of meshes: vertex groups of one vertex, and empties that are children."""

from __future__ import annotations

import bpy

from ..femors_addon.progress import FemorsError
from . import marks
from .lazy import Array


def landmarks_of(item: bpy.types.Object, mesh: bpy.types.Mesh, world: Array) -> dict[str, Array]:
    """Return, by name, the world positions of an object's landmarks: groups of one vertex, and empties.

    Raises
    ------
    FemorsError
        Two of one name.
    """
    points = {name: world[vertex] for name, vertex in _vertices(item, mesh).items()}
    children = marks.children(item)
    twice = sorted(set(points) & set(children))
    if twice:
        raise FemorsError(
            f"'{item.name}' has the landmark '{twice[0]}' twice, as a vertex group and as an empty: "
            "rename one of them"
        )
    return points | children


def _vertices(item: bpy.types.Object, mesh: bpy.types.Mesh) -> dict[str, int]:
    """Return, by name, the vertex of each vertex group that has exactly one in the base mesh.

    In an evaluated mesh, whose modifiers may have spread the weight, the heaviest vertex stands for it.
    """
    count = [0] * len(item.vertex_groups)
    for vertex in item.data.vertices:
        for member in vertex.groups:
            count[member.group] += 1
    heaviest: dict[int, tuple[float, int]] = {}
    for vertex in mesh.vertices:
        for member in vertex.groups:
            if count[member.group] == 1 and member.weight >= heaviest.get(member.group, (0.0, 0))[0]:
                heaviest[member.group] = (member.weight, vertex.index)
    return {g.name: heaviest[g.index][1] for g in item.vertex_groups if g.index in heaviest}
