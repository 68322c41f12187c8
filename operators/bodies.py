# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies for the removal of overclosures: which objects they are, and their nodes as arrays.

A body is read as it is seen: shape keys at their values, in world coordinates; modifiers do not count.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import bpy

from ..femors_addon.progress import FemorsError, counted
from . import body_names, deck_scene, deck_store, scene
from .deck_nodes import PartShot
from .lazy import Array, np
from .scene import Snapshot

if TYPE_CHECKING:
    from ..femors_addon.bodies import Body
    from ..femors_addon.deck import Deck


# --- which ------------------------------------------------------------------------------------------
def chosen(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the panel's bodies: of its collection, or of its list, or the selection if that is empty."""
    form = context.scene.femors_overclosure
    if form.bodies_from == "COLLECTION":
        return [] if form.collection is None else meshes_in(form.collection)
    # a deleted object that the list still points at stays in the file, in no scene
    listed = [row.item for row in form.bodies if row.item is not None and row.item.users_scene]
    return listed or selected(context)


def selected(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the selected meshes by name."""
    return sorted((o for o in context.selected_objects if o.type == "MESH"), key=lambda item: item.name)


def meshes_in(collection: bpy.types.Collection) -> list[bpy.types.Object]:
    """Return the meshes of a collection and of those in it, by name."""
    return sorted((o for o in collection.all_objects if o.type == "MESH"), key=lambda item: item.name)


def found(context: bpy.types.Context, names: str, collection: str) -> list[bpy.types.Object]:
    """Return the bodies that an operator was called with.

    Raises
    ------
    FemorsError
        No such object or collection, not a mesh, or fewer than two.
    """
    if names:
        items = [scene.find(name, "body") for name in body_names.split(names)]
    elif collection:
        group = bpy.data.collections.get(collection)
        if group is None:
            raise FemorsError(f"There is no collection named '{collection}'")
        items = meshes_in(group)
    else:
        items = selected(context)
    if len(items) < 2:
        raise FemorsError(f"{counted(len(items), 'mesh object')} chosen as bodies: at least two are needed")
    return items


def is_linked(item: bpy.types.Object) -> bool:
    """Whether an object's mesh cannot be written: it is linked from another file, or overrides one."""
    return any(b.library is not None or b.override_library is not None for b in (item, item.data))


def share_of(item: bpy.types.Object) -> float:
    """Return how much of the way a body takes: its share, 0 where it is rigid or linked."""
    return 0.0 if is_linked(item) or item.femors.role == "RIGID" else item.femors.share


def shares(items: list[bpy.types.Object], rigid: str, given: str) -> list[float]:
    """Return the share of each body: its own, but for those that the caller names.

    Of two bodies, of which one is given a share, the other takes the rest of 1, unless it is rigid.

    Raises
    ------
    FemorsError
        No such body, a share outside 0 to 1, or of a linked body.
    """
    out = {item.name: share_of(item) for item in items}
    for name in body_names.split(rigid):
        body_names.known(name, out, "Rigid")
        out[name] = 0.0
    linked = {item.name for item in items if is_linked(item)}
    named = body_names.numbers(given, out, "Shares")
    if len(out) == 2 and len(named) == 1:
        other = next(name for name in out if name not in named)
        out[other] = min(max(1.0 - next(iter(named.values())), 0.0), 1.0) if out[other] else 0.0
    for name, share in named.items():
        if share and name in linked:
            raise FemorsError(f"'{name}' is linked from another file and cannot be moved: it must be rigid")
        out[name] = share
    return [out[item.name] for item in items]


# --- read -------------------------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True, eq=False)
class BodyShot:
    """A body as it was when a job began: arrays and names, no reference into Blender.

    Attributes
    ----------
    seen : Snapshot
        Its base, and its matrix.
    share : float
    local : (n, 3) float64
        Positions by vertex in the object's own space, with shape keys at their values.
    part : PartShot or None
        Where it is a part of a deck.
    archive : bytes
        The zip of its deck.
    """

    seen: Snapshot
    share: float
    local: Array
    part: PartShot | None = None
    archive: bytes = b""

    @property
    def name(self) -> str:
        """Of the object."""
        return self.seen.name


def shot(context: bpy.types.Context, item: bpy.types.Object, share: float) -> BodyShot:
    """Read a body.

    Raises
    ------
    FemorsError
        As `scene.snapshot`; absolute shape keys; a deck that is gone or no longer fits.
    """
    keys = item.data.shape_keys
    if keys is not None and not keys.use_relative:
        raise FemorsError(f"'{item.name}' has absolute shape keys: make them relative")
    seen = scene.snapshot(context, item)
    local = local_positions(item)
    bad = int((~np.isfinite(local).all(axis=1)).sum())
    if bad:
        raise FemorsError(
            f"'{item.name}': the shape keys take {counted(bad, 'vertex', 'vertices')} to places "
            "that are not finite"
        )
    if not deck_store.is_part(item):
        return BodyShot(seen, share, local)
    return BodyShot(seen, share, local, deck_scene.shot(item, keys=True), deck_store.archive_of(item))


def local_positions(item: bpy.types.Object) -> Array:
    """Return (n, 3) float64 positions in the object's own space, shape keys at their values."""
    keys = deck_scene.shape_keys(item)
    if len(keys) == 1 and keys[0].whole:  # the key itself, not a sum that rounds
        return keys[0].shape.positions.astype(np.float64)
    out = scene.base_positions(item.data).astype(np.float64)
    for key in keys:
        weight: Any = key.value if key.weights is None else key.value * key.weights[:, None]
        out = out + weight * (key.shape.positions.astype(np.float64) - key.relative.positions)
    return out


def unchanged(context: bpy.types.Context, before: BodyShot) -> bpy.types.Object:
    """Return the object of a body, as it is now.

    Raises
    ------
    FemorsError
        It was deleted, renamed, edited or moved since, or its shape keys were.
    """
    item = scene.unchanged(context, before.seen)
    now = local_positions(item)
    if now.shape != before.local.shape or not np.array_equal(now, before.local):
        raise FemorsError(
            f"The shape keys of '{before.name}' were changed while the job ran: nothing was changed, "
            "run it again"
        )
    return item


# --- for the worker -----------------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True, eq=False)
class Model:
    """A body as the core has it, and the way back to the object's vertices.

    Attributes
    ----------
    body : Body
        In world coordinates.
    rows : (k,) int
        The vertex of each of the body's nodes.
    deck : Deck or None
        Where it is a part of one.
    members : (k,) int
        The node of the deck that each of the body's nodes is.
    """

    shot: BodyShot
    body: Body
    rows: Array
    deck: Deck | None = None
    members: Array | None = None

    def local(self, nodes: Array) -> tuple[Array, Array | None]:
        """Return local float64 positions of nodes (k, 3): by vertex, and by node of a deck's part.

        What did not move keeps its very bits.
        """
        out = self.shot.local.copy()
        moved = (nodes != self.body.nodes).any(axis=1)
        if self.deck is None or self.shot.part is None:
            out[self.rows[moved]] = self.shot.seen.to_local(nodes[moved])
            return out, None
        part, known = self.shot.part.of(self.deck), self.shot.part.nodes(self.deck)
        known[np.searchsorted(part.nodes, self.members)[moved]] = self.shot.seen.to_local(nodes[moved])
        out[self.shot.part.vertices(self.deck)] = known
        return out, known

    def held(self, local: Array) -> Body:
        """Return the body as Blender will have it: with local positions in single precision."""
        from ..femors_addon.transforms import transformed

        rounded = local[self.rows].astype(np.float32).astype(np.float64)
        nodes = transformed(self.shot.seen.matrix, rounded)
        return dataclasses.replace(self.body, mesh=self.body.mesh.moved(nodes))

    def by_vertex(self, values: Array, rest: float) -> Array:
        """Return values (k,) of the body's nodes by vertex; `rest` for vertices that are none."""
        out = np.full(len(self.shot.local), rest)
        out[self.rows] = values
        return out

    @property
    def rounding(self) -> float:
        """By how much single precision can move a vertex beyond what the core's certificate allows for.

        The core counts on the rounding of world coordinates; an object with a transform has others.
        """
        matrix = self.shot.seen.matrix
        if self.body.share == 0 or np.array_equal(matrix, np.eye(4)):
            return 0.0
        near = float(np.abs(self.shot.local).max()), float(np.abs(self.body.nodes).max())
        own, world = (float(np.spacing(np.float32(size))) for size in near)
        return own * float(np.linalg.norm(matrix[:3, :3], 2)) + world


def models(shots: list[BodyShot]) -> list[Model]:
    """Return the bodies for the core; a pure function, for the worker.

    Raises
    ------
    FemorsError
        A deck that no longer fits its object, or a mesh that is no surface.
    """
    decks = {archive: deck_store.unpacked(archive) for archive in {one.archive for one in shots} if archive}
    return [_model(one, decks.get(one.archive)) for one in shots]


def _model(one: BodyShot, deck: Deck | None) -> Model:
    from ..femors_addon.bodies import Body
    from ..femors_addon.mesh import Surface
    from ..femors_addon.transforms import transformed

    matrix = one.seen.matrix
    mirrored = np.linalg.det(matrix[:3, :3]) < 0
    if deck is None or one.part is None:
        surface = Surface(transformed(matrix, one.local), one.seen.triangles)
        return Model(one, Body(one.name, surface, one.share), np.arange(len(one.local)))
    part, vertex = one.part.of(deck), one.part.vertices(deck)
    coordinates = np.array(deck.coordinates)
    coordinates[part.nodes] = transformed(matrix, one.part.nodes(deck))
    mesh, members = deck.with_coordinates(coordinates).submesh(part)
    if mirrored:
        blocks = (dataclasses.replace(b, nodes=b.nodes[:, b.shape.mirrored]) for b in mesh.blocks)
        mesh = dataclasses.replace(mesh, blocks=tuple(blocks))
    rows = vertex[np.searchsorted(part.nodes, members)]
    return Model(one, Body(one.name, mesh, one.share), rows, deck, members)
