# SPDX-License-Identifier: GPL-3.0-or-later
"""Pieces of one mesh that nothing in the other corresponds to: what a segmentation leaves behind.

A scan's surface often has islands (noise, a splinter, a bit of the next bone) and cavities (the marrow's
wall inside the bone). A mesh without such pieces would be pulled out to the ones, and its alignment drawn
to the others. They are left out of the maths, and it is said; those of the source are carried along.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from . import triples
from .cleaning import Cleaned
from .mesh import Float, Surface
from .nearest import SurfaceIndex
from .orientation import FLAT

ISLAND = 0.01  # of the surface's area: a lump of a tenth of the width of the whole has as much
SPECK = 0.001  # less than this share is no part of anything, whatever the other mesh has
IN_ALL = 0.05  # of the area: islands that are more than that in all may be what a torn surface consists of


def without_strays(ours: Cleaned, theirs: Cleaned) -> tuple[Cleaned, Cleaned]:
    """Return source and target, each without the islands and cavities that the other has none of.

    Their vertices are as those that belong to no face; notes say so.
    """
    return (
        _without(ours, theirs.surface, "source: {} carried along with the rest, for the target has none"),
        _without(theirs, ours.surface, "target: {} left out, for the source has none"),
    )


def _without(cleaned: Cleaned, other: Surface, words: str) -> Cleaned:
    surface = cleaned.surface
    if surface.components.max() == 0:
        return cleaned
    islands, hollow = _islands(surface), _cavities(surface)
    if islands.any() and _islands(other).any():  # they may be each other's counterparts
        islands &= np.bincount(surface.components, surface.face_areas) < SPECK * surface.face_areas.sum()
    if hollow.any() and _cavities(other).any():
        hollow[:] = False
    notes = []
    if islands.any():
        share = 100 * surface.face_areas[islands[surface.components]].sum() / surface.face_areas.sum()
        small = f"small pieces apart from the rest ({islands.sum()}, {share:.2g} % of the surface) were"
        notes.append(words.format(small))
    if hollow.any():
        notes.append(words.format(f"walls of cavities inside ({hollow.sum()}) were"))
    if not notes:
        return cleaned
    kept = np.flatnonzero(~(islands | hollow)[surface.components])
    vertex, local = triples.renumbered(surface.faces[kept], len(surface.vertices))
    place = np.full(len(surface.vertices) + 1, -1, dtype=np.int32)  # the last for those that have none
    place[vertex] = np.arange(len(vertex), dtype=np.int32)
    return dataclasses.replace(
        cleaned,
        surface=Surface(surface.vertices[vertex], local),
        vertex_map=place[cleaned.vertex_map],
        face_map=cleaned.face_map[kept],
        notes=(*cleaned.notes, *notes),
    )


def _islands(surface: Surface) -> NDArray[np.bool_]:
    """True (c,) for the small components farther than an edge from all that is not small.

    What is nearer is a part of the surface that is not joined to it, as along a crack.
    """
    component = surface.components
    area = np.bincount(component, surface.face_areas)
    small = area < ISLAND * area.sum()
    if not small.any() or area[small].sum() > IN_ALL * area.sum():
        return np.zeros(len(area), dtype=bool)
    nearest = _apart(surface, small[component])
    return np.asarray(small & (nearest > surface.mean_edge))


def _apart(surface: Surface, chosen: NDArray[np.bool_]) -> Float:
    """Distance (c,) from each component's `chosen` faces (m,) to the others, at the vertices of either."""
    faces = np.flatnonzero(chosen)
    ours, theirs = surface.faces[faces], surface.faces[~chosen]
    nearest = np.full(surface.components.max() + 1, np.inf)
    vertex = np.unique(ours)
    away = np.zeros(len(surface.vertices))
    away[vertex] = SurfaceIndex(Surface(surface.vertices, theirs)).closest(surface.vertices[vertex]).distance
    np.minimum.at(nearest, surface.components[faces], triples.least(away[ours]))
    # a large face may pass a vertex of the others far from its own corners
    reach = surface.mean_edge + np.sqrt(triples.longest_squared(surface.corners[faces]).max())
    vertex = np.unique(theirs)
    near = cKDTree(surface.vertices[np.unique(ours)]).query(
        surface.vertices[vertex], distance_upper_bound=reach
    )
    back = SurfaceIndex(Surface(surface.vertices, ours)).closest(
        surface.vertices[vertex[np.isfinite(near[0])]]
    )
    np.minimum.at(nearest, surface.components[faces[back.face]], back.distance)
    return nearest


def _cavities(surface: Surface) -> NDArray[np.bool_]:
    """True (c,) for the closed components that are wound inward, as `clean` leaves those inside others."""
    component = surface.components
    a, b, c = np.moveaxis(surface.corners - surface.vertices.mean(axis=0), 1, 0)
    volume = np.bincount(component, triples.dot(a, triples.cross(b, c))) / 6.0
    is_open = np.bincount(component, triples.some(surface.border[surface.faces])) > 0
    area = np.bincount(component, surface.face_areas)
    return np.asarray(~is_open & (volume < -FLAT * area**1.5))
