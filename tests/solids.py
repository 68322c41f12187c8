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
AT_ONCE = 20_000  # pairs of a point, or an edge, and a face: what is known of so many stays in the cache


def gaps(points: np.ndarray, surface: Surface) -> np.ndarray:
    """Signed distances (p,) of points to a closed surface, by every point and every face; negative inside."""
    a, b, c = _corners(surface)
    ab, ac = b - a, c - a
    normal = _cross(ab, ac)
    area, d00, d01, d11 = _dot(normal, normal), _dot(ab, ab), _dot(ab, ac), _dot(ac, ac)
    out = np.empty(len(points))
    size = max(AT_ONCE // a.shape[-1], 1)
    for first in range(0, len(points), size):
        p = points[first : first + size].T[:, :, None]
        best = np.full((p.shape[1], a.shape[-1]), np.inf)
        for start, along in ((a, ab), (b, c - b), (c, a - c)):
            t = np.clip(_dot(p - start, along) / _dot(along, along), 0.0, 1.0)
            away = start + t * along - p
            best = np.minimum(best, _dot(away, away))
        height = _dot(p - a, normal) / area
        foot = p - height * normal - a
        d20, d21 = _dot(foot, ab), _dot(foot, ac)
        v = (d11 * d20 - d01 * d21) / area
        w = (d00 * d21 - d01 * d20) / area
        inside = (v >= 0) & (w >= 0) & (v + w <= 1)
        best = np.where(inside, np.minimum(best, height**2 * area), best)
        out[first : first + size] = np.sqrt(best.min(axis=1))
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    boxed = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
    out[boxed[_winding(points[boxed], surface) > 0.5]] *= -1.0  # beyond the box nothing is inside
    return out


def _winding(points: np.ndarray, surface: Surface) -> np.ndarray:
    """How often (p,) a surface goes around points, by the solid angle of every face."""
    corners, out = _corners(surface), np.empty(len(points))
    size = max(AT_ONCE // corners.shape[-1], 1)
    for first in range(0, len(points), size):
        p = points[first : first + size].T[:, :, None]
        u = [corner - p for corner in corners]
        length = [np.sqrt(_dot(x, x)) for x in u]
        top = _dot(u[0], _cross(u[1], u[2]))
        low = length[0] * length[1] * length[2]
        low = low + sum(_dot(u[i], u[i - 1]) * length[i - 2] for i in range(3))
        out[first : first + size] = np.arctan2(top, low).sum(axis=1) / (2 * np.pi)
    return out


def _corners(surface: Surface) -> np.ndarray:
    """Corners (3, 3, 1, m) of all faces: which corner, then its coordinates."""
    return surface.vertices[surface.faces].transpose(1, 2, 0)[:, :, None]


def _dot(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.stack([u[i - 2] * v[i - 1] - u[i - 1] * v[i - 2] for i in range(3)])


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
        a, b, c = _corners(t)
        sides = np.unique(np.sort(s.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
        size = max(AT_ONCE // a.shape[-1], 1)
        for first in range(0, len(sides), size):
            p, end = s.vertices[sides[first : first + size]].transpose(1, 2, 0)[:, :, :, None]
            d = end - p
            h = _cross(d, c - a)
            det = _dot(b - a, h)
            safe = np.where(np.abs(det) > 1e-14, det, np.inf)
            u = _dot(p - a, h) / safe
            q = _cross(p - a, b - a)
            v, along = _dot(q, d) / safe, _dot(q, c - a) / safe
            if ((u > 1e-9) & (v > 1e-9) & (u + v < 1 - 1e-9) & (along > 1e-9) & (along < 1 - 1e-9)).any():
                return True
    return False
