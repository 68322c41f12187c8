# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of finite elements for tests: regular elements, grids, kinds side by side; the knee's."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from femors_addon.elements import KINDS
from femors_addon.volume import Block, VolumeMesh

KNEE = Path(os.environ.get("FEMORS_DATA", Path(__file__).parent.parent.parent / "shared" / "data")) / "knee"
needs_knee = pytest.mark.skipif(not KNEE.is_dir(), reason=f"there is no {KNEE}")
S = np.sqrt(3) / 2
TET = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(8)
TET = TET[[0, 2, 1, 3]] if np.linalg.det(TET[[1, 2, 3]] - TET[0]) < 0 else TET
WEDGE = np.array([[x, y, z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (0.5, S))])
CUBE = np.array([[x, y, z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))], dtype=float)
PYRAMID = np.array([*CUBE[:4], [0.5, 0.5, np.sqrt(0.5)]])
REGULAR = {"tet4": TET, "penta6": WEDGE, "hex8": CUBE, "pyra5": PYRAMID}
VOLUME = {"tet4": np.sqrt(2) / 12, "penta6": S / 2, "hex8": 1.0, "pyra5": np.sqrt(2) / 6}


def mesh_of(kind: str, nodes: np.ndarray, rows: np.ndarray | None = None, **more) -> VolumeMesh:
    rows = np.arange(len(nodes))[None] if rows is None else np.asarray(rows)
    block = Block(kind, rows, np.arange(1, len(rows) + 1))
    return VolumeMesh(nodes, (block,), np.arange(1, len(nodes) + 1), **more)


def quadratic(kind: str, nodes: np.ndarray) -> np.ndarray:
    """Return the nodes with mid-side nodes at the middle of the kind's edges."""
    return np.array([*nodes, *(nodes[[a, b]].mean(axis=0) for a, b in KINDS[kind].edges)])


def grid(n: int, jitter: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and hexahedra of n x n x n cubes, interior and border nodes shaken."""
    axis = np.arange(n + 1)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3).astype(float)
    index = np.arange(len(nodes)).reshape(n + 1, n + 1, n + 1)
    steps = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
    rows = np.stack([index[i : i + n, j : j + n, k : k + n] for i, j, k in steps], -1).reshape(-1, 8)
    return nodes + jitter * np.random.default_rng(3).normal(size=nodes.shape), rows


def mixed() -> VolumeMesh:
    """Hexahedra, of which some are cut into wedges and one into pyramids about its middle."""
    nodes, hexes = grid(3, 0.08)
    hexes = hexes.copy()
    wedges = [row[list(half)] for row in hexes[:9] for half in ((0, 1, 2, 4, 5, 6), (0, 2, 3, 4, 6, 7))]
    middle = len(nodes)
    nodes = np.vstack((nodes, nodes[hexes[26]].mean(axis=0)))
    pyramids = [[*(hexes[26][list(face)][::-1]), middle] for face in KINDS["hex8"].faces]
    blocks = (
        Block("hex8", hexes[9:26], np.arange(100, 117)),
        Block("penta6", np.array(wedges), np.arange(200, 218)),
        Block("pyra5", np.array(pyramids), np.arange(300, 306)),
    )
    return VolumeMesh(nodes, blocks, np.arange(len(nodes)) + 1)
