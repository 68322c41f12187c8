# SPDX-License-Identifier: GPL-3.0-or-later
"""Cleaning: what a mesh as users have it needs before the maths: merged, without bad faces, outward."""

from __future__ import annotations

import dataclasses
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from . import triples
from .crew import blockwise
from .mesh import Float, Int, Surface, connected
from .orientation import oriented
from .progress import FemorsError, counted

CRACK = 0.01  # of the shortest edge at either of two vertices on open borders: nearer, they belong together
LOOSE, SCATTERED = 100, 0.1  # open pieces, and those for each face: more are triangles that were not merged
MERGED = "merged for the maths"
"""How a note ends that is no warning; of equal corners in STL files, which share none, it is not said."""


@dataclasses.dataclass(frozen=True, eq=False)
class Cleaned:
    """A surface fit for the maths, and the way back to the mesh that it was made from.

    Attributes
    ----------
    surface : Surface
        Merged, without degenerate or duplicate faces and unreferenced vertices, oriented outward.
    vertex_map : (n,) int32
        For each original vertex its index in `surface`, or -1 where no face used it.
    face_map : (k,) int32
        For each face of `surface` the original triangle.
    notes : tuple of str
        What was mended, in words.
    """

    surface: Surface
    vertex_map: Int
    face_map: Int
    notes: tuple[str, ...]


def clean(vertices: ArrayLike, triangles: ArrayLike, name: str = "mesh") -> Cleaned:
    """Merge, deduplicate and orient a triangle mesh; the input is left as it is.

    Vertices at equal coordinates are merged, and so are those on open borders, of a crack or of triangles
    with rounded corners, that are nearer to each other than `CRACK` allows. Winding is made consistent and
    outward component by component; a closed shell inside another points inward.

    Raises
    ------
    FemorsError
        No faces, fewer than four vertices, no extent in some direction, coordinates that are not finite
        or too large.
    """
    raw = _named(name, vertices, triangles)
    notes: list[str] = []
    same, merged, vertex_map = _merge(raw)
    if cracked := int(same.max()) + 1 - len(vertex_map):
        notes.append(
            counted(
                cracked,
                f"vertex stood on a crack narrower than {CRACK:g} of an edge and was merged for the maths",
                f"vertices stood on cracks narrower than {CRACK:g} of an edge and were merged for the maths",
            )
        )
    faces, face_map = _proper_faces(merged[raw.faces], raw.vertices[vertex_map], notes)
    if len(faces) < 4:
        raise FemorsError(f"{name}: {counted(len(faces), 'usable face')}: no surface; at least 4 are needed")
    used, faces = triples.renumbered(faces, len(vertex_map))
    positions = raw.vertices[vertex_map[used]]
    _check_extent(positions, name)
    lookup = np.full(len(vertex_map), -1, dtype=np.int32)
    lookup[used] = np.arange(len(used), dtype=np.int32)
    to_clean = lookup[merged]
    shared = int((np.bincount(same[to_clean >= 0]) > 1).sum())
    if shared and not _apart(raw):
        notes.append(
            counted(
                shared,
                "vertex stood twice or more and was merged for the maths",
                "vertices stood twice or more and were merged for the maths",
            )
        )
    unused = int((to_clean < 0).sum())
    if unused:
        notes.append(counted(unused, "vertex belongs to no face", "vertices belong to no face"))
    surface, turned = oriented(Surface(positions, faces))
    if turned:
        verb = "was" if turned == 1 else "were"
        notes.append(f"{turned} of {len(faces)} faces {verb} wound inward and turned for the maths")
    pieces = int((~surface.closed).sum())
    if pieces > max(LOOSE, SCATTERED * len(faces)):
        notes.append(
            f"is in {pieces} open pieces, of {len(faces)} faces: if corners that belong together stand "
            "apart, merge them first (in Blender: Mesh > Merge > By Distance)"
        )
    return Cleaned(surface, to_clean, face_map, tuple(f"{name}: {note}" for note in notes))


def distinct_nodes(surface: Surface) -> int:
    """Return how many nodes a mesh has, those of an STL file, which has each six times, counted once."""
    return triples.different(surface.vertices) if _apart(surface) else len(surface.vertices)


def _apart(surface: Surface) -> bool:
    """Whether each triangle has three vertices of its own: so it is in any STL file, and no news."""
    vertices = len(surface.vertices)
    return 0 < vertices == surface.faces.size and np.bincount(surface.faces.ravel()).max() == 1


def _named(name: str, vertices: ArrayLike, triangles: ArrayLike) -> Surface:
    try:
        surface = Surface(np.asarray(vertices), np.asarray(triangles))
    except FemorsError as error:
        raise FemorsError(f"{name}: {error}") from None
    if (bad := triples.unfit(surface.vertices)) is not None:
        words = triples.complaint(bad, "vertices", lambda row: f"vertex {row}")
        raise FemorsError(f"{name}: {words}; repair or delete them")
    if len(surface.faces) == 0:
        raise FemorsError(f"{name}: has no faces; a surface mesh is needed")
    return surface


def _merge(surface: Surface) -> tuple[Int, Int, Int]:
    """Return (numbers of vertices, equal ones alike; those with cracks closed; where these appear first).

    The numbers, (n,) each, go by first appearance, and so do the places (k,): file order survives the merge.
    """
    if triples.are_unique(surface.vertices):
        same = first = np.arange(len(surface.vertices), dtype=np.int32)
    else:
        same, first = _by_appearance(triples.unique_rows(surface.vertices)[1])
        surface = Surface(surface.vertices[first], same[surface.faces])
    pairs = _cracks(surface)
    if not len(pairs):
        return same, same, first
    return same, *_by_appearance(connected(pairs, len(first))[same])


def _by_appearance(label: Int) -> tuple[Int, Int]:
    """Number labels (n,) by their first appearance; return (n,) numbers and (k,) where each appears first."""
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(order), dtype=np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    return rank[inverse.ravel()], first[order].astype(np.int32)


def _cracks(surface: Surface) -> Int:
    """Return the pairs (k, 2) of vertices on open borders that belong together, of a surface without twins.

    How near they must be follows from the edges at both: a fine border, or a sliver where a mesh was cut, has
    short ones. Where the two ends of an edge would come together by others between them, none of these do.
    """
    border = np.flatnonzero(surface.border)
    if not len(border):
        return np.empty((0, 2), np.int32)
    a, b = surface.edges[surface.edges[:, 0] != surface.edges[:, 1]].T
    length = triples.length(surface.vertices[a] - surface.vertices[b])
    reach = np.full(len(surface.vertices), np.inf)
    for end in (a, b):
        np.minimum.at(reach, end, CRACK * length)
    places, reach = surface.vertices[border], reach[border]
    near = cKDTree(places).query_ball_point(places, np.where(np.isfinite(reach), reach, 0.0))
    one = np.repeat(np.arange(len(border)), [len(found) for found in near])
    two = np.fromiter(chain.from_iterable(near), np.int64, len(one))
    mutual = (one < two) & (triples.length(places[one] - places[two]) <= reach[two])
    pairs = np.column_stack((border[one[mutual]], border[two[mutual]])).astype(np.int32)
    label = connected(pairs, len(surface.vertices))
    return pairs[~np.isin(label[pairs[:, 0]], label[a[label[a] == label[b]]])]


def _proper_faces(faces: Int, positions: Float, notes: list[str]) -> tuple[Int, Int]:
    """Drop faces with a repeated vertex, of no area, or standing twice."""

    def proper(block: slice) -> NDArray[np.bool_]:
        a, b, c = faces[block].T
        corners = positions.take(faces[block], axis=0)
        area = triples.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        apart = (a != b) & (b != c) & (c != a)
        return apart & (triples.squared(area) > (1e-12 * triples.longest_squared(corners)) ** 2)

    kept = keep = np.flatnonzero(blockwise(proper, len(faces)))
    a, b, c = faces[keep].T
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    ordered = np.column_stack((low, a + b + c - low - high, high))
    if not triples.are_unique(ordered):
        kept = keep[np.sort(triples.unique_rows(ordered)[0])]
    if len(keep) < len(faces):
        notes.append(
            counted(
                len(faces) - len(keep),
                "face has no area and was left out of the maths",
                "faces have no area and were left out of the maths",
            )
        )
    if len(kept) < len(keep):
        notes.append(
            counted(
                len(keep) - len(kept),
                "face stands twice and was counted once",
                "faces stand twice and were counted once",
            )
        )
    return faces[kept], kept.astype(np.int32)


def _check_extent(positions: Float, name: str) -> None:
    centred = positions - positions.mean(axis=0)
    scale = np.abs(centred).max()
    if not scale > 0:
        raise FemorsError(f"{name}: all vertices are at one point")
    singular = np.linalg.svd((centred / scale), compute_uv=False)
    if len(singular) < 3 or singular[2] < 1e-6 * singular[0]:
        raise FemorsError(f"{name}: all vertices lie in one plane; a surface with depth is needed")
