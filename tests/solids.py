# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed bodies of simple shapes for tests: spheres, boxes, plates of hexahedra."""

from __future__ import annotations

import numpy as np

from femors_addon.mesh import Surface
from femors_addon.volume import Block, VolumeMesh


def sphere(subdivisions: int = 3, radius: float = 10.0, centre=(0.0, 0.0, 0.0)) -> Surface:
    """A sphere of 20 * 4^subdivisions triangles, outward."""
    g = (1 + 5**0.5) / 2
    v = np.array([(0, s, t * g) for s in (-1, 1) for t in (-1, 1)], dtype=float)
    v = np.concatenate([v, v[:, [2, 0, 1]], v[:, [1, 2, 0]]])
    near = np.abs(np.linalg.norm(v[:, None] - v[None], axis=2) - 2) < 1e-9
    f = np.array(
        [
            (i, j, k)
            for i in range(12)
            for j in range(i)
            for k in range(j)
            if near[i, j] & near[j, k] & near[i, k]
        ]
    )
    outward = (
        np.einsum("ij,ij->i", np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]]), v[f[:, 0]]) > 0
    )
    f = np.where(outward[:, None], f, f[:, ::-1])
    for _ in range(subdivisions):
        sides = np.sort(f[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        edges, middle = np.unique(sides, axis=0, return_inverse=True)
        ab, bc, ca = (middle.reshape(-1, 3) + len(v)).T
        v = np.concatenate([v, v[edges].mean(axis=1)])
        a, b, c = f.T
        f = np.concatenate(
            [np.column_stack(t) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
        )
    return Surface(radius * v / np.linalg.norm(v, axis=1, keepdims=True) + np.array(centre), f)


def moved(surface: Surface, by) -> Surface:
    """The same surface elsewhere."""
    return Surface(surface.vertices + np.array(by, dtype=float), surface.faces)


def hexes(cells, size, bend: float = 0.0, centre=(0.0, 0.0, 0.0)) -> VolumeMesh:
    """A plate of hexahedra, bent downward at its sides."""
    number = np.arange(np.prod(np.array(cells) + 1)).reshape([c + 1 for c in cells])
    grid = np.meshgrid(*(np.linspace(-0.5, 0.5, c + 1) for c in cells), indexing="ij")
    nodes = np.column_stack([axis.ravel() for axis in grid]) * np.array(size, dtype=float)
    nodes[:, 2] -= bend * (nodes[:, 0] ** 2 + nodes[:, 1] ** 2)
    low = number[:-1, :-1, :-1], number[1:, :-1, :-1], number[1:, 1:, :-1], number[:-1, 1:, :-1]
    high = number[:-1, :-1, 1:], number[1:, :-1, 1:], number[1:, 1:, 1:], number[:-1, 1:, 1:]
    rows = np.column_stack([corner.ravel() for corner in (*low, *high)])
    block = Block("hex8", rows, np.arange(len(rows)) + 1)
    return VolumeMesh(nodes + np.array(centre), (block,), np.arange(len(nodes)) + 1)


def box(cells: int, size: float, centre=(0.0, 0.0, 0.0)) -> Surface:
    """A cube of triangles with sharp edges."""
    return hexes((cells,) * 3, (size,) * 3, centre=centre).surface()[0]
