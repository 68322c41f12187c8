# SPDX-License-Identifier: GPL-3.0-or-later
"""How near two surfaces have come: around each node, and as a verdict in words."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from . import triples
from .mesh import Float, Surface
from .morph_settings import MorphSettings
from .nearest import Closest, SurfaceIndex

REACH = 0.002  # of the target's size: a fit is reached when 99 % of both surfaces are closer than an
# edge and this
LARGE_FACE = 2.0  # mean areas of the morphed faces: the middle of a target's face is asked for, too
ROUNDED = 1e-9  # of the size: no distance at all
WHOLE, PARTLY = 99.0, 50.0  # percent that must be near: of each surface, and of a partial mesh's nodes
OPEN, CLOSED = 0.2, 0.05  # sizes: how long the border of an open mesh is at least, of a closed one at most
DRAWN_OUT = 1.35  # times as much one way as another: whole femora 1.21, 0.7 of one onto a whole 1.46


def misfit_around(
    morphed: Surface,
    to_target: Float,
    target: Surface,
    back: Closest | None = None,
    partial: str = "none",
    index: SurfaceIndex | None = None,
) -> Float:
    """Return (n,) how far the two surfaces are apart around each vertex of the morphed one, at most.

    The vertices themselves were laid onto the target, so that their own distance says nothing. What does
    are the target's vertices, and middles of faces that are large beside the morphed ones, back to the
    morphed surface: each counts for the corners of the face that it is closest to, and for their
    neighbours.

    Parameters
    ----------
    to_target : (n,) float64
        Distance of each vertex to the target's surface.
    back : Closest, optional
        Closest points of the target's vertices on the morphed surface, where they are known; all of
        these vertices have faces then.
    partial : {"none", "source", "target"}
        With "source", what is closest to the border is beyond it, and not counted.
    index : SurfaceIndex, optional
        Of the morphed surface, where there is one.
    """
    large = target.faces[target.face_areas > LARGE_FACE * morphed.face_areas.mean()]
    middles = triples.total(target.vertices.take(large, axis=0)) / 3.0
    used = triples.renumbered(target.faces, len(target.vertices))[0]
    points = np.concatenate((target.vertices[used], middles))
    unknown = points if back is None else middles
    found = (index or SurfaceIndex(morphed)).closest(unknown) if len(unknown) else None
    parts = [part for part in (back, found) if part is not None]
    corners = morphed.faces[np.concatenate([part.face for part in parts])]
    away = np.concatenate([part.distance for part in parts])
    if partial == "source":
        inner = ~morphed.border[corners].any(axis=1)
        corners, away, points = corners[inner], away[inner], points[inner]
    out = np.full(len(morphed.vertices), -1.0)
    for corner in corners.T:
        np.maximum.at(out, corner, away)
    lone = out < 0  # a target coarser than the source
    if lone.any() and len(points):
        out[lone] = away[cKDTree(points).query(morphed.vertices[lone])[1]]
    around, most = out.copy(), triples.greatest(out.take(morphed.faces))
    for corner in morphed.faces.T:
        np.maximum.at(around, corner, most)
    around = np.maximum(around, to_target)
    return np.where(around > ROUNDED * target.diagonal, around, 0.0)


def verdict(
    to_target: Float,
    from_target: Float,
    around: Float,
    settings: MorphSettings,
    size: float,
    edge: float,
    weighted: bool,
) -> tuple[bool, str]:
    """Whether the surfaces have come together, and in which words.

    A fit is reached when 99 % of each surface is within an edge and a little of the other. The face
    that closes a cut has no counterpart: a partial mesh is judged by its median. Of a partial source the
    nodes were laid onto the target, and what is beyond it is not asked for: around them is looked.

    Parameters
    ----------
    to_target, from_target : (n,), (k,) float64
        Distances of the morphed nodes to the target's surface, and of its nodes to the morphed surface.
    around : (n,) float64
        Misfit around the morphed nodes, see `misfit_around`.
    settings : MorphSettings
    size, edge : float
        Of the target, and the mean edge of the coarser of the two.
    weighted : bool
        Whether nodes were held back.
    """
    if weighted:
        return True, "done, as far as the weights let the source move"
    limit = edge + REACH * size
    if settings.partial != "none":
        source = settings.partial == "source"
        here, there = (
            ("the result's nodes", "the target's nodes around them")
            if source
            else ("the target's nodes", "the result's surface")
        )
        return _shared(around if source else from_target, limit, size, here, there)
    gaps = [
        (_percentile(to_target, WHOLE), "the result", "the target", to_target),
        (_percentile(from_target, WHOLE), "the target", "the result", from_target),
    ]
    gap, here, there, away = max(gaps, key=lambda entry: entry[0])
    gap = gap if gap > ROUNDED * size else 0.0  # rounding is nothing to report
    if gap > limit:
        share = min(100.0 * np.mean(away <= limit), WHOLE - 0.1)
        short = f"{share:.1f} % of {here} is within {limit:.3g} of {there}, where 99 % should be"
        return False, f"not converged: {short} (99 % is within {gap:.3g})"
    return True, f"converged: 99 % of each surface is within {gap:.3g} of the other"


def _shared(away: Float, limit: float, size: float, here: str, there: str) -> tuple[bool, str]:
    """Whether half of a partial mesh's nodes is near enough, and how many are."""
    gap = _percentile(away, PARTLY)
    gap = gap if gap > ROUNDED * size else 0.0
    share = 100.0 * float(np.mean(away <= limit)) if len(away) else 100.0
    share = min(share, PARTLY - 0.1) if gap > limit else max(np.floor(10.0 * share) / 10.0, PARTLY)
    measured = f"half of {here} are within {gap:.3g} of {there}"
    start = "not converged:" if gap > limit else "converged over the shared part:"
    return gap <= limit, f"{start} {measured}; {limit:.3g} is asked for, and {share:.1f} % are within that"


def part_of_whole(
    source: Surface, morphed: Surface, target: Surface, partial: str, converged: bool
) -> tuple[str, ...]:
    """Return what to say where a part seems to have been morphed onto a whole, or a whole onto a part.

    Of such a pair, one mesh is cut open and the other is not, and either the two have not come together, or
    the source was drawn out (or pressed together) much more in one direction than in another.
    """
    if partial != "none":
        return ()
    ours, theirs = (_border_length(surface) / surface.diagonal for surface in (source, target))
    if not (min(ours, theirs) <= CLOSED and max(ours, theirs) >= OPEN):
        return ()
    before, after = (surface.vertices - surface.vertices.mean(axis=0) for surface in (source, morphed))
    stretch = np.linalg.svd(np.linalg.lstsq(before, after, rcond=None)[0], compute_uv=False)
    if converged and stretch[0] < DRAWN_OUT * stretch[-1]:
        return ()
    (part, whole), choice = (
        (("source", "target"), "Source") if ours > theirs else (("target", "source"), "Target")
    )
    return (
        f"the {part} is open and the {whole} closed: if the {part} shows only a part of what the {whole} "
        f"shows, set Overlap to {choice} is part",
    )


def _border_length(surface: Surface) -> float:
    """Length of the open border: of the edges with one face, or with more than two."""
    n = len(surface.vertices)
    key, paired = (
        those[:, 0].astype(np.int64) * n + those[:, 1] for those in (surface.edges, surface.edge_faces[1])
    )
    lone = np.ones(len(key), dtype=bool)
    lone[np.searchsorted(key, paired)] = False  # of the ascending, each is one
    ends = surface.edges[lone]
    return float(triples.length(surface.vertices[ends[:, 0]] - surface.vertices[ends[:, 1]]).sum())


def _percentile(values: Float, share: float) -> float:
    return float(np.percentile(values, share)) if len(values) else 0.0
