# SPDX-License-Identifier: GPL-3.0-or-later
"""Any object that has points, as points in the world; and its copy at other places.

Meshes, curves, point clouds, armatures and empties are read alike: `points_of` gives their points in an
order that `copy_of` and `shape_key_of` know.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy
from mathutils import Matrix, Vector

from ..femors_addon.progress import FemorsError
from . import placing, scene
from .lazy import Array, np

CLOUDS = ("POINTCLOUD", "CURVES")  # whose points are an attribute
KINDS = ("MESH", "CURVE", "SURFACE", *CLOUDS, "ARMATURE", "EMPTY")
CONVERTED = {"META": "a mesh", "FONT": "a mesh", "GREASEPENCIL": "a mesh", "GPENCIL": "a curve"}
"""What Object > Convert makes of other kinds; the last is the grease pencil of Blender 4.2."""


def points_of(item: bpy.types.Object, matrix: Array) -> Array:
    """Return the (p, 3) float64 world points of an object.

    Raises
    ------
    FemorsError
        A kind of object without points that could be carried, or one that has none.
    """
    if item.type not in KINDS:
        kind = item.bl_rna.properties["type"].enum_items[item.type].name.lower()
        known = CONVERTED.get(item.type)
        remedy = f"convert it to {known}" if known else "carry an empty in its place"
        raise FemorsError(f"'{item.name}' is of type {kind}, which cannot be carried: {remedy}")
    if item.mode == "EDIT":
        raise FemorsError(f"'{item.name}' is in Edit Mode: leave it first (Tab)")
    local = _local(item).astype(np.float64)
    if not len(local):
        raise FemorsError(f"'{item.name}' has no points to be carried")
    if not np.isfinite(local).all():
        raise FemorsError(f"'{item.name}' has coordinates that are not finite: repair or delete them")
    return local @ matrix[:3, :3].T + matrix[:3, 3]


def _local(item: bpy.types.Object) -> Array:
    if item.type == "MESH":
        return scene.base_positions(item.data)
    if item.type in CLOUDS:
        return _read(item.data.attributes["position"].data, "vector", 3)
    if item.type == "ARMATURE":
        ends = [end for bone in item.data.bones for end in (bone.head_local, bone.tail_local)]
        return np.array([tuple(end) for end in ends], dtype=np.float64).reshape(-1, 3)
    if item.type == "EMPTY":
        return np.zeros((1, 3))
    parts = [_read(points, name, size)[:, :3] for points, name, size in _spline_points(item.data)]
    return np.concatenate(parts) if parts else np.empty((0, 3))


def _read(points: Any, name: str, size: int) -> Array:
    out = np.empty(size * len(points), dtype=np.float32)
    points.foreach_get(name, out)
    return out.reshape(-1, size)


def _spline_points(curve: bpy.types.Curve) -> list[tuple[Any, str, int]]:
    """Everything in a curve that has positions: (collection, attribute, numbers in it)."""
    out: list[tuple[Any, str, int]] = []
    for spline in curve.splines:
        if spline.type == "BEZIER":
            points = spline.bezier_points
            out += [(points, name, 3) for name in ("handle_left", "co", "handle_right")]
        else:
            out.append((spline.points, "co", 4))
    return out


def copy_of(
    context: bpy.types.Context, item: bpy.types.Object, name: str, world: Array, matrix: Array
) -> bpy.types.Object:
    """Make a copy of an object with its points at `world` (p, 3); or raise and leave nothing."""
    copy = item.copy()
    data = None if item.data is None else item.data.copy()
    try:
        copy.name = name
        if data is not None:
            copy.data = data
            data.name = name
        inverse = np.linalg.inv(matrix)
        local = world @ inverse[:3, :3].T + inverse[:3, 3]
        placing.place(context, copy, item)
        copy.animation_data_clear()  # it would be where its keys say, not where it was carried
        _freed(context, copy, matrix)
        if item.type == "MESH":
            if data.shape_keys is not None:
                copy.shape_key_clear()
            data.vertices.foreach_set("co", np.ascontiguousarray(local, dtype=np.float32).ravel())
            data.update()
        elif item.type in CLOUDS:
            data.attributes["position"].data.foreach_set("vector", local.astype(np.float32).ravel())
        elif item.type == "ARMATURE":
            _write_bones(context, copy, local)
        elif item.type == "EMPTY":
            context.view_layer.update()
            placed = copy.matrix_world.copy()
            if any(above.type == "MESH" for above in _above(copy)):
                copy.parent = None  # what is below a mesh moves with it, and its children are its landmarks
            placed.translation = Vector(world[0])
            copy.matrix_world = placed
        else:
            _write_splines(data, local)
    except Exception:
        remove(copy, data)
        raise
    return copy


def _above(item: bpy.types.Object) -> Iterator[bpy.types.Object]:
    """Yield an object's parent, its parent's, and so on."""
    while (item := item.parent) is not None:
        yield item


def _freed(context: bpy.types.Context, copy: bpy.types.Object, matrix: Array) -> None:
    """Take a copy's constraints away, which would hold it back, and leave it where they had put it."""
    if not len(copy.constraints):
        return
    copy.constraints.clear()
    context.view_layer.update()
    copy.matrix_world = Matrix(matrix)
    context.view_layer.update()
    if not np.allclose(
        copy.matrix_world, matrix, rtol=1e-4, atol=1e-4 * max(1.0, float(np.abs(matrix).max()))
    ):
        raise FemorsError("its constraints shear it: apply them first (Object > Apply > Visual Transform)")


def remove(item: bpy.types.Object, data: Any) -> None:
    """Take back an object that was made, and its data."""
    bpy.data.objects.remove(item)
    if data is not None and not data.users:
        bpy.data.batch_remove([data])


def _write_splines(curve: bpy.types.Curve, local: Array) -> None:
    if curve.shape_keys is not None:
        raise FemorsError("a curve with shape keys cannot be carried: apply or delete them first")
    for spline in curve.splines:  # handles that Blender places by itself would not stay where they are put
        for point in spline.bezier_points:
            point.handle_left_type = point.handle_right_type = "FREE"
    start = 0
    for points, name, size in _spline_points(curve):
        values = _read(points, name, size)
        values[:, :3] = local[start : start + len(points)]
        points.foreach_set(name, values.ravel())
        start += len(points)
    curve.update_tag()


def _write_bones(context: bpy.types.Context, item: bpy.types.Object, local: Array) -> None:
    """Bones can be moved in Edit Mode only, which the active object alone can enter."""
    layer = context.view_layer
    layer.update()
    if item.name not in layer.objects:
        raise FemorsError(f"'{item.name}' is in no collection of this view layer, where bones can be edited")
    names = [bone.name for bone in item.data.bones]
    active, selected = layer.objects.active, list(context.selected_objects)
    item.hide_viewport = False
    item.hide_set(False)
    layer.objects.active = item
    with context.temp_override(active_object=item, object=item, selected_objects=[item]):
        bpy.ops.object.mode_set(mode="EDIT")
        try:
            for row, name in enumerate(names):
                bone = item.data.edit_bones[name]
                roll = bone.roll
                bone.head, bone.tail = Vector(local[2 * row]), Vector(local[2 * row + 1])
                bone.roll = roll
        finally:
            bpy.ops.object.mode_set(mode="OBJECT")
    layer.objects.active = active
    for other in context.selected_objects:
        other.select_set(other in selected)
