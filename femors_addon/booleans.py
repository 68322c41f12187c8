# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes shared by two closed surfaces, and in which two shapes of a body differ."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import triples
from .common import below, inside, rim, shift
from .cutouts import Region, reaching
from .mesh import Float, Surface

ROUNDING = 1e-6  # of a volume: what arithmetic may leave


def shared_volume(one: Surface, two: Surface, box: tuple[Float, Float] | None = None) -> float | None:
    """Return the volume of the intersection, in the unit cubed; None where there is none to be had.

    It lies in the `box` (lowest, highest corner), if that is known.

    Both have to be closed there; the result is exact up to roundings of the coordinates.
    """
    limit = np.maximum(one.bounds[0], two.bounds[0]), np.minimum(one.bounds[1], two.bounds[1])
    shared = None if box is None else _shared(one, two, box)
    if shared is None:  # also where they touch outside the box
        shared = _shared(one, two, limit)
    # a body that is inside out, or overlaps itself: nothing is known then
    if shared is None or shared < -ROUNDING * min(abs(one.volume), abs(two.volume)):
        return None
    # where they only touch, the shifts are all there is
    touching = 2.0 * max(shift(one), shift(two)) * min(one.face_areas.sum(), two.face_areas.sum())
    return shared if shared > touching else 0.0


def xor_volume(one: Surface, two: Surface) -> float | None:
    """Return the volume that belongs to one of the two only; None where there is none to be had.

    Where `two` is `one` with a part of its vertices moved, that part alone is compared, and holes are closed
    by the same cone in both.
    """
    same = one.faces is two.faces or np.array_equal(one.faces, two.faces)
    if not same:
        shared = None if len(rim(one)) or len(rim(two)) else shared_volume(one, two)
        apart = None if shared is None else one.volume + two.volume - 2.0 * shared
    else:
        moved = triples.some(one.vertices != two.vertices)
        if not moved.any():
            return 0.0
        one, two = _filled(one, two, rim(one))
        apart = _apart(one, two, triples.some(np.append(moved, False)[one.faces]))
    if apart is None or min(one.volume, two.volume) <= 0 or apart < -ROUNDING * one.volume:
        return None
    return max(0.0, apart)


def _shared(one: Surface, two: Surface, box: tuple[Float, Float]) -> float | None:
    """The volume shared in a box that holds all that is; None where a surface is open there."""
    margin = 2.0 * max(shift(surface) for surface in (one, two))
    box = box[0] - margin, box[1] + margin
    if (box[0] > box[1]).any():
        return 0.0
    near = reaching(one, *box), reaching(two, *box)
    for surface, mask in zip((one, two), near, strict=True):
        part = Region.cut(surface, mask).surface
        edge = part.vertices[rim(part)]
        if ((edge >= box[0]) & (edge <= box[1])).all(axis=2).any():
            return None
    return inside((one, two), near, (box[0] + box[1]) / 2.0, box)


def _apart(one: Surface, two: Surface, moved: NDArray[np.bool_]) -> float | None:
    """The volume between some faces before and after: below those outside the other, less those inside."""
    if not moved.any():
        return 0.0
    origin = one.vertices[one.faces[int(np.argmax(moved)), 0]]
    within = inside((one, two), (moved, moved), origin)
    if within is None:
        return None
    return below(one, moved, origin) + below(two, moved, origin) - 2.0 * within


def _filled(one: Surface, two: Surface, edge: NDArray) -> tuple[Surface, Surface]:
    """Close two surfaces with the same faces by the same cone over the open edges (k, 2) of both."""
    if not len(edge):
        return one, two
    tip = one.vertices[edge].mean(axis=(0, 1))
    cone = np.column_stack((edge[:, ::-1], np.full(len(edge), len(one.vertices))))
    faces = np.concatenate((one.faces, cone))
    first = Surface(np.vstack((one.vertices, tip)), faces)
    return first, first.moved(np.vstack((two.vertices, tip)))
