# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed bodies of simple shapes for tests: spheres, boxes, plates of hexahedra."""

from __future__ import annotations

import numpy as np

from femors_addon.mesh import Surface
from femors_addon.volume import Block, Polygons, VolumeMesh


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


# --- checks by brute force, which share no code with what they check ------------------------------------
def gaps(points: np.ndarray, surface: Surface) -> np.ndarray:
    """Signed distances (p,) of points to a closed surface, by every point and every face; negative inside."""
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    ab, ac = b - a, c - a
    normal = np.cross(ab, ac)
    out = np.empty(len(points))
    for row, p in enumerate(points):
        best = np.full(len(a), np.inf)
        for start, along in ((a, ab), (b, c - b), (c, a - c)):
            t = np.clip(((p - start) * along).sum(1) / (along**2).sum(1), 0.0, 1.0)
            best = np.minimum(best, ((start + t[:, None] * along - p) ** 2).sum(1))
        height = ((p - a) * normal).sum(1) / (normal**2).sum(1)
        foot = p - height[:, None] * normal - a
        d00, d01, d11 = (ab**2).sum(1), (ab * ac).sum(1), (ac**2).sum(1)
        d20, d21 = (foot * ab).sum(1), (foot * ac).sum(1)
        v = (d11 * d20 - d01 * d21) / (d00 * d11 - d01**2)
        w = (d00 * d21 - d01 * d20) / (d00 * d11 - d01**2)
        inside = (v >= 0) & (w >= 0) & (v + w <= 1)
        best = np.where(inside, np.minimum(best, height**2 * (normal**2).sum(1)), best)
        u = [corner - p for corner in (a, b, c)]
        length = [np.linalg.norm(x, axis=1) for x in u]
        top = (u[0] * np.cross(u[1], u[2])).sum(1)
        low = np.prod(length, axis=0)
        low = low + sum((u[i] * u[i - 1]).sum(1) * length[i - 2] for i in range(3))
        winding = np.arctan2(top, low).sum() / (2 * np.pi)
        out[row] = np.sqrt(best.min()) * (-1.0 if winding > 0.5 else 1.0)
    return out


def enclosed_volume(nodes: np.ndarray, polygons: Polygons) -> float:
    """The volume within polygons, a bilinear patch of four corners being the mean of its two cuts."""
    cuts: list[tuple[int, ...]] = []
    shares, start = [], 0
    for size in polygons.sizes.tolist():
        a, b, c, *d = polygons.corners[start : start + size].tolist()
        cuts += [(a, b, c)] if size == 3 else [(a, b, c), (a, c, *d), (a, b, *d), (b, c, *d)]
        shares += [1.0] if size == 3 else [0.5] * 4
        start += size
    return float(np.linalg.det(nodes[np.array(cuts)]) @ shares) / 6.0


def crosses(one: Surface, two: Surface) -> bool:
    """Whether an edge of one closed surface goes through a face of the other: every edge, every face."""
    for s, t in ((one, two), (two, one)):
        a, b, c = (t.vertices[t.faces[:, k]] for k in range(3))
        sides = s.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        for i, j in np.unique(np.sort(sides, axis=1), axis=0):
            p, d = s.vertices[i], s.vertices[j] - s.vertices[i]
            h = np.cross(d, c - a)
            det = ((b - a) * h).sum(1)
            safe = np.where(np.abs(det) > 1e-14, det, np.inf)
            u = ((p - a) * h).sum(1) / safe
            q = np.cross(p - a, b - a)
            v, along = (q * d).sum(1) / safe, (q * (c - a)).sum(1) / safe
            if ((u > 1e-9) & (v > 1e-9) & (u + v < 1 - 1e-9) & (along > 1e-9) & (along < 1 - 1e-9)).any():
                return True
    return False
