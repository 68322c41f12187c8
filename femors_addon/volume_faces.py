# SPDX-License-Identifier: GPL-3.0-or-later
"""Blocks of elements of one type, and the faces that enclose them."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from .cached import cached_property
from .elements import KINDS, Kind
from .mesh import Int, frozen, triangulate

Ids = NDArray[np.int64]


@dataclasses.dataclass(frozen=True, eq=False)
class Block:
    """Elements of one type.

    Attributes
    ----------
    kind : str
        A name in `elements.KINDS`: tet4, tet10, penta6, hex8, hex20, tri3, quad4 and so on.
    nodes : (k, nn) int32
        Node indices (not ids) of each element, in Abaqus' order.
    ids : (k,) int64
        Element ids.
    type : str
        What the file calls it: C3D8R, R3D3, TET10G4 ...
    """

    kind: str
    nodes: Int
    ids: Ids
    type: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", frozen(self.nodes, np.int32, KINDS[self.kind].size))
        object.__setattr__(self, "ids", frozen(self.ids, np.int64, 1)[:, 0])

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def shape(self) -> Kind:
        """The kind's corners, faces and edges."""
        return KINDS[self.kind]


@dataclasses.dataclass(frozen=True, eq=False)
class Polygons:
    """Faces of elements.

    Attributes
    ----------
    sizes : (p,) int32
        Number of corners: three or four.
    corners : (sum(sizes),) int32
        Node indices, one polygon after the other, counter-clockwise seen from outside.
    element : (p,) int32
        The element that each belongs to, counted through all blocks.
    face : (p,) int8
        Which of its faces, from 0 (Abaqus' S1).
    """

    sizes: Int
    corners: Int
    element: Int
    face: NDArray[np.int8]

    @cached_property
    def nodes(self) -> Int:
        """(u,) the nodes on them, ascending."""
        return np.unique(self.corners).astype(np.int32)

    def triangles(self) -> Int:
        """Return (m, 3) the polygons as triangles of node indices; quads are cut as `triangulate` does."""
        return triangulate(self.sizes, self.corners)[0]


# --- faces ----------------------------------------------------------------------------------------
def all_faces(blocks: list[tuple[Block, int]]) -> Polygons:
    """Return every face of (block, index of its first element) pairs, without double corners."""
    groups = []
    for block, start in blocks:
        for number, face in enumerate(block.shape.faces):
            corners = block.nodes[:, face]
            element = np.arange(start, start + len(block), dtype=np.int32)
            groups.append((corners, element, np.full(len(block), number, np.int8)))
    return _polygons(groups)


def outer_faces(blocks: list[tuple[Block, int]], count: int) -> Polygons:
    """Return the faces that occur once in the (block, index of its first element) pairs.

    Faces are matched by a sum of random 64-bit numbers of their corners, whatever their order, and
    the matches are checked; `count` is the number of nodes.
    """
    blocks = [(block, start) for block, start in blocks if len(block)]
    collapsed = any(_has_twins(block.nodes[:, : block.shape.corners]) for block, _ in blocks)
    for seed in range(8):
        random = np.random.default_rng(seed).integers(0, 2**63, count, dtype=np.uint64)
        single = _single_faces(blocks, random, collapsed)
        if single is not None:
            break
    else:
        raise AssertionError("eight sets of random numbers cannot all collide")
    groups, start = [], 0
    for block, first in blocks:
        for number, face in enumerate(block.shape.faces):
            mine = np.flatnonzero(single[start : start + len(block)])
            start += len(block)
            corners = block.nodes[mine[:, None], face]
            groups.append((corners, (first + mine).astype(np.int32), np.full(len(mine), number, np.int8)))
    return _polygons(groups)


def _has_twins(corners: Int) -> bool:
    """Whether some element names a node twice."""
    width = corners.shape[1]
    pairs = ((i, j) for i in range(width) for j in range(i))
    return any(bool((corners[:, i] == corners[:, j]).any()) for i, j in pairs)


def _single_faces(
    blocks: list[tuple[Block, int]], random: NDArray[np.uint64], collapsed: bool
) -> NDArray[np.bool_] | None:
    """Tell for every face whether it occurs once; None where the random numbers made two faces equal."""
    keys, lows, highs = [np.zeros(0, np.uint64)], [np.zeros(0, np.int32)], [np.zeros(0, np.int32)]
    for block, _ in blocks:
        for face in block.shape.faces:
            columns = [block.nodes[:, corner] for corner in face]
            key = np.zeros(len(block), np.uint64)
            for number, column in enumerate(columns):
                value = random[column]
                if collapsed:
                    for other in columns[:number]:
                        value = np.where(column == other, np.uint64(0), value)
                key += value
            keys.append(key)
            lows.append(np.minimum.reduce(columns))
            highs.append(np.maximum.reduce(columns))
    key, low, high = np.concatenate(keys), np.concatenate(lows), np.concatenate(highs)
    order = np.argsort(key)
    same = key[order][1:] == key[order][:-1]
    one, two = order[1:][same], order[:-1][same]
    if (low[one] != low[two]).any() or (high[one] != high[two]).any():
        return None
    single = np.ones(len(key), dtype=bool)
    single[one] = single[two] = False
    return single


def _polygons(groups: list[tuple[Int, Int, NDArray[np.int8]]]) -> Polygons:
    """Join (corners (p, 3 or 4), element (p,), face (p,)) groups; order by element, then face."""
    padded = [
        np.column_stack((corners, np.full((len(corners), 4 - corners.shape[1]), -1, np.int32)))
        for corners, _, _ in groups
    ]
    corners = np.concatenate([np.zeros((0, 4), np.int32), *padded])
    element = np.concatenate([np.zeros(0, np.int32), *(element for _, element, _ in groups)])
    face = np.concatenate([np.zeros(0, np.int8), *(face for _, _, face in groups)])
    order = np.lexsort((face, element))
    corners, element, face = corners[order], element[order], face[order]
    for column in range(1, 4):
        for other in range(column):
            twin = corners[:, column] == corners[:, other]
            corners[twin, column] = -1
    sizes = (corners >= 0).sum(axis=1)
    proper = sizes >= 3
    corners, sizes = corners[proper], sizes[proper]
    return Polygons(
        sizes.astype(np.int32), corners[corners >= 0].astype(np.int32), element[proper], face[proper]
    )
