# SPDX-License-Identifier: GPL-3.0-or-later
"""What tests do to surfaces: put several together, take one apart, cut a piece out."""

from __future__ import annotations

import numpy as np

from femors_addon.mesh import Surface


def together(*surfaces: Surface) -> Surface:
    """Several surfaces as one, nothing merged."""
    start = np.cumsum([0] + [len(surface.vertices) for surface in surfaces])
    faces = [surface.faces + first for surface, first in zip(surfaces, start, strict=False)]
    return Surface(np.concatenate([surface.vertices for surface in surfaces]), np.concatenate(faces))


def soup(surface: Surface) -> Surface:
    """The same triangles, each with three vertices of its own, as STL has them."""
    return Surface(surface.corners.reshape(-1, 3), np.arange(3 * len(surface.faces)).reshape(-1, 3))


def cut(surface: Surface, low: float, high: float) -> tuple[Surface, np.ndarray]:
    """The faces between two heights (z), left open, and which vertices they use."""
    height = surface.corners[:, :, 2].mean(axis=1)
    used, faces = np.unique(surface.faces[(height > low) & (height < high)], return_inverse=True)
    return Surface(surface.vertices[used], faces.reshape(-1, 3)), used


def clipped(surface: Surface, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Return what lies below a height, faces across it cut there."""
    points, faces, on = list(surface.vertices), [], {}

    def between(one: int, two: int) -> int:
        key = (min(one, two), max(one, two))
        if key not in on:
            a, b = points[key[0]], points[key[1]]
            on[key] = len(points)
            points.append(a + (height - a[2]) / (b[2] - a[2]) * (b - a))
        return on[key]

    for face in surface.faces.tolist():
        ring = []
        for one, two in zip(face, face[1:] + face[:1], strict=True):
            below = [points[k][2] < height for k in (one, two)]
            ring += ([one] if below[0] else []) + ([between(one, two)] if below[0] != below[1] else [])
        faces += [[ring[0], ring[k], ring[k + 1]] for k in range(1, len(ring) - 1)]
    used, corners = np.unique(faces, return_inverse=True)
    return np.array(points)[used], corners.reshape(-1, 3)
