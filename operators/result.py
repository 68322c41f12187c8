# SPDX-License-Identifier: GPL-3.0-or-later
"""Morphed positions back into Blender: as a new object, a shape key, or in place."""

from __future__ import annotations

import bpy

from ..femors_addon.progress import FemorsError, counted
from . import placing
from .lazy import Array, np
from .scene import Snapshot, evaluated_mesh

KEY_PREFIX = "Morphed to "


def check_writable(source: bpy.types.Object, kind: str, evaluated: bool) -> None:
    """Raise `FemorsError` where a result of this kind cannot be written to the source."""
    if kind == "NEW":
        return
    word = "shape key" if kind == "SHAPE_KEY" else "change in place"
    for block in (source, source.data):
        if block.library is not None or block.override_library is not None:
            raise FemorsError(
                f"'{source.name}' is linked from another file, so no {word}: choose New Object as result"
            )
    if source.mode == "EDIT":
        raise FemorsError(f"'{source.name}' is in Edit Mode: leave it first (Tab)")
    if evaluated and any(modifier.show_viewport for modifier in source.modifiers):
        raise FemorsError(
            f"'{source.name}' has modifiers, which a {word} cannot contain: "
            "choose New Object as result, apply them, or untick Use Modifiers"
        )
    keys = source.data.shape_keys
    if kind == "IN_PLACE" and keys is not None:
        raise FemorsError(f"'{source.name}' has shape keys: choose Shape Key or New Object as result")
    if kind == "SHAPE_KEY" and keys is not None and not keys.use_relative:
        raise FemorsError(
            f"'{source.name}' has absolute shape keys: make them relative, or choose New Object"
        )


def check_groups(target: bpy.types.Object) -> None:
    """Raise `FemorsError` where an object cannot be given vertex groups."""
    for block in (target, target.data):
        if block.library is not None or block.override_library is not None:
            raise FemorsError(
                f"'{target.name}' is linked from another file and takes no vertex groups: make it local first"
            )
    if target.mode == "EDIT":
        raise FemorsError(f"'{target.name}' is in Edit Mode: leave it first (Tab)")


def new_object(
    context: bpy.types.Context,
    source: bpy.types.Object,
    before: Snapshot,
    local: Array,
    attributes: dict[str, Array],
    name: str,
    inside_out: bool,
) -> bpy.types.Object:
    """Make a morphed copy of the source beside it, select it and return it; or raise and leave nothing.

    Everything on the source stays: materials, UVs, vertex groups, attributes, parent, animation (a copy
    of it), and modifiers unless they are part of the evaluated mesh. Shape keys, which belong to the
    old shape, do not.

    Parameters
    ----------
    local : (n, 3)
        Positions in the object's own space.
    attributes : dict of str to (n,)
        Written as point attributes.
    inside_out : bool
        The shape was mirrored: turn the faces, so that their normals still point outward.
    """
    mesh = (
        evaluated_mesh(source, context.evaluated_depsgraph_get()) if before.evaluated else source.data.copy()
    )
    item = source.copy()
    try:
        item.data = mesh
        item.name = mesh.name = name
        if before.evaluated:
            item.modifiers.clear()
        if mesh.shape_keys is not None:
            item.shape_key_clear()
        _write_positions(mesh, local)
        if inside_out:
            mesh.flip_normals()
        _write_attributes(mesh, attributes)
        placing.place(context, item, source)
        _show(context, item)
        for block in (item, mesh):
            _own_animation(block)
    except Exception:
        bpy.data.objects.remove(item)
        bpy.data.meshes.remove(mesh)
        raise
    return item


def _own_animation(block: bpy.types.ID) -> None:
    """Give a copied block copies of its actions, as Duplicate does: a copy alone shares them."""
    animation = block.animation_data
    if animation is None:
        return
    strips = [strip for track in animation.nla_tracks for strip in track.strips]
    for user in (animation, *strips):
        if user.action is None:
            continue
        slot = getattr(user, "action_slot", None)  # Blender 4.4 and later
        slot = slot.identifier if slot else None
        user.action = user.action.copy()
        if slot is not None:
            user.action_slot = user.action.slots[slot]


def _show(context: bpy.types.Context, item: bpy.types.Object) -> None:
    """Make a new object visible, selected and active, as Blender's own operators do."""
    item.hide_viewport = False
    item.hide_render = False
    layer = context.view_layer
    layer.update()  # until then it does not know the new object
    if not placing.seen(layer, item):  # its collections are switched off in this view layer
        return
    for other in context.selected_objects:
        other.select_set(False)
    item.hide_set(False)
    space = context.space_data
    if space is not None and space.type == "VIEW_3D" and space.local_view is not None:
        item.local_view_set(space, True)
    item.select_set(True)
    layer.objects.active = item


def shape_key(
    source: bpy.types.Object,
    local: Array,
    attributes: dict[str, Array],
    target_name: str,
    prefix: str = KEY_PREFIX,
) -> str:
    """Add a shape key with the morphed positions, at value 1; return what else there is to say."""
    note = single_user(source)
    mesh = source.data
    _write_attributes(mesh, attributes)
    if mesh.shape_keys is None:
        source.shape_key_add(name="Basis", from_mix=False)
    for earlier in mesh.shape_keys.key_blocks:
        if earlier.name.startswith(prefix):
            earlier.value = 0.0  # two morphs at full value would add up to a third shape
    key = source.shape_key_add(name=prefix + target_name, from_mix=False)
    key.data.foreach_set("co", np.ascontiguousarray(local, dtype=np.float32).ravel())
    key.value = 1.0
    source.active_shape_key_index = len(mesh.shape_keys.key_blocks) - 1
    mesh.update()
    others = [k.name for k in mesh.shape_keys.key_blocks[1:] if k != key and k.value and not k.mute]
    if others:
        note += f"; the shape key '{others[0]}' is not at 0 and adds to the new one"
    return note


def in_place(source: bpy.types.Object, local: Array, attributes: dict[str, Array], inside_out: bool) -> str:
    """Move the source's own vertices; return what else there is to say."""
    note = single_user(source)
    _write_attributes(source.data, attributes)
    _write_positions(source.data, local)
    if inside_out:
        source.data.flip_normals()
    return note


def single_user(source: bpy.types.Object) -> str:
    """Give the source a mesh of its own where other objects use the same; say so."""
    mesh = source.data
    others = mesh.users - int(mesh.use_fake_user) - 1
    if others < 1:
        return ""
    source.data = mesh.copy()
    return (
        f"; its mesh was shared with {counted(others, 'other object')}, so '{source.name}' has "
        "its own copy now"
    )


def _write_positions(mesh: bpy.types.Mesh, local: Array) -> None:
    """Write local positions (n, 3) to a mesh without shape keys."""
    if len(local) != len(mesh.vertices):
        raise FemorsError(
            f"the mesh has {len(mesh.vertices)} vertices and the result {len(local)}: run it again"
        )
    mesh.vertices.foreach_set("co", np.ascontiguousarray(local, dtype=np.float32).ravel())
    mesh.update()


def _write_attributes(mesh: bpy.types.Mesh, attributes: dict[str, Array]) -> None:
    for name, values in attributes.items():
        point_attribute(mesh, name, values)


def point_attribute(mesh: bpy.types.Mesh, name: str, values: Array) -> None:
    """Write (n,) floats as a point attribute, in place of an earlier one of that name."""
    attribute = mesh.attributes.get(name)
    if attribute is not None and (attribute.data_type, attribute.domain) != ("FLOAT", "POINT"):
        mesh.attributes.remove(attribute)
        attribute = None
    if attribute is None:
        attribute = mesh.attributes.new(name, "FLOAT", "POINT")
    attribute.data.foreach_set("value", np.ascontiguousarray(values, dtype=np.float32))
