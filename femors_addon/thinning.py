# SPDX-License-Identifier: GPL-3.0-or-later
"""A very dense mesh made about four times coarser, in array operations: what comes before edge collapses.

Quadric edge collapse takes one edge after the other, and its library lets no other thread run meanwhile.
What it does best, to keep creases and curvature, matters where few nodes are left. Here nodes are chosen
of which no two are neighbours and beside which every other node has one (a maximal independent set, found
by random priorities: Luby 1986), and every other node collapses onto its nearest chosen neighbour. Nodes on
sharper edges are chosen first, so that creases keep nodes; those of a border, or where sheets meet,
collapse along it.
"""

from __future__ import annotations

import numpy as np

from . import triples
from .cleaning import clean
from .mesh import Int, Surface

SHARP = (5.0, 10.0, 20.0, 40.0)  # degrees between two faces: the limits of the classes


def thinned(surface: Surface, random: np.random.Generator) -> Surface:
    """Return a version with about a quarter of the nodes, each of them where it was.

    Parameters
    ----------
    surface : Surface
        Cleaned.
    random : numpy.random.Generator
        For the priorities.

    Raises
    ------
    FemorsError
        Nothing that is a surface is left.
    """
    start, stop = surface.adjacency.indptr[:-1], surface.adjacency.indices
    row = np.repeat(np.arange(len(start)), np.diff(surface.adjacency.indptr))
    rank = _ranks(surface)
    chosen = _independent(start, stop, random.permutation(len(start)) + len(start) * rank)
    away = triples.length(surface.vertices.take(stop, axis=0) - surface.vertices.take(row, axis=0))
    line = rank > len(SHARP)
    away[~chosen[stop] | (line[row] & ~line[stop])] = np.inf
    nearest = np.minimum.reduceat(away, start)
    hit = np.flatnonzero(away == nearest[row])
    hit = hit[np.concatenate(([True], row[hit[1:]] != row[hit[:-1]]))]  # the first of equals
    goal = np.arange(len(start))
    goal[row[hit]] = stop[hit]
    goal[chosen] = np.flatnonzero(chosen)
    return clean(surface.vertices, goal[surface.faces], "reduced mesh").surface


def _ranks(surface: Surface) -> Int:
    """How sharp the sharpest edge at each node (n,) is, in classes; edges without two faces are above all."""
    faces, edges = surface.edge_faces
    normal = surface.face_normals
    cosine = triples.dot(normal.take(faces[:, 0], axis=0), normal.take(faces[:, 1], axis=0))
    sharp = np.searchsorted(-np.cos(np.radians(SHARP)), -cosine).astype(np.int32)
    rank = np.zeros(len(surface.vertices), dtype=np.int32)
    np.maximum.at(rank, edges, sharp[:, None])
    paired = np.zeros(len(surface.edges), dtype=bool)
    key, known = (those[:, 0].astype(np.int64) * len(rank) + those[:, 1] for those in (edges, surface.edges))
    paired[np.searchsorted(known, key)] = True
    rank[surface.edges[~paired]] = len(SHARP) + 1
    return rank


def _independent(start: Int, stop: Int, priority: Int) -> np.ndarray:
    """True (n,) for nodes of which no two are neighbours, while all others have one, of higher priority.

    Parameters
    ----------
    start, stop : (n,), (k,) int
        Where the neighbours of each node begin, and all of them.
    priority : (n,) int
        Different ones.
    """
    chosen, still = np.zeros(len(start), dtype=bool), np.ones(len(start), dtype=bool)
    while still.any():
        rivals = np.maximum.reduceat(np.where(still[stop], priority[stop], -1), start)
        found = still & (priority > rivals)
        chosen |= found
        still &= ~(found | np.logical_or.reduceat(found[stop], start))
    return chosen
