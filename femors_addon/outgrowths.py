# SPDX-License-Identifier: GPL-3.0-or-later
"""Ends of the target's processes that the source falls short of: it is drawn out to them.

Where a process grows to twice its length, few of the source's nodes are at its end. What they are asked for
is averaged with what the many around them are asked for, and elements that get their shapes back draw the
end in again; its nodes lie on the target, but an edge or more behind its tip.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from . import triples
from .correspond import FACING, at_border, interpolated_normals, shortened
from .folds import Reference, bad_faces, unfolded
from .grnn import DisplacementField
from .mesh import Float, Int, Surface
from .morph_settings import MorphSettings
from .nearest import SurfaceIndex
from .quality import nearest_vertex_distance
from .relax import guarded, slide

MISSED = 1.0  # mean edges between a node of the target and the source that falls short of it
OUTWARD = 0.5  # cosine between the source's normal and the way there
WIDTH = 2.0  # mean edges: how far around the end nodes come along
TIMES = 6  # steps, each as long as the width allows
LAID = 2  # times that what came along is laid on the target


def reached(
    reference: Reference,
    settled: tuple[Float, Int, Float],
    target: SurfaceIndex,
    free: Float | None,
    mean: sparse.csr_matrix,
    settings: MorphSettings,
) -> tuple[Float, Int, Float]:
    """Draw a source that `relax.settle` has laid on the target out to the ends that it misses.

    `settled` is what `settle` returned, and so is what is returned: the displacement (n, 3), faces that
    are folded or cross, where each node was laid last. `mean` (n, n) are means over neighbours.
    """
    displacement, _, landed = settled
    after = drawn_out(reference.surface, displacement, target, free, mean, settings.sliding)
    if np.array_equal(after, displacement):
        return settled
    after, left = unfolded(reference, after, mean, bad_faces, free)
    return after, left, np.where((after != displacement).any(axis=1)[:, None], np.nan, landed)


def drawn_out(
    aligned: Surface,
    displacement: Float,
    target: SurfaceIndex,
    free: Float | None,
    mean: sparse.csr_matrix,
    rounds: int,
) -> Float:
    """Return a displacement (n, 3) that reaches the ends which `displacement` misses; the same where none is.

    Parameters
    ----------
    aligned : Surface
        The source as the displacement starts from.
    displacement : (n, 3) float64
    target : SurfaceIndex
    free : (n,) float64 or None
        0 for the nodes that stay.
    mean : (n, n) sparse
        Means over neighbours, see `relax.averaging`.
    rounds : int
        Of sliding after each step.
    """
    begun = displacement
    edge = max(aligned.mean_edge, target.surface.mean_edge)
    width = WIDTH * edge
    for _ in range(TIMES):
        moved = aligned.moved(aligned.vertices + displacement)
        short, way = _missed(moved, target.surface, MISSED * edge)
        if not len(short):
            break
        # those that are near by alone are asked, so that nothing holds the end back
        field = DisplacementField(short, shortened(way, width), 0.5 * width)
        away = cKDTree(short).query(moved.vertices)[0]
        near = np.flatnonzero(away < 3.0 * width if free is None else (away < 3.0 * width) & (free > 0))
        step = np.zeros_like(displacement)
        step[near] = field(moved.vertices[near]) * np.exp(-((away[near] / width) ** 2))[:, None]
        after = displacement.copy()
        after[near] = slide(moved, displacement + step, mean, rounds)[near]
        displacement = displacement + guarded(aligned, displacement, after - displacement, mean)
    along = np.flatnonzero((displacement != begun).any(axis=1))
    for _ in range(LAID if len(along) else 0):
        moved = aligned.moved(aligned.vertices + displacement)
        found = target.closest(moved.vertices[along])
        outward = interpolated_normals(target.surface, found.face, found.barycentric)
        kept = triples.dot(moved.vertex_normals[along], outward) > FACING
        step = np.zeros_like(displacement)
        step[along[kept]] = found.point[kept] - moved.vertices[along[kept]]
        displacement = displacement + guarded(aligned, displacement, step, mean)
    return displacement


def _missed(moved: Surface, target: Surface, limit: float) -> tuple[Float, Float]:
    """Points (k, 3) of the source that fall short of nodes of the target by the limit, and vectors there."""
    nodes, none = target.vertices, np.empty((0, 3))
    # the surface is no farther than its nearest node
    rows = np.flatnonzero(nearest_vertex_distance(nodes, moved.vertices) > limit)
    if not len(rows):
        return none, none
    found = SurfaceIndex(moved).closest(nodes[rows])
    missed = np.zeros(len(nodes), dtype=bool)
    missed[rows] = found.distance > limit
    missed &= target.adjacency @ missed.astype(float) > 0  # one alone is a spike of noise
    vector = nodes[rows] - found.point
    way = triples.unit(vector)
    outward = triples.unit(interpolated_normals(moved, found.face, found.barycentric))
    short = missed[rows] & (triples.dot(way, outward) > OUTWARD)
    short &= triples.dot(way, target.vertex_normals[rows]) > -FACING
    short &= ~at_border(moved, found.face, found.barycentric)
    return found.point[short], vector[short]
