# SPDX-License-Identifier: GPL-3.0-or-later
"""A very dense mesh made about four times coarser, in array operations: what comes before edge collapses.

Quadric edge collapse takes one edge after the other, and its library lets no other thread run meanwhile.
What it does best, to keep creases and curvature, matters where few nodes are left. Here nodes are chosen
of which no two are neighbours and beside which every other node has one (a maximal independent set, found
by random priorities: Luby 1986), and every other node collapses onto its nearest chosen neighbour.
"""

from __future__ import annotations

import numpy as np

from . import triples
from .cleaning import clean
from .mesh import Int, Surface


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
    chosen = _independent(surface, start, stop, random)
    away = triples.length(surface.vertices.take(stop, axis=0) - surface.vertices.take(row, axis=0))
    away[~chosen[stop] | (surface.border[row] & ~surface.border[stop])] = np.inf
    nearest = np.minimum.reduceat(away, start)
    hit = np.flatnonzero(away == nearest[row])
    hit = hit[np.concatenate(([True], row[hit[1:]] != row[hit[:-1]]))]  # the first of equals
    goal = np.arange(len(start))
    goal[row[hit]] = stop[hit]
    goal[chosen] = np.flatnonzero(chosen)
    return clean(surface.vertices, goal[surface.faces], "reduced mesh").surface


def _independent(surface: Surface, start: Int, stop: Int, random: np.random.Generator) -> np.ndarray:
    """True (n,) for nodes of which no two are neighbours, and beside which every other one has one.

    Border nodes come first, so that every one of the others on a border has one on the border.
    """
    count = len(start)
    priority = random.permutation(count) + count * surface.border
    chosen, still = np.zeros(count, dtype=bool), np.ones(count, dtype=bool)
    while still.any():
        rivals = np.maximum.reduceat(np.where(still[stop], priority[stop], -1), start)
        found = still & (priority > rivals)
        chosen |= found
        still &= ~(found | np.logical_or.reduceat(found[stop], start))
    return chosen
