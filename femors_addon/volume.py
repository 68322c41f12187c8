# SPDX-License-Identifier: GPL-3.0-or-later
"""Finite-element meshes as arrays: mixed elements, ids, sets, and the surface that encloses them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse import csgraph

from . import triples
from .cached import cached_property
from .mesh import Float, Int, Surface, frozen
from .progress import FemorsError
from .volume_faces import Block, Ids, Polygons, all_faces, outer_faces

__all__ = ["Block", "Polygons", "VolumeMesh", "carry_mid_nodes", "cut_down"]


TOPOLOGY = ("outer", "shells", "mid_nodes", "bodies", "element_ids", "used_nodes")

Sets = Mapping[str, Int]


@dataclasses.dataclass(frozen=True, eq=False)
class VolumeMesh:
    """A finite-element mesh: solid elements, shells, or both.

    Elements are counted through all blocks, from 0; sets name nodes and elements by these indices.

    Parameters
    ----------
    nodes : (n, 3) float64
        Positions; must be finite.
    blocks : tuple of Block
    node_ids : (n,) int64
        The deck's numbers; unique within a part of a deck.
    node_sets, element_sets : mapping of str to (k,) int32
    surfaces : mapping of str to (k,) int32
        The nodes of named surfaces.

    Raises
    ------
    FemorsError
        Coordinates that are not finite, or an element that names a node that is not there.
    """

    nodes: Float
    blocks: tuple[Block, ...]
    node_ids: Ids
    node_sets: Sets = dataclasses.field(default_factory=dict)
    element_sets: Sets = dataclasses.field(default_factory=dict)
    surfaces: Sets = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", frozen(self.nodes, np.float64, 3))
        object.__setattr__(self, "node_ids", frozen(self.node_ids, np.int64, 1)[:, 0])
        bad = ~np.isfinite(self.nodes).all(axis=1)
        if bad.any():
            first = int(self.node_ids[np.argmax(bad)])
            raise FemorsError(
                f"{int(bad.sum())} of {len(bad)} nodes with coordinates that are not finite "
                f"(first: node {first})"
            )
        for block in self.blocks:
            if len(block) and (block.nodes.min() < 0 or block.nodes.max() >= len(self.nodes)):
                raise FemorsError("an element names a node that the mesh does not have")

    def moved(self, nodes: ArrayLike) -> VolumeMesh:
        """Return the same elements at other node positions (n, 3)."""
        positions = np.asarray(nodes, dtype=np.float64)
        if positions.shape != self.nodes.shape:
            raise ValueError(f"positions of shape {positions.shape}, the mesh has {self.nodes.shape}")
        other = dataclasses.replace(self, nodes=positions)
        for name in TOPOLOGY:
            if name in self.__dict__:
                other.__dict__[name] = self.__dict__[name]
        return other

    # --- elements -----------------------------------------------------------------------------
    @property
    def element_count(self) -> int:
        """Number of elements of all blocks."""
        return sum(map(len, self.blocks))

    @cached_property
    def element_ids(self) -> Ids:
        """(e,) ids of the elements of all blocks."""
        return np.concatenate([np.zeros(0, np.int64), *(block.ids for block in self.blocks)])

    @cached_property
    def starts(self) -> Int:
        """(blocks + 1,) index of each block's first element, and the number of elements."""
        return np.cumsum([0, *map(len, self.blocks)]).astype(np.int32)

    def with_starts(self) -> list[tuple[Block, int]]:
        """Return each block with the index of its first element."""
        return list(zip(self.blocks, self.starts[:-1].tolist(), strict=True))

    @property
    def solid(self) -> bool:
        """Whether there are solid elements."""
        return any(block.shape.solid and len(block) for block in self.blocks)

    @cached_property
    def used_nodes(self) -> Int:
        """(u,) the nodes that elements name, ascending."""
        return _used(self.blocks, len(self.nodes))

    @cached_property
    def mid_nodes(self) -> Int:
        """(m, 3) mid-side nodes and the two corner nodes of the edge that each stands on."""
        rows = [np.zeros((0, 3), np.int32)]
        for block in self.blocks:
            for number, (a, b) in enumerate(block.shape.edges):
                ends = np.sort(block.nodes[:, [a, b]], axis=1)
                rows.append(np.column_stack((block.nodes[:, block.shape.corners + number], ends)))
        found = np.concatenate(rows)
        corner = np.zeros(len(self.nodes), dtype=bool)
        for block in self.blocks:
            corner[block.nodes[:, : block.shape.corners]] = True
        # a node that is a corner elsewhere moves as one; one between two edges goes by the first
        found = found[~corner[found[:, 0]]]
        return found[np.unique(found[:, 0], return_index=True)[1]]

    @cached_property
    def bodies(self) -> Int:
        """(e,) for each element the connected body that it belongs to, numbered by first element."""
        n, e = len(self.nodes), self.element_count
        node = np.concatenate([np.zeros(0, np.int32), *(block.nodes.ravel() for block in self.blocks)])
        element = np.repeat(
            np.arange(e), np.repeat([b.shape.size for b in self.blocks], np.diff(self.starts))
        )
        graph = sparse.coo_matrix((np.ones(len(node), np.int8), (element, e + node)), shape=(e + n, e + n))
        label = csgraph.connected_components(graph.tocsr(), directed=False)[1][:e]
        _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
        rank = np.argsort(np.argsort(first))
        return rank[inverse.ravel()].astype(np.int32)

    # --- surfaces -----------------------------------------------------------------------------
    @cached_property
    def outer(self) -> Polygons:
        """The faces that belong to exactly one solid element."""
        solids = [(block, start) for block, start in self.with_starts() if block.shape.solid]
        return outer_faces(solids, len(self.nodes))

    @cached_property
    def shells(self) -> Polygons:
        """The shell elements themselves."""
        return all_faces([(block, start) for block, start in self.with_starts() if not block.shape.solid])

    @property
    def boundary(self) -> Polygons:
        """What a morph takes for the mesh's surface: `outer` where there are solids, else `shells`."""
        return self.outer if self.solid else self.shells

    def surface(self) -> tuple[Surface, Int]:
        """Return the boundary as triangles over its own vertices, and the node of each vertex.

        Raises
        ------
        FemorsError
            No element has a face, or coordinates are too large.
        """
        if (bad := triples.unfit(self.nodes)) is not None:
            raise FemorsError(triples.complaint(bad, "nodes", lambda row: f"node {self.node_ids[row]}"))
        polygons = self.boundary
        if not len(polygons.sizes):
            raise FemorsError("has no elements with a surface (solids or shells)")
        index = np.zeros(len(self.nodes), np.int32)
        index[polygons.nodes] = np.arange(len(polygons.nodes), dtype=np.int32)
        return Surface(self.nodes[polygons.nodes], index[polygons.triangles()]), polygons.nodes

    # --- parts of it --------------------------------------------------------------------------
    def restricted(self, elements: ArrayLike) -> tuple[VolumeMesh, Int]:
        """Return some elements (by index) as a mesh of their own, and the index here of each of its nodes.

        Sets and surfaces are cut down to what is left of them; empty ones go.
        """
        keep = np.zeros(self.element_count, dtype=bool)
        keep[np.asarray(elements, dtype=np.int64)] = True
        blocks = []
        for block, start in self.with_starts():
            mine = keep[start : start + len(block)]
            if mine.any():
                blocks.append(dataclasses.replace(block, nodes=block.nodes[mine], ids=block.ids[mine]))
        nodes = _used(blocks, len(self.nodes))
        renumbered = [
            dataclasses.replace(block, nodes=np.searchsorted(nodes, block.nodes)) for block in blocks
        ]
        kept = np.flatnonzero(keep)
        return (
            VolumeMesh(
                self.nodes[nodes],
                tuple(renumbered),
                self.node_ids[nodes],
                cut_down(self.node_sets, nodes),
                cut_down(self.element_sets, kept),
                cut_down(self.surfaces, nodes),
            ),
            nodes,
        )


def _used(blocks: Iterable[Block], count: int) -> Int:
    """The nodes (u,) that blocks name, of so many, ascending."""
    used = np.zeros(count, dtype=bool)
    for block in blocks:
        used[block.nodes] = True
    return np.flatnonzero(used).astype(np.int32)


def cut_down(sets: Sets, kept: Int) -> dict[str, Int]:
    """Return sets in the numbering of the `kept` (ascending) members; those with none left go."""
    out = {}
    for name, members in sets.items():
        mine = members[np.isin(members, kept)]
        if len(mine):
            out[name] = np.searchsorted(kept, mine).astype(np.int32)
    return out


def carry_mid_nodes(mesh: VolumeMesh, nodes: ArrayLike, base: ArrayLike | None = None) -> Float:
    """Return positions (n, 3) whose mid-side nodes moved by the mean of their edge's two corners.

    A node that stood on a straight edge's midpoint still does; one on a curved edge keeps its offset.
    `base` (n, 3) are the positions that moves are counted from, those of the mesh where it is not
    given: pass the aligned nodes, so that the offsets turn with the whole.
    """
    out = np.array(nodes, dtype=np.float64)
    rest = mesh.nodes if base is None else np.asarray(base, dtype=np.float64)
    mid, a, b = mesh.mid_nodes.T
    # the differences first: a node that nothing moved keeps its very bits
    out[mid] = rest[mid] + 0.5 * ((out[a] - rest[a]) + (out[b] - rest[b]))
    return out
