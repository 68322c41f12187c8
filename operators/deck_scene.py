# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of decks as Blender objects: built at import, read for a morph or an export."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import bpy
from mathutils import Matrix

from ..femors_addon.progress import FemorsError
from .deck_nodes import Key, PartShot, Shape
from .lazy import Array, np
from .scene import base_positions, group_weights

if TYPE_CHECKING:
    from ..femors_addon.deck import Deck, Part
    from ..femors_addon.volume import Sets

NODE_ID = "node_id"
"""Point attribute: the deck's number of each node. Vertices are known by it, in whatever order."""
KNOWN, KNOWN_KEYS = "femors_nodes", "femors_keys"
"""Custom properties of a mesh: float64 positions by node, of the mesh and by name of its shape keys."""


# --- built ------------------------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """A part's mesh as arrays: made before anything in the file is changed."""

    name: str
    positions: Array
    ids: Array
    sizes: Array
    corners: Array
    groups: dict[str, Array]
    places: tuple[tuple[str, Array], ...]


def plan(deck: Deck, key: str, part: Part) -> Plan:
    """Return what the objects of a part are made from.

    Raises
    ------
    FemorsError
        Coordinates or node numbers beyond what Blender holds.
    """
    mesh, nodes = deck.submesh(part)
    with np.errstate(over="ignore"):
        positions = deck.coordinates[part.nodes].astype(np.float32)
    ids = deck.mesh.node_ids[part.nodes]
    if not np.isfinite(positions).all():
        raise FemorsError(f"{deck.path}: '{key}' has coordinates beyond 3e38, which Blender does not hold")
    if ids.max(initial=0) >= 2**31 or ids.min(initial=0) < -(2**31):
        raise FemorsError(f"{deck.path}: '{key}' has node numbers beyond Blender's 2147483647")
    polygons = mesh.boundary
    corners = np.searchsorted(part.nodes, nodes)[polygons.corners]
    return Plan(key, positions, ids, polygons.sizes, corners, _groups(deck, key, part), _places(deck, key))


def _places(deck: Deck, key: str) -> tuple[tuple[str, Array], ...]:
    """Return object name and matrix for each instance of a part; one at the origin where there is none."""
    mine = [i for i in deck.instances if key.upper() in (i.part.upper(), i.name.upper())]
    if len(mine) == 1:
        return ((key, mine[0].matrix),)
    return tuple((instance.name, instance.matrix) for instance in mine) or ((key, np.eye(4)),)


def _groups(deck: Deck, key: str, part: Part) -> dict[str, Array]:
    """Return vertices by name for the node sets, element sets and surfaces that a part has members in."""
    mesh = deck.mesh
    out: dict[str, Array] = {}
    kinds = {"nodes": mesh.node_sets, "elements": _as_nodes(deck, part), "surface": mesh.surfaces}
    for kind, sets in kinds.items():
        for name, members in sets.items():
            inside = np.flatnonzero(np.isin(part.nodes, members))
            if not len(inside) or (kind == "elements" and len(inside) == len(part.nodes)):
                continue  # an element set that is the whole part says nothing
            if name in out and np.array_equal(out[name], inside):
                continue
            out[name if name not in out else f"{name} ({kind})"] = inside
    return out


def _as_nodes(deck: Deck, part: Part) -> Sets:
    """Return the nodes (by index) of the members that each element set has in a part."""
    mesh = deck.mesh
    out = {}
    mine = np.zeros(mesh.element_count, dtype=bool)
    mine[part.elements] = True
    for name, members in mesh.element_sets.items():
        chosen = members[mine[members]]
        if 0 < len(chosen) < len(part.elements):
            block_of = np.searchsorted(mesh.starts, chosen, side="right") - 1
            rows = [(mesh.blocks[b], chosen[block_of == b] - mesh.starts[b]) for b in np.unique(block_of)]
            out[name] = np.unique(np.concatenate([block.nodes[row].ravel() for block, row in rows]))
    return out


def build(
    context: bpy.types.Context, name: str, text: bpy.types.Text, plans: list[Plan]
) -> list[bpy.types.Object]:
    """Make a collection with one object per part, or per instance of it (they share the mesh)."""
    collection = bpy.data.collections.new(name)
    items: list[bpy.types.Object] = []
    meshes: list[bpy.types.Mesh] = []
    try:
        for one in plans:
            mesh = bpy.data.meshes.new(one.name)
            meshes.append(mesh)
            _fill(mesh, one)
            mesh.femors.deck, mesh.femors.part = text, one.name
            for label, matrix in one.places:
                item = bpy.data.objects.new(label, mesh)
                items.append(item)
                item.matrix_world = Matrix(matrix.tolist())
                collection.objects.link(item)
            for label, members in one.groups.items():
                # names and weights are the mesh's: they hold for every instance
                items[-1].vertex_groups.new(name=label).add(members.tolist(), 1.0, "REPLACE")
        context.scene.collection.children.link(collection)
    except Exception:
        for item in items:
            bpy.data.objects.remove(item)
        for mesh in meshes:
            bpy.data.meshes.remove(mesh)
        bpy.data.collections.remove(collection)
        raise
    return items


def _fill(mesh: bpy.types.Mesh, one: Plan) -> None:
    """Write vertices, faces and node numbers into a new mesh."""
    mesh.vertices.add(len(one.positions))
    mesh.vertices.foreach_set("co", one.positions.ravel())
    mesh.loops.add(len(one.corners))
    mesh.loops.foreach_set("vertex_index", one.corners.astype(np.int32))
    mesh.polygons.add(len(one.sizes))
    starts = np.cumsum(one.sizes) - one.sizes
    mesh.polygons.foreach_set("loop_start", starts.astype(np.int32))
    mesh.update(calc_edges=True)
    mesh.validate(clean_customdata=False)  # a deck may hold an element twice, Blender no face
    attribute = mesh.attributes.new(NODE_ID, "INT", "POINT")
    attribute.data.foreach_set("value", one.ids.astype(np.int32))


# --- read -------------------------------------------------------------------------------------------
def shot(item: bpy.types.Object, keys: bool = False) -> PartShot:
    """Read an object's vertices as nodes.

    Parameters
    ----------
    keys : bool
        With the shape keys at their values, as it is seen; otherwise the base alone.

    Raises
    ------
    FemorsError
        Edit Mode, the node numbers are gone, or the shape keys cannot be summed up.
    """
    if item.mode == "EDIT":  # Blender has no attributes there
        raise FemorsError(f"'{item.name}' is in Edit Mode: leave it first (Tab)")
    mesh = item.data
    attribute = mesh.attributes.get(NODE_ID)
    if attribute is None or (attribute.data_type, attribute.domain) != ("INT", "POINT"):
        raise FemorsError(f"'{item.name}' has lost its attribute '{NODE_ID}': undo that, or import it again")
    ids = np.empty(len(mesh.vertices), dtype=np.int32)
    attribute.data.foreach_get("value", ids)
    base = Shape(base_positions(mesh), _known(mesh.get(KNOWN)))
    offsets = shape_keys(item) if keys else ()
    if len(offsets) == 1 and offsets[0].whole:
        base, offsets = offsets[0].shape, ()  # the key itself, not a sum that rounds
    return PartShot(item.name, mesh.femors.part, ids, base, offsets)


def shape_keys(item: bpy.types.Object) -> tuple[Key, ...]:
    """Return the shape keys of an object that count, as it is seen; also of one that is not of a deck."""
    keys = item.data.shape_keys
    if keys is None:
        return ()
    if not keys.use_relative:
        raise FemorsError(f"'{item.name}' has absolute shape keys: make them relative to export it")
    blocks = [keys.key_blocks[item.active_shape_key_index]] if item.show_only_shape_key else keys.key_blocks
    out = []
    for block in blocks:
        value = 1.0 if item.show_only_shape_key else block.value
        if block == keys.reference_key or block.mute or not value:
            continue
        weights = None
        if block.vertex_group in item.vertex_groups:
            weights = group_weights(item, item.data, block.vertex_group)
        shapes = (_key_shape(item.data, one) for one in (block, block.relative_key))
        whole = value == 1.0 and weights is None and block.relative_key == keys.reference_key
        out.append(Key(*shapes, value, weights, whole))
    return tuple(out)


def _key_shape(mesh: bpy.types.Mesh, block: bpy.types.ShapeKey) -> Shape:
    positions = np.empty(3 * len(block.data), dtype=np.float32)
    block.data.foreach_get("co", positions)
    reference = block == mesh.shape_keys.reference_key
    held = mesh.get(KNOWN) if reference else mesh.get(KNOWN_KEYS, {}).get(block.name)
    return Shape(positions.reshape(-1, 3), _known(held))


def _known(held: Any) -> Array | None:
    if not isinstance(held, bytes) or len(held) % 24:
        return None
    return np.frombuffer(held, dtype="<f8").reshape(-1, 3)


def remember(mesh: bpy.types.Mesh, nodes: Array, key: str = "") -> None:
    """Keep the float64 positions (n, 3), by node, that were written to a mesh, or to a shape key of it."""
    data = np.ascontiguousarray(nodes, dtype="<f8").tobytes()
    if key and KNOWN_KEYS not in mesh:
        mesh[KNOWN_KEYS] = {}
    holder, name = (mesh[KNOWN_KEYS], key) if key else (mesh, KNOWN)
    if name in holder:
        del holder[name]  # Blender writes bytes over bytes only up to a zero byte
    holder[name] = data


def forget_keys(mesh: bpy.types.Mesh) -> None:
    """Drop what was kept of shape keys that a copy has not."""
    if KNOWN_KEYS in mesh:
        del mesh[KNOWN_KEYS]
