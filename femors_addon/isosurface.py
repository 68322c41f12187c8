# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh the zero surface of an implicit shape with well-shaped triangles.

Surface nets (Gibson 1998): one vertex in each cell of a lattice that the surface runs through, one
quadrilateral around each lattice edge that it crosses; then the vertices even out along the surface
and the quadrilaterals are cut along their better diagonals.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial.transform import Rotation

from .mesh import Float, Int, Surface, edge_matrix
from .triples import unit

Implicit = Callable[[Float], Float]
"""Signed, roughly distance-like value (p,) at points (p, 3): negative inside."""

DENSEST = 20_000
"""Nodes above which a mesh is made by halving the edges of a coarser one."""

BLOCK = 200_000  # lattice points evaluated at a time
EVENING_ROUNDS = 15


def meshed(value: Implicit, low: Float, high: Float, nodes: int, lattice: int = 0) -> Surface:
    """Return the zero surface of a shape that lies within a box: closed, wound outward.

    Parameters
    ----------
    value : callable
        The shape; its features have to be a few edge lengths apart.
    low, high : (3,) float64
        Corners of the box.
    nodes : int
        About how many vertices.
    lattice : int
        Which of many possible meshes: a seed for how the lattice lies in space.
    """
    halvings = 0
    while nodes / 4**halvings > DENSEST:
        halvings += 1
    wanted = nodes / 4**halvings
    turn, shift = _placement(lattice)
    cell = float((high - low).max()) / 50.0
    for _ in range(4):
        values, origin = _sampled(value, low, high, cell, turn, shift)
        count = int(_mixed(values).sum())
        if abs(count - wanted) < 0.02 * wanted or not count:
            break
        cell *= np.sqrt(count / wanted)
    points, quads = _net(_untangled(values))
    points = (origin + points * cell) @ turn
    for _ in range(EVENING_ROUNDS):
        points = projected(value, _evened(points, _cut(points, quads)), cell, steps=1)
    points = projected(value, points, cell)
    surface = Surface(points, _cut(points, quads))
    for _ in range(halvings):
        surface = halved(surface)
        cell /= 2.0
        surface = surface.moved(projected(value, _evened(surface.vertices, surface.faces), cell))
    return surface


def projected(value: Implicit, points: Float, size: float, steps: int = 3) -> Float:
    """Move points (p, 3) onto the zero surface by Newton steps of at most half of `size` each."""
    for _ in range(steps):
        here, slope = value(points), _gradient(value, points, 1e-4 * size)
        step = here / np.maximum(np.einsum("ij,ij->i", slope, slope), 1e-6)
        move = step[:, None] * slope
        length = np.linalg.norm(move, axis=1, keepdims=True)
        points = points - move * np.minimum(1.0, 0.5 * size / np.maximum(length, 1e-300))
    return points


def _gradient(value: Implicit, points: Float, step: float) -> Float:
    out = np.empty_like(points)
    for axis in range(3):
        aside = np.zeros(3)
        aside[axis] = step
        out[:, axis] = (value(points + aside) - value(points - aside)) / (2.0 * step)
    return out


def halved(surface: Surface) -> Surface:
    """Cut each face in four at the middles of its edges."""
    n, edges = len(surface.vertices), surface.edges
    middle = surface.vertices[edges].mean(axis=1)
    keys = edges[:, 0].astype(np.int64) * n + edges[:, 1]
    half = np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2).astype(np.int64)
    ab, bc, ca = (n + np.searchsorted(keys, half[:, :, 0] * n + half[:, :, 1])).T
    a, b, c = surface.faces.T
    corners = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    faces = np.stack([np.column_stack(corner) for corner in corners], axis=1).reshape(-1, 3)
    return Surface(np.concatenate((surface.vertices, middle)), faces)


# --- the net ----------------------------------------------------------------------------------------
def _placement(lattice: int) -> tuple[Float, Float]:
    """A rotation (3, 3), mostly about z, and a shift (3,) in cells, for a seed."""
    rng = np.random.default_rng(1000 + lattice)
    turn = Rotation.from_rotvec(rng.uniform(-1.0, 1.0, 3) * (0.12, 0.12, np.pi / 4))
    return turn.as_matrix(), rng.uniform(0.0, 1.0, 3)


def _sampled(
    value: Implicit, low: Float, high: Float, cell: float, turn: Float, shift: Float
) -> tuple[Float, Float]:
    """Values on a lattice that holds the box, and its origin in the lattice's own axes."""
    box = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T @ turn.T
    origin = box.min(axis=0) - (1.0 + shift) * cell
    shape = np.ceil((box.max(axis=0) - origin) / cell).astype(int) + 2
    values = np.empty(int(shape.prod()))
    for start in range(0, len(values), BLOCK):
        ids = np.arange(start, min(start + BLOCK, len(values)))
        at = np.column_stack(np.unravel_index(ids, tuple(shape)))
        values[ids] = value((origin + at * cell) @ turn)
    return values.reshape(shape), origin


def _mixed(values: Float) -> NDArray[np.bool_]:
    """True for the cells with corners on both sides."""
    signs = _signs(values)
    return (signs > 0) & (signs < 255)


def _signs(values: Float) -> NDArray[np.uint8]:
    """Which of the eight corners of each cell are inside, as bits in the order of `np.ndindex`."""
    inside = (values < 0).astype(np.uint8)
    out = np.zeros(np.array(values.shape) - 1, dtype=np.uint8)
    for bit, corner in enumerate(np.ndindex(2, 2, 2)):
        window = tuple(slice(c, n - 1 + c) for c, n in zip(corner, values.shape, strict=True))
        out |= (inside[window] << bit).astype(np.uint8)
    return out


def _untangled(values: Float) -> Float:
    """Fill in corners where two sheets of the surface would meet in one cell, which the net cannot show."""
    values, tangled = values.copy(), _tangled_patterns()
    if (values[1:-1, 1:-1, 1:-1] < 0).sum() != (values < 0).sum():
        raise ValueError("the shape does not lie within the box")
    corners = np.array(list(np.ndindex(2, 2, 2)))
    while len(cells := np.argwhere(tangled[_signs(values)])):
        at = cells[:, None] + corners
        here = values[tuple(np.moveaxis(at, 2, 0))]
        rim = ((at == 0) | (at == np.array(values.shape) - 1)).any(axis=2)
        least = np.argmin(np.where((here < 0) | rim, np.inf, here), axis=1)
        fill = tuple(at[np.arange(len(at)), least].T)
        # only ever outside to inside, so that it comes to an end
        values[fill] = -np.maximum(np.abs(values[fill]), np.finfo(float).tiny)
    return values


def _tangled_patterns() -> NDArray[np.bool_]:
    """True (256,) for the patterns of signs whose inside or outside corners do not hang together."""
    corners = np.array(list(np.ndindex(2, 2, 2)))
    beside = np.abs(corners[:, None] - corners).sum(axis=2) <= 1
    inside = (np.arange(256)[:, None] >> np.arange(8)) & 1 > 0
    alike = beside & (inside[:, :, None] == inside[:, None, :])
    reach = np.linalg.matrix_power(alike.astype(np.int64), 7) > 0
    return ((inside[:, :, None] == inside[:, None, :]) & ~reach).any(axis=(1, 2))


def _net(values: Float) -> tuple[Float, Int]:
    """Vertices (n, 3), in cells, and quadrilaterals (q, 4), counter-clockwise from outside."""
    cells = _mixed(values)
    number = np.full(cells.shape, -1, dtype=np.int64)
    number[cells] = np.arange(int(cells.sum()))
    total, count = np.zeros((int(cells.sum()), 3)), np.zeros(int(cells.sum()))
    quads = []
    inside = values < 0
    for axis in range(3):
        one, two = np.moveaxis(inside, axis, 0)[:-1], np.moveaxis(inside, axis, 0)[1:]
        at = np.argwhere(np.moveaxis(one != two, 0, axis))
        step = np.eye(3, dtype=np.int64)[axis]
        first, last = values[tuple(at.T)], values[tuple((at + step).T)]
        crossing = at + (first / (first - last))[:, None] * step
        # the four cells around a lattice edge, in turn about its direction
        right, up = np.eye(3, dtype=np.int64)[[(axis + 1) % 3, (axis + 2) % 3]]
        around = [number[tuple((at - aside).T)] for aside in (right + up, up, 0 * up, right)]
        for ids in around:
            count += np.bincount(ids, minlength=len(count))
            for k in range(3):
                total[:, k] += np.bincount(ids, crossing[:, k], minlength=len(count))
        quad = np.column_stack(around)
        leaves = first < 0  # the surface is crossed outward along the axis
        quads.append(np.where(leaves[:, None], quad, quad[:, ::-1]))
    return total / count[:, None], np.concatenate(quads).astype(np.int32)


def _cut(points: Float, quads: Int) -> Int:
    """Cut quadrilaterals into triangles (2 q, 3) along the shorter diagonal."""
    a, b, c, d = quads.T
    one = np.sum((points[a] - points[c]) ** 2, axis=1) <= np.sum((points[b] - points[d]) ** 2, axis=1)
    first = np.where(one[:, None], np.column_stack((a, b, c)), np.column_stack((a, b, d)))
    second = np.where(one[:, None], np.column_stack((a, c, d)), np.column_stack((b, c, d)))
    return np.stack((first, second), axis=1).reshape(-1, 3).astype(np.int32)


def _evened(points: Float, faces: Int) -> Float:
    """Move each vertex half way to the mean of its neighbours, along the surface."""
    surface = Surface(points, faces)
    adjacency: sparse.csr_matrix = edge_matrix(surface.edges, len(points))
    degree = np.maximum(np.asarray(adjacency.sum(axis=1)), 1.0)
    change = adjacency @ points / degree - points
    normal = unit(surface.vertex_normals)
    change -= np.einsum("ij,ij->i", change, normal)[:, None] * normal
    return points + 0.5 * change
