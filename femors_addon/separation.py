# SPDX-License-Identifier: GPL-3.0-or-later
"""The way apart: where two thin bodies have passed through each other, in what direction they came.

Signed distances end at half the thickness: a node that is deeper leaves by the far side. Such a pair is
parted along one direction until nothing overlaps, and pressed together again in steps that are small
against the thickness, the field giving way at each: what was in front stays in front.
"""

from __future__ import annotations

import numpy as np

from . import triples
from .bodies import Solid
from .contact import Pair
from .cutouts import Region
from .intersect import piercings
from .mesh import Float, Surface
from .nearest import SurfaceIndex
from .triples import unit

WRONG = 0.05  # of the nodes inside the other body: as many leaving by the wrong side make a pair suspicious
THICK = 0.4  # of the mean thickness: a way apart below this is no passage through a body
CUT = 0.25  # of a body's area: so much lies on each side of a sheet that runs right through it
FAR = 4.0  # mean thicknesses of the thinner body: a way apart beyond this is no passage either


def thickness(surface: Surface) -> float:
    """Return twice the volume by the area: the mean thickness of a plate."""
    area = float(surface.face_areas.sum())
    return 2.0 * abs(surface.volume) / area if area > 0 else 0.0


def runs_through(sheet: Solid, body: Solid) -> bool:
    """Whether an open surface runs right through a closed one: nothing tells to which side it belongs.

    Its border lies outside, and of the body's area (of what is not beyond the border) a good part lies on
    each side of it.
    """
    if not sheet.open_edges or body.open_edges or not len(piercings(sheet.surface, body.surface).edge):
        return False
    border = sheet.vertices[sheet.surface.border]
    if (SurfaceIndex(body.surface).signed(border) < 0).any():
        return False
    index, areas = SurfaceIndex(sheet.surface), body.surface.face_areas
    middles = triples.total(body.surface.corners) / 3.0
    found = index.closest(middles)
    side = triples.dot(middles - found.point, index.pseudonormals(found))
    side[sheet.on_border(found)] = 0.0
    return min(areas[side > 0].sum(), areas[side < 0].sum()) >= CUT * areas.sum()


def way_apart(pair: Pair, stuck: bool = False) -> Float | None:
    """Return the shift (3,) of the first body that parts a pair, or None where none is called for.

    The pair must have been looked at. One that is `stuck`, for the loop has failed, is parted also where
    few nodes leave by the wrong side.
    """
    one, two = pair.one.surface, pair.two.surface
    inside = [side.found.gaps < 0 for side in pair.sides]
    count = sum(int(rows.sum()) for rows in inside)
    wrong = sum(int((rows & side.wrong).sum()) for rows, side in zip(inside, pair.sides, strict=True))
    if wrong <= WRONG * count and not stuck:
        return None
    points = np.concatenate((piercings(one, two).points(one), piercings(two, one).points(two)))
    if len(points) < 3 and stuck:  # they only touch, as bodies in line do: what is too near, then
        points = np.concatenate([side.body.vertices[side.found.gaps <= pair.gap] for side in pair.sides])
    if len(points) < 3:
        return None
    plate = [thickness(one), thickness(two)]
    reach = 2.0 * max(plate)
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    near = [np.concatenate((Region.of(s, low, high).surface.vertices, points)) for s in (one, two)]
    size = 1.5 * max(one.mean_edge, two.mean_edge)
    best = min((_apart(near[0], near[1], way, size), tuple(way)) for way in _candidates(points, one, two))
    distance, way = best[0], np.array(best[1])
    least = 0.0 if stuck else THICK * max(plate)
    if not least < distance < FAR * min(plate):
        return None
    return distance * way


def _candidates(points: Float, one: Surface, two: Surface) -> Float:
    """Directions to try: across the plane of the crossing, from body to body, and between these.

    All lead away from the other body as a whole: near contact, where they have passed through each
    other, nothing tells any more which was in front.
    """
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    between = unit((one.vertices.mean(axis=0) - two.vertices.mean(axis=0))[None])[0]
    along = axes[2] if axes[2] @ between >= 0 else -axes[2]
    return unit(np.array([along, between, 2.0 * along + between]))


def _apart(one: Float, two: Float, way: Float, size: float) -> float:
    """Return how far points one (k, 3) must go along a unit way to be beyond two (l, 3), column by column."""
    frame = np.linalg.svd(way[None])[2][1:]
    low = np.minimum((one @ frame.T).min(axis=0), (two @ frame.T).min(axis=0))
    cells = [np.floor((p @ frame.T - low) / size).astype(np.int64) for p in (one, two)]
    shape = np.maximum(cells[0].max(axis=0), cells[1].max(axis=0)) + 1
    lowest, highest = np.full(shape, np.inf), np.full(shape, -np.inf)
    np.minimum.at(lowest, tuple(cells[0].T), one @ way)
    np.maximum.at(highest, tuple(cells[1].T), two @ way)
    return float((highest - lowest).max())
