# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh reduction (Process 1 of the paper): coarser versions of a surface, made once and kept."""

from __future__ import annotations

import threading

import fast_simplification
import numpy as np

from . import triples
from .cleaning import clean
from .mesh import Float, Int, Surface
from .progress import FemorsError, Progress, silent
from .thinning import thinned

PIECE = 25_000
"""Faces that collapse at a time. fast-simplification lets no other thread run meanwhile, so that a window
waits (15 ms), and of more faces each takes longer: of 200 000 at once twice as long."""

SHARE = 0.5  # of the faces is left by one pass over the pieces: their seams are coarsened by the next

LEFT = 1.02  # times as many faces as were wanted: where a pass leaves more, pieces are of no use

GRAIN = 0.3
"""Length of a mean edge inside. What a collapse may cost begins at a fixed length there, 0.0015, and rises
slowly: so it is 1/200 of an edge. With a mesh of size one, all that is below half a coarse edge would go."""

ROUGHNESS, SEED = 0.003, 42
"""Mean edges that vertices are moved by, along their normals and at random: on a flat facet no collapse costs
anything, and all nodes but those of its outline would go. Far below what the reduced mesh itself loses."""

DENSE, FEWER = 150_000, 3.5
"""Nodes of a mesh that is thinned, and how many times fewer are wanted at least: it leaves one of 4.3."""

STRETCHED = 10.0
"""Extent of the edges along their first axis by that along the second, beyond which a mesh is evened out
before: no collapse is left where all triangles are needles (from a stretch by 20 on). Bones have up to 8."""

FLAT = 1e-9  # the same: all in a line

_alone = threading.Lock()  # it keeps the mesh in variables of the whole process


def reduced(surface: Surface, nodes: int, progress: Progress = silent) -> Surface:
    """Return a version with about `nodes` nodes, by quadric edge collapse (fast-simplification).

    The surface is clean (`cleaning.clean`). With more than `DENSE` nodes it is `thinned` before, as long
    as that leaves about enough. It is returned itself where it has no more nodes than that, and where it
    cannot be reduced (its pieces would collapse).
    """
    if nodes >= len(surface.vertices):
        return surface
    random = np.random.default_rng(SEED)
    while len(surface.vertices) > max(DENSE, FEWER * nodes):
        progress(0.0, "reduced meshes")
        try:
            surface = thinned(surface, random)
        except FemorsError:
            break
    if nodes >= len(surface.vertices):
        return surface
    # Euler: about two faces a node; scaled from what the surface has, borders and all
    faces = max(int(len(surface.faces) * nodes / len(surface.vertices)), 8)
    if faces >= len(surface.faces):
        return surface
    even = _evening(surface)
    if even is not None:
        inner = reduced(surface.moved(surface.vertices @ even), nodes, progress)
        return inner.moved(inner.vertices @ np.linalg.inv(even))
    low, high = surface.bounds
    centre, scale = (low + high) / 2, max(surface.mean_edge / GRAIN, np.finfo(float).tiny)
    rough = ROUGHNESS * surface.mean_edge * random.choice([-1.0, 1.0], (len(surface.vertices), 1))
    points = (surface.vertices + rough * surface.vertex_normals - centre) / scale
    # faces collapse in their order until there are few enough: in the order of the file the mesh would be
    # coarse at one end and dense at the other
    triangles = surface.faces[random.permutation(len(surface.faces))]
    axes, passes, rims = np.argsort(low - high), 0, True  # the longest first
    while len(triangles) > faces:
        progress(0.0, "reduced meshes")
        before = len(triangles)
        wanted = max(int(SHARE * before), faces) if before > PIECE else faces
        if rims and before > PIECE:
            points, triangles = _in_pieces(points, triangles, wanted, axes[passes % 3])
            rims = len(triangles) <= LEFT * wanted  # else the mesh is mostly borders
            if rims and wanted == faces:
                break
        else:
            with _alone:
                points, triangles = fast_simplification.simplify(points, triangles, target_count=wanted)
            if len(triangles) == before:
                break  # nothing is left that could be taken away
        passes += 1
    try:
        return clean(points.astype(np.float64) * scale + centre, triangles, "reduced mesh").surface
    except FemorsError:
        return surface


def _in_pieces(points: Float, triangles: Int, faces: int, axis: int) -> tuple[Float, Int]:
    """Return (points, triangles) after collapses down to about `faces` triangles.

    Slabs across an axis collapse one after the other, and what they share stays, as does every border.
    """
    count = -(-len(triangles) // PIECE)
    place = triples.total(points[:, axis][triangles])
    pieces = np.array_split(np.argsort(place, kind="stable"), count)
    parts, corners, start = [], [], 0
    for piece in pieces:
        used, local = triples.renumbered(triangles[np.sort(piece)], len(points))
        share = faces * len(piece) // len(triangles)
        with _alone:
            part, left = fast_simplification.simplify(
                points[used], local, target_count=share, preserve_border=True
            )
        parts.append(part)
        corners.append(left + start)
        start += len(part)
    first, which = triples.unique_rows(together := np.concatenate(parts))
    return together[first], which[np.concatenate(corners)].astype(np.int32)


def _evening(surface: Surface) -> Float | None:
    """Symmetric map (3, 3) that makes edges as long along their first axis as along the second.

    None where they nearly are. The third axis is let alone: it is across a sheet.
    """
    one, two = surface.edges.T
    edge = surface.vertices[one] - surface.vertices[two]
    square, axes = np.linalg.eigh(edge.T @ edge)
    _, second, longest = np.sqrt(np.maximum(square, 0.0))
    if longest <= STRETCHED * second or second <= FLAT * longest:
        return None
    even: Float = np.eye(3) + (second / longest - 1.0) * np.outer(axes[:, 2], axes[:, 2])
    return even


def pyramid(surface: Surface, counts: list[int], progress: Progress = silent) -> list[Surface]:
    """Return versions with about `counts` nodes each, every one from the next finer."""
    out: list[Surface] = []
    for count in sorted(counts, reverse=True):
        surface = reduced(surface, count, progress)
        out.append(surface)
    return out[::-1]
