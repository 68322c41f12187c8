# SPDX-License-Identifier: GPL-3.0-or-later
"""Edges of one surface against another: how near they come to it, and what it cuts out of them."""

from __future__ import annotations

import numpy as np

from . import triples
from .balls import Index, searches
from .intersect import piercings
from .mesh import Float, Surface

PARALLEL = 1e-12  # squared sine below which two edges count as parallel


def least_between(one: Surface, two: Surface, within: float) -> float:
    """Return the least distance of two surfaces that do not cross.

    Two such surfaces are nearest each other at a vertex of one, or between two edges.

    Parameters
    ----------
    within : float
        The least distance of the vertices of each to the other surface: what is returned is this, or less.
    """
    ours, theirs = (Surface(each.vertices, each.edges[:, [0, 1, 1]]) for each in (one, two))
    least = within
    for search in searches(ours, theirs, within):
        for e, f in search.candidates():
            least = min(least, _least(ours, theirs, e, f))
    return least


def middles(one: Surface, two: Surface) -> Float:
    """Return the middles (k, 3) of the pieces that the faces of `two` cut out of the edges of `one`.

    A piece ends where its edge pierces a face; what lies beyond the first and the last is none.
    """
    found = piercings(one, two)
    order = np.lexsort((found.t, found.edge))
    edge, t = found.edge[order], found.t[order]
    row = np.flatnonzero(edge[1:] == edge[:-1])
    start, end = one.vertices[one.edges[edge[row]]].transpose(1, 0, 2)
    middle: Float = start + 0.5 * (t[row] + t[row + 1])[:, None] * (end - start)
    return middle


def _least(ours: Surface, theirs: Surface, e: Index, f: Index) -> float:
    """Return the least distance of pairs of edges that is not at an end of one."""
    start, end = (ours.vertices.take(ours.faces[e, i], axis=0) for i in (0, 1))
    other, stop = (theirs.vertices.take(theirs.faces[f, i], axis=0) for i in (0, 1))
    u, v, w = end - start, stop - other, start - other
    uu, uv, vv, uw, vw = (triples.dot(*two) for two in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    across = uu * vv - uv * uv
    rows = np.flatnonzero(across > PARALLEL * uu * vv)
    s = (uv * vw - vv * uw)[rows] / across[rows]
    t = (uu * vw - uv * uw)[rows] / across[rows]
    inner = np.flatnonzero((s >= 0) & (s <= 1) & (t >= 0) & (t <= 1))
    rows, s, t = rows[inner], s[inner, None], t[inner, None]
    apart: Float = triples.length(w[rows] + s * u[rows] - t * v[rows])
    return float(apart.min(initial=np.inf))
