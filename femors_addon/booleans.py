# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes shared by two closed surfaces, by the library manifold3d where it is installed."""

from __future__ import annotations

from typing import Any

import numpy as np

from .mesh import Surface

MISSING = "shared volumes and XOR are not computed: the Python package manifold3d is not installed"
ROUNDING = 1e-6  # of a volume: what arithmetic may leave


def available() -> bool:
    """Whether manifold3d can be imported."""
    try:
        import manifold3d  # noqa: F401
    except ImportError:
        return False
    return True


def shared_volume(one: Surface, two: Surface) -> float | None:
    """Return the volume of the intersection, in the unit cubed; None where there is none to be had.

    Both have to be closed and free of edges with more than two faces; the result is exact up to rounding
    (Lalish's manifold library).
    """
    solids = [_manifold(surface) for surface in (one, two)]
    if solids[0] is None or solids[1] is None:
        return None
    shared = float((solids[0] ^ solids[1]).volume())
    # a body that overlaps itself counts what it has twice: nothing is known then
    return shared if shared >= -ROUNDING * min(abs(one.volume), abs(two.volume)) else None


def xor_volume(one: Surface, two: Surface) -> float | None:
    """Return the volume that belongs to one of the two only; None where there is none to be had."""
    if np.array_equal(one.vertices, two.vertices) and np.array_equal(one.faces, two.faces):
        return 0.0
    shared = shared_volume(one, two)
    if shared is None:
        return None
    apart = one.volume + two.volume - 2.0 * shared
    return max(0.0, apart) if apart >= -ROUNDING * one.volume else None


def _manifold(surface: Surface) -> Any:
    """The library's own form of a surface, None where it is no solid."""
    if not available():
        return None
    import manifold3d

    vertices = np.array(surface.vertices, dtype=np.float64)
    faces = surface.faces.astype(np.uint64)
    solid = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces))
    if solid.status() != manifold3d.Error.NoError or solid.is_empty():
        return None
    return solid if abs(solid.volume() - surface.volume) <= 1e-4 * abs(surface.volume) else None
