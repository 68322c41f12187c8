# SPDX-License-Identifier: GPL-3.0-or-later
"""What a heat map shows: a quantity of an object's mesh, by vertex or by polygon."""

from __future__ import annotations

from typing import Any

import bpy

from ..femors_addon.progress import FemorsError
from . import deck_scene, deck_store, scene
from .lazy import Array, np


def values_of(item: bpy.types.Object, key: str, other: bpy.types.Object | None = None) -> Array:
    """Return a quantity of an object's mesh: by vertex, or by polygon where faces have it.

    Raises
    ------
    FemorsError
        The mesh has not got it.
    """
    from ..femors_addon.quantities import QUANTITIES

    quantity, mesh = QUANTITIES[key], item.data
    if key == "scaled_jacobian" and deck_store.is_part(item):
        return _of_elements(item)
    if quantity.of_faces:
        return _of_faces(item, key)
    attribute = mesh.attributes.get(quantity.attribute)
    if attribute is not None and (attribute.data_type, attribute.domain) == ("FLOAT", "POINT"):
        out = np.empty(len(mesh.vertices), dtype=np.float32)
        attribute.data.foreach_get("value", out)
        return out
    if key == "gap" and other is not None and other != item:
        return _gap(item, other)
    hint = {
        "gap": "choose another mesh under Compare with, or remove an overclosure first",
        "surface_distance": "it comes with a morph's result: select that",
        "displacement": "it comes with a morph's result: select that",
    }[key]
    raise FemorsError(f"'{item.name}' has no {quantity.label.lower()} to be shown: {hint}")


def _world(item: bpy.types.Object) -> Array:
    positions = np.empty(3 * len(item.data.vertices), dtype=np.float32)
    item.data.vertices.foreach_get("co", positions)
    matrix = np.array(item.matrix_world, dtype=np.float64)
    return positions.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def surface_of(item: bpy.types.Object) -> tuple[Any, Array]:
    """Return an object's surface in world coordinates, and the polygon of each of its triangles."""
    from ..femors_addon.mesh import Surface, triangulate

    triangles, polygon = triangulate(*scene.polygons(item.data))
    if item.matrix_world.determinant() < 0:  # as in a snapshot
        triangles = triangles[:, ::-1]
    return Surface(_world(item), triangles), polygon


def _of_faces(item: bpy.types.Object, key: str) -> Array:
    from ..femors_addon.quantities import of_shape, worst

    surface, polygon = surface_of(item)
    return worst(key, of_shape(key, surface), polygon, len(item.data.polygons))


def _of_elements(item: bpy.types.Object) -> Array:
    """Return the worst scaled Jacobian of the elements at each vertex of a part of a deck."""
    from ..femors_addon.volume_quality import scaled_jacobians

    deck, shot = deck_store.unpacked(deck_store.archive_of(item)), deck_scene.shot(item)
    part, vertex = shot.of(deck), shot.vertices(deck)
    coordinates = np.array(deck.coordinates)
    coordinates[part.nodes] = shot.nodes(deck)
    mesh, nodes = deck.with_coordinates(coordinates).submesh(part)
    jacobians, worst = scaled_jacobians(mesh), np.ones(len(coordinates))
    for block, start in zip(mesh.blocks, mesh.starts[:-1].tolist(), strict=True):
        values = np.repeat(jacobians[start : start + len(block)], block.nodes.shape[1])
        np.minimum.at(worst, nodes[block.nodes.ravel()], values)
    out = np.ones(len(item.data.vertices))
    out[vertex] = worst[part.nodes]
    return out


def _gap(item: bpy.types.Object, other: bpy.types.Object) -> Array:
    from ..femors_addon.cleaning import clean
    from ..femors_addon.nearest import SurfaceIndex

    theirs, _ = surface_of(other)
    index = SurfaceIndex(clean(theirs.vertices, theirs.faces, other.name).surface)
    return index.signed(_world(item))
