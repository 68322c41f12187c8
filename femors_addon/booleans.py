# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes shared by two closed surfaces, by the library manifold3d where it is installed."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import triples
from .intersect import crossings, self_intersections
from .mesh import Float, Surface

MISSING = "shared volumes and XOR are not computed: the Python package manifold3d is not installed"


ROUNDING = 1e-6  # of a volume: what arithmetic may leave
PATCH = 0.5  # of the faces: where more have moved, whole surfaces are compared
DEEP = 0.5  # of a patch's diagonal: how far below it the cone ends that closes it


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
    """Return the volume that belongs to one of the two only; None where there is none to be had.

    Where `two` is `one` with a part of its vertices moved, that part alone is compared, closed by the same
    cone in both: what lies behind it is in both or in neither.
    """
    if one.faces is two.faces or np.array_equal(one.faces, two.faces):
        moved = triples.some(one.vertices != two.vertices)
        faces = one.faces[triples.some(moved[one.faces])]
        if not len(faces):
            return 0.0
        if len(faces) < PATCH * len(one.faces) and available():
            capped = _capped(one, two, faces)
            if capped is not None:
                return _xor(*capped)
    return _xor(one, two)


def _xor(one: Surface, two: Surface) -> float | None:
    """As `xor_volume`, of whole surfaces."""
    shared = shared_volume(one, two)
    if shared is None:
        return None
    apart = one.volume + two.volume - 2.0 * shared
    return max(0.0, apart) if apart >= -ROUNDING * one.volume else None


def _capped(one: Surface, two: Surface, faces: Float) -> tuple[Surface, Surface] | None:
    """Close a patch of two surfaces, its border being the same in both, by a cone; None where that fails.

    The cone must lead to two solids: it may cross neither the patch nor itself.
    """
    vertex, local = triples.renumbered(faces, len(one.vertices))
    old, new = (Surface(s.vertices[vertex], local) for s in (one, two))
    sides = local[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    keys, back = (sides @ (len(vertex), 1)), (sides @ (1, len(vertex)))
    border = sides[~np.isin(keys, back)]
    if not len(border) or len(np.unique(border[:, 0])) < len(border):  # loops must not touch each other
        return None
    middle, wide = old.vertices.mean(axis=0), old.diagonal
    inward = -triples.unit(old.face_cross.sum(axis=0)[None])[0]
    cone = np.column_stack((border[:, ::-1], np.full(len(border), len(vertex)))).astype(np.int32)
    both = []
    for patch in (old, new):
        points = np.vstack((patch.vertices, middle + DEEP * wide * inward))
        side, whole = Surface(points, cone), Surface(points, np.concatenate((local, cone)))
        if whole.volume <= 0 or len(self_intersections(side)) or len(crossings(side, patch)):
            return None
        both.append(whole)
    return both[0], both[1]


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
