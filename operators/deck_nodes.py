# SPDX-License-Identifier: GPL-3.0-or-later
"""From a mesh's single-precision vertices to a deck's double-precision nodes, and back. Without bpy.

A node is where it was known to be in float64 (in the deck, or by a morph of ours), plus what its vertex
has moved since: its float32 position less the float32 image of the known one. A vertex that nobody
touched gives the known position back, bit for bit.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from ..femors_addon.progress import FemorsError, counted
from .lazy import Array, np

if TYPE_CHECKING:
    from ..femors_addon.deck import Deck, Part


@dataclasses.dataclass(frozen=True, eq=False)
class Shape:
    """Vertex positions of a mesh or of a shape key.

    Attributes
    ----------
    positions : (n, 3) float32
        By vertex.
    known : (n, 3) float64 or None
        By node, as a morph left them; None for those of the deck.
    """

    positions: Array
    known: Array | None = None

    def nodes(self, vertex: Array, original: Array) -> Array:
        """Return (n, 3) float64 by node; `vertex` is that of each node, `original` the deck's positions."""
        known = original if self.known is None or self.known.shape != original.shape else self.known
        image = known.astype(np.float32)
        moved = self.positions[vertex].astype(np.float64) - image.astype(np.float64)
        return known + moved


@dataclasses.dataclass(frozen=True, eq=False)
class Key:
    """A shape key: its shape, that of the key that it is relative to, and how far it counts.

    Attributes
    ----------
    weights : (n,) or None
        By vertex, of its vertex group.
    whole : bool
        It takes the place of the base: at 1, everywhere, relative to the base.
    """

    shape: Shape
    relative: Shape
    value: float
    weights: Array | None = None
    whole: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class PartShot:
    """A part of a deck as an object has it; arrays and names, no reference into Blender.

    Attributes
    ----------
    name, part : str
        Of the object, of the part.
    ids : (n,) int32
        Node number of each vertex.
    base : Shape
    keys : tuple of Key
        Those that count, where they were asked for.
    """

    name: str
    part: str
    ids: Array
    base: Shape
    keys: tuple[Key, ...] = ()

    def of(self, deck: Deck) -> Part:
        """Return the deck's part; raise `FemorsError` where it has none of that name."""
        if self.part not in deck.parts:
            raise FemorsError(f"The deck of '{self.name}' has no part '{self.part}': import it again")
        return deck.parts[self.part]

    def vertices(self, deck: Deck) -> Array:
        """Return (n,) the vertex of each of the part's nodes.

        Raises
        ------
        FemorsError
            Nodes are missing, twice there, or not of this part: the mesh was edited.
        """
        expected = deck.mesh.node_ids[self.of(deck).nodes]
        mine, theirs = np.argsort(self.ids, kind="stable"), np.argsort(expected, kind="stable")
        if not np.array_equal(self.ids[mine], expected[theirs]):
            raise FemorsError(f"'{self.name}' {self._fault(expected)}; undo that, or import the deck again")
        out = np.empty(len(expected), dtype=np.int64)
        out[theirs] = mine
        return out

    def _fault(self, expected: Array) -> str:
        """Say in which way vertices and nodes do not agree."""
        gone = np.setdiff1d(expected, self.ids)
        if len(gone):
            return f"lacks {len(gone)} of the {len(expected)} nodes of '{self.part}' (the first: {gone[0]})"
        extra = len(self.ids) - len(expected)
        return (
            f"has {counted(extra, 'vertex that is no node', 'vertices that are no nodes')} of "
            f"'{self.part}' (added or duplicated)"
        )

    def nodes(self, deck: Deck) -> Array:
        """Return (n, 3) float64 positions of the part's nodes, shape keys included where there are some."""
        original = deck.coordinates[self.of(deck).nodes]
        vertex = self.vertices(deck)
        out = self.base.nodes(vertex, original)
        for key in self.keys:
            share: Any = key.value if key.weights is None else key.value * key.weights[vertex][:, None]
            out = out + share * (key.shape.nodes(vertex, original) - key.relative.nodes(vertex, original))
        return out


def together(deck: Deck, shots: list[PartShot]) -> Deck:
    """Return the deck with the nodes of several parts where their objects have them.

    A node that parts share goes with the one that moved it.

    Raises
    ------
    FemorsError
        Two parts moved a node that they share to different places.
    """
    coordinates = np.array(deck.coordinates)
    owner = np.full(len(coordinates), -1)
    for number, shot in enumerate(shots):
        at, nodes = shot.of(deck).nodes, shot.nodes(deck)
        before = deck.coordinates[at]
        moved = (nodes != before).any(axis=1)
        # both are rounded to single precision, each by itself
        close = 4 * np.spacing(np.abs(nodes).astype(np.float32)).max(axis=1)
        apart = np.abs(nodes - coordinates[at]).max(axis=1, initial=0.0) > close
        clash = np.flatnonzero(moved & (owner[at] >= 0) & apart)
        if len(clash):
            other = shots[owner[at[clash[0]]]]
            raise FemorsError(
                f"'{other.name}' and '{shot.name}' share {counted(len(clash), 'node')} (the first: "
                f"{deck.mesh.node_ids[at[clash[0]]]}) that they moved to different places; "
                "move them as one object, or export one of them"
            )
        mine = moved & (owner[at] < 0)
        coordinates[at[mine]] = nodes[mine]
        owner[at[mine]] = number
    return deck.with_coordinates(coordinates)
