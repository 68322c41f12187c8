# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's meshes as arrays: the only module that reads geometry (`result` writes it back)."""

from __future__ import annotations

import dataclasses

import bpy

from ..femors_addon.progress import FemorsError, counted
from . import scene_marks
from .lazy import Array, np


@dataclasses.dataclass(frozen=True, eq=False)
class Snapshot:
    """A mesh object as it was when a job began: arrays and names, no reference into Blender.

    Attributes
    ----------
    name, library : str
        The object's name and, for linked data, its library's path ("" for local data).
    evaluated : bool
        Whether modifiers and shape key sliders are included.
    vertices : (n, 3) float64
        World coordinates.
    triangles : (m, 3) int32
        Quads split on a fixed diagonal, larger polygons as Blender draws them; wound as they are seen where
        the object is mirrored.
    matrix : (4, 4) float64
        Local to world.
    read : tuple of arrays
        Positions, polygon sizes, corner vertices and transform as they were, to see whether they change.
    weights : (n,) float64 or None
        Of the vertex group that was asked for.
    landmarks : dict of str to (3,) float64
        World positions of the vertex groups with one vertex, where they were asked for.
    """

    name: str
    library: str
    evaluated: bool
    vertices: Array
    triangles: Array
    matrix: Array
    read: tuple[Array, ...]
    weights: Array | None = None
    landmarks: dict[str, Array] = dataclasses.field(default_factory=dict)

    def to_local(self, world: Array) -> Array:
        """Return world positions (n, 3) as float64 positions in the object's own space."""
        inverse = np.linalg.inv(self.matrix)
        return world @ inverse[:3, :3].T + inverse[:3, 3]


def find(name: str, role: str) -> bpy.types.Object:
    """Return the mesh object of this name, the local one where a linked one has the same name.

    Raises
    ------
    FemorsError
        No name, no such object in any scene, or not a mesh.
    """
    if not name:
        raise FemorsError(f"No {role} chosen: pick a mesh object, or pass {role}='<object name>'")
    found = bpy.data.objects.get((name, None)) or bpy.data.objects.get(name)
    if found is None or not found.users_scene:
        raise FemorsError(f"There is no object named '{name}' to be the {role}")
    if found.type != "MESH":
        kind = found.bl_rna.properties["type"].enum_items[found.type].name.lower()
        raise FemorsError(f"The {role} '{name}' is of type {kind}: choose a mesh, or convert it to one")
    return found


def snapshot(
    context: bpy.types.Context,
    item: bpy.types.Object,
    evaluated: bool = False,
    group: str = "",
    landmarks: bool = False,
) -> Snapshot:
    """Read a mesh object into arrays, in world coordinates.

    Parameters
    ----------
    evaluated : bool
        Read the mesh with its modifiers and shape keys applied, otherwise its base (the Basis).
    group : str
        Vertex group whose weights are read, "" for none.
    landmarks : bool
        Read the vertex groups with one vertex as landmarks.

    Raises
    ------
    FemorsError
        No faces, coordinates that are not finite, a transform that flattens the object, no such
        vertex group, or modifiers that Blender does not evaluate, the object being disabled.
    """
    depsgraph = context.evaluated_depsgraph_get()
    if item.mode == "EDIT":
        item.update_from_editmode()
    matrix = world_matrix(item, depsgraph)
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) < 1e-30:
        raise FemorsError(
            f"'{item.name}' is scaled to zero in some direction: correct its scale (Alt+S resets it)"
        )
    mesh = evaluated_mesh(item, depsgraph) if evaluated else item.data
    try:
        positions, sizes, corners, triangles = _arrays(mesh, item.name)
        world = positions.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        weights = group_weights(item, mesh, group) if group else None
        points = scene_marks.landmarks_of(item, mesh, world) if landmarks else {}
    finally:
        if evaluated:
            bpy.data.meshes.remove(mesh)
    if np.linalg.det(matrix[:3, :3]) < 0:  # Blender shows the other side of faces that are mirrored
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    for array in (world, triangles, matrix, positions, sizes, corners):
        array.setflags(write=False)
    library = item.library.filepath if item.library else ""
    return Snapshot(
        item.name,
        library,
        evaluated,
        world,
        triangles,
        matrix,
        (positions, sizes, corners, matrix),
        weights=weights,
        landmarks=points,
    )


def unchanged(context: bpy.types.Context, before: Snapshot) -> bpy.types.Object:
    """Return the object of a snapshot, as it is now.

    Raises
    ------
    FemorsError
        It was deleted, renamed, edited or moved since.
    """
    item = bpy.data.objects.get((before.name, before.library or None))
    # an object that only a picker still points at stays in the file without a scene
    if item is None or item.type != "MESH" or not item.users_scene:
        raise FemorsError(f"'{before.name}' was deleted or renamed while the job ran: nothing was changed")
    try:
        now = snapshot(context, item, before.evaluated).read
    except FemorsError:
        now = ()
    if not now or not all(map(np.array_equal, now, before.read)):
        raise FemorsError(
            f"'{before.name}' was edited or moved while the job ran: nothing was changed, run it again"
        )
    return item


def evaluated_mesh(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bpy.types.Mesh:
    """Return a new mesh data-block with the object's modifiers and shape keys applied."""
    seen = item.evaluated_get(depsgraph)
    if not seen.is_evaluated:
        raise FemorsError(
            f"'{item.name}' is disabled or outside this view layer, so Blender does not evaluate its "
            "modifiers: enable it, or untick Use Modifiers"
        )
    return bpy.data.meshes.new_from_object(seen, preserve_all_data_layers=True, depsgraph=depsgraph)


def world_matrix(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Array:
    """Return (4, 4) float64 local to world, also where Blender does not keep `matrix_world` fresh.

    Objects that are disabled or outside the view layer keep an old `matrix_world`; theirs is made
    from their parents. (Their constraints count as they were last seen.)
    """
    if item.evaluated_get(depsgraph).is_evaluated or item.constraints or item.parent_type != "OBJECT":
        return np.array(item.matrix_world, dtype=np.float64)
    own = np.array(item.matrix_basis, dtype=np.float64)
    if item.parent is None:
        return own
    inverse = np.array(item.matrix_parent_inverse, dtype=np.float64)
    return world_matrix(item.parent, depsgraph) @ inverse @ own


def base_positions(mesh: bpy.types.Mesh) -> Array:
    """Return the (n, 3) float32 positions of a mesh without shape key sliders: those of its Basis."""
    out = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    if mesh.shape_keys:
        mesh.shape_keys.reference_key.data.foreach_get("co", out)
    else:
        mesh.vertices.foreach_get("co", out)
    return out.reshape(-1, 3)


def polygons(mesh: bpy.types.Mesh) -> tuple[Array, Array]:
    """Return the number of corners of each polygon (m,), and the vertex of each corner (k,), int32.

    By arrays, where Blender has them: by properties, a window would stand still for a moment.
    """
    corners = np.empty(len(mesh.loops), dtype=np.int32)
    attribute = mesh.attributes.get(".corner_vert")
    if attribute is not None and len(attribute.data) == len(corners):
        attribute.data.foreach_get("value", corners)
    else:  # in Edit Mode
        mesh.loops.foreach_get("vertex_index", corners)
    sizes = np.full(len(mesh.polygons), 3, dtype=np.int32)
    if len(corners) != 3 * len(sizes):  # else all are triangles, for none has fewer corners
        mesh.polygons.foreach_get("loop_total", sizes)
    return sizes, corners


def _arrays(mesh: bpy.types.Mesh, name: str) -> tuple[Array, Array, Array, Array]:
    """Return positions, polygon sizes, corner vertices and triangles of a mesh."""
    positions = base_positions(mesh)
    sizes, corners = polygons(mesh)
    if not len(sizes):
        raise FemorsError(f"'{name}' has no faces: a surface mesh is needed")
    bad = int((~np.isfinite(positions).all(axis=1)).sum())
    if bad:
        raise FemorsError(
            f"'{name}': {bad} of {len(positions)} vertices with coordinates that are not finite: "
            "repair or delete them"
        )
    return positions, sizes, corners, _triangles(mesh, sizes, corners)


def _triangles(mesh: bpy.types.Mesh, sizes: Array, corners: Array) -> Array:
    from ..femors_addon.mesh import triangulate

    large = sizes > 4
    if not large.any():
        return triangulate(sizes, corners)[0]
    small = ~large
    triangles, _ = triangulate(sizes[small], corners[np.repeat(small, sizes)])
    # a fan would fold over itself in a concave polygon, so these are cut as Blender draws them
    count = len(mesh.loop_triangles)
    vertices = np.empty(3 * count, dtype=np.int32)
    mesh.loop_triangles.foreach_get("vertices", vertices)
    polygon = np.empty(count, dtype=np.int32)
    mesh.loop_triangles.foreach_get("polygon_index", polygon)
    return np.concatenate((triangles, vertices.reshape(-1, 3)[large[polygon]]))


def group_weights(item: bpy.types.Object, mesh: bpy.types.Mesh, name: str) -> Array:
    """Return (n,) float64 weights of a vertex group on the object's mesh, 0 outside of the group.

    Raises
    ------
    FemorsError
        No such group, or no vertex with a weight.
    """
    group = item.vertex_groups.get(name)
    if group is None:
        raise FemorsError(f"'{item.name}' has no vertex group named '{name}'")
    weights = np.zeros(len(mesh.vertices))
    for vertex in mesh.vertices:
        for member in vertex.groups:
            if member.group == group.index:
                weights[vertex.index] = member.weight
    if not weights.any():
        raise FemorsError(
            f"The vertex group '{name}' of '{item.name}' has no vertex with a weight: nothing may move"
        )
    return weights


def all_group_weights(item: bpy.types.Object) -> dict[str, Array]:
    """Return by name the (n,) float64 weights of each vertex group of an object's base mesh."""
    groups = list(item.vertex_groups)
    out = {group.name: np.zeros(len(item.data.vertices)) for group in groups}
    by_index = {group.index: out[group.name] for group in groups}
    for vertex in item.data.vertices:
        for member in vertex.groups:
            if member.group in by_index:
                by_index[member.group][vertex.index] = member.weight
    return out


def paired_landmarks(source: Snapshot, target: Snapshot) -> tuple[Array, Array, list[str]]:
    """Return (k, 3) and (k, 3) world positions of the landmarks that both objects have, and their names.

    Raises
    ------
    FemorsError
        Fewer than three pairs.
    """
    names = [name for name in source.landmarks if name in target.landmarks]
    if len(names) < 3:
        raise FemorsError(
            f"{counted(len(names), 'landmark pair')} between '{source.name}' and '{target.name}', "
            "at least 3 are "
            "needed: make vertex groups of one vertex each, with the same names on both"
        )
    ours, theirs = (np.array([shot.landmarks[name] for name in names]) for shot in (source, target))
    return ours, theirs, names
