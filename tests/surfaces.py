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
