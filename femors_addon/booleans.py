# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes shared by two closed surfaces, by the library manifold3d where it is installed."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from . import triples
from .cutouts import reaching
from .intersect import crossings, self_intersections
from .mesh import Float, Int, Surface

MISSING = "shared volumes and XOR are not computed: the Python package manifold3d is not installed"
ROUNDING = 1e-6  # of a volume: what arithmetic may leave
PATCH = 0.5  # of the faces: where more matter, whole surfaces are compared
DEEP = 0.5  # of a patch's diagonal: how far below it the cone ends that closes it


def available() -> bool:
    """Whether manifold3d can be imported."""
    try:
        import manifold3d  # noqa: F401
    except ImportError:
        return False
    return True


def shared_volume(one: Surface, two: Surface, box: tuple[Float, Float] | None = None) -> float | None:
    """Return the volume of the intersection, in the unit cubed; None where there is none to be had.

    It lies in the `box` (lowest, highest corner), if that is known.

    Both have to be closed and free of edges with more than two faces; the result is exact up to rounding
    (Lalish's manifold library, which keeps all other threads waiting: it gets only what it needs).
    """
    if not available():
        return None
    if box is None:
        box = np.maximum(one.bounds[0], two.bounds[0]), np.minimum(one.bounds[1], two.bounds[1])
    patches = [_closed(s.faces[reaching(s, *box)], s) for s in (one, two)]
    whole = [s if patch is None else patch[0].whole for s, patch in zip((one, two), patches, strict=True)]
    # what lies away from the box may be in a cone, and is not in the other body
    if any(patches) and not all(_all_reach(surface, *box) for surface in whole):
        return _shared(one, two)
    for patch, other in zip(patches, reversed(whole), strict=True):
        if patch is not None and len(crossings(patch[0].cone, other)):
            return _shared(one, two)
    return _shared(*whole)


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
        patches = _closed(faces, one, two) if available() else None
        if patches is not None:
            return _xor(*(patch.whole for patch in patches))
    return _xor(one, two)


def _all_reach(surface: Surface, low: Float, high: Float) -> bool:
    """Whether each component of a surface reaches into a box."""
    near = surface.components[reaching(surface, low, high)]
    return len(np.unique(near)) == len(np.unique(surface.components))


def _shared(one: Surface, two: Surface) -> float | None:
    """As `shared_volume`, of whole surfaces."""
    solids = [_manifold(surface) for surface in (one, two)]
    if solids[0] is None or solids[1] is None:
        return None
    shared = float((solids[0] ^ solids[1]).volume())
    # a body that overlaps itself counts what it has twice: nothing is known then
    return shared if shared >= -ROUNDING * min(abs(one.volume), abs(two.volume)) else None


def _xor(one: Surface, two: Surface) -> float | None:
    """As `xor_volume`, of whole surfaces."""
    shared = _shared(one, two)
    if shared is None:
        return None
    apart = one.volume + two.volume - 2.0 * shared
    return max(0.0, apart) if apart >= -ROUNDING * one.volume else None


@dataclasses.dataclass(frozen=True, eq=False)
class _Closed:
    """A cone over the border of a patch, and the solid that both make."""

    cone: Surface
    whole: Surface


def _closed(faces: Int, *surfaces: Surface) -> list[_Closed] | None:
    """Close a patch, some faces of surfaces that agree at its border, by a cone; None where that fails.

    The cone must lead to solids: it may cross neither the patch nor itself.
    """
    first = surfaces[0]
    if not 0 < len(faces) < PATCH * len(first.faces):
        return None
    vertex, local = triples.renumbered(faces, len(first.vertices))
    sides = local[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    border = sides[~np.isin(sides @ (len(vertex), 1), sides @ (1, len(vertex)))]
    if not len(border) or len(np.unique(border[:, 0])) < len(border):  # loops must not touch each other
        return None
    cone = np.column_stack((border[:, ::-1], np.full(len(border), len(vertex)))).astype(np.int32)
    old = Surface(first.vertices[vertex], local)
    tip = old.vertices.mean(axis=0) - DEEP * old.diagonal * triples.unit(old.face_cross.sum(axis=0)[None])[0]
    out = []
    for surface in surfaces:
        points = np.vstack((surface.vertices[vertex], tip))
        side, patch = Surface(points, cone), Surface(points, local)
        whole = Surface(points, np.concatenate((local, cone)))
        if whole.volume <= 0 or len(self_intersections(side)) or len(crossings(side, patch)):
            return None
        out.append(_Closed(side, whole))
    return out


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
