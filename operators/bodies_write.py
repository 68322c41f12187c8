# SPDX-License-Identifier: GPL-3.0-or-later
"""Moved bodies back into Blender: as shape keys or in place, exact nodes of decks with them."""

from __future__ import annotations

import bpy

from ..femors_addon.progress import FemorsError
from . import bodies, deck_scene, result
from .lazy import Array, np

GAP = "femors_gap"
"""Point attribute: signed distance to the nearest other body, negative inside of it."""
KEY = "Overclosure removed"


def check_writable(item: bpy.types.Object, kind: str) -> None:
    """Raise `FemorsError` where a body cannot be moved in the way that was asked for."""
    if bodies.is_linked(item):
        raise FemorsError(f"'{item.name}' is linked from another file and cannot be moved: make it rigid")
    keys = item.data.shape_keys
    if kind == "IN_PLACE" and keys is not None:
        raise FemorsError(f"'{item.name}' has shape keys, so it cannot be moved in place: choose Shape Key")


def write(item: bpy.types.Object, kind: str, local: Array, known: Array | None) -> str:
    """Move a body's vertices; return what else there is to say.

    Parameters
    ----------
    local : (n, 3)
        Positions by vertex in the object's own space.
    known : (k, 3) or None
        Exact positions by node, of a part of a deck.
    """
    if kind == "SHAPE_KEY":
        note, key = _add_key(item, local)
    else:
        note, key = result.in_place(item, local, {}, False), ""
        deck_scene.forget_keys(item.data)
    if known is not None:
        deck_scene.remember(item.data, known, key)
    return note


def _add_key(item: bpy.types.Object, local: Array) -> tuple[str, str]:
    """Add a shape key that holds the whole shape, at 1, all others at 0; return a note and its name."""
    note = result.single_user(item)
    if item.data.shape_keys is None:
        item.shape_key_add(name="Basis", from_mix=False)
    keys = item.data.shape_keys
    counted = [key.name for key in keys.key_blocks if key.value and key != keys.reference_key]
    for earlier in keys.key_blocks:
        earlier.value = 0.0  # the new key was made from what they gave
    if any(not name.startswith(KEY) for name in counted):
        note += f"; the shape key '{counted[0]}' of '{item.name}' is part of the new one and is at 0 now"
    item.show_only_shape_key = False
    key = item.shape_key_add(name=KEY, from_mix=False)
    key.data.foreach_set("co", np.ascontiguousarray(local, dtype=np.float32).ravel())
    key.value = 1.0
    item.active_shape_key_index = len(keys.key_blocks) - 1
    item.data.update()
    return note, key.name


def write_gaps(items: dict[str, bpy.types.Object], gaps: dict[str, Array]) -> str:
    """Write the gap attribute of every body whose mesh is its own; say of which it could not be."""
    left = []
    meshes = [item.data for item in items.values()]
    for name, values in gaps.items():
        mesh = items[name].data
        if bodies.is_linked(items[name]) or meshes.count(mesh) > 1:
            left.append(f"'{name}'")
        else:
            result.point_attribute(mesh, GAP, values)
            mesh.update()
    return f"; no attribute {GAP} on {', '.join(left)} (linked or shared meshes)" if left else ""
