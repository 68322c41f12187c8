# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a surface that matter, as surfaces of their own: searches cost as little as they are large."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from . import triples
from .mesh import Float, Int, Surface


@dataclasses.dataclass(frozen=True, eq=False)
class Region:
    """The faces of a surface that reach into a box, as a surface of their own; `vertex` tells which."""

    surface: Surface
    vertex: Int

    @classmethod
    def of(cls, surface: Surface, low: Float, high: Float) -> Region:
        """Cut out the faces whose own boxes reach into a box."""
        return cls.cut(surface, reaching(surface, low, high))

    @classmethod
    def cut(cls, surface: Surface, chosen: NDArray, shift: Float | float = 0.0) -> Region:
        """Cut out, and shift, the chosen faces (indices, or true for each)."""
        vertex, local = triples.renumbered(surface.faces[chosen], len(surface.vertices))
        return cls(Surface(surface.vertices[vertex] + shift, local), vertex)

    @classmethod
    def near(
        cls, surface: Surface, bound: Float, shift: Float, longest: float, share: float, slack: float
    ) -> Region:
        """Cut out, and shift, the faces that have a corner near another surface.

        That is at least `bound` (n,) away; near is a share of a face's longest side, none being longer than
        `longest`, and a slack.
        """
        nearest = triples.least(bound[surface.faces])
        near = np.flatnonzero(nearest <= share * longest + slack)
        sides = np.sqrt(triples.longest_squared(surface.vertices.take(surface.faces[near], axis=0)))
        return cls.cut(surface, near[nearest[near] <= share * sides + slack], shift)


def reaching(surface: Surface, low: Float, high: Float) -> NDArray[np.bool_]:
    """Whether the own box of each face (m,) reaches into a box."""
    # on which sides of the box a vertex is, one bit each: a face with a side in common is outside
    sides = np.zeros(len(surface.vertices), dtype=np.uint8)
    for axis in range(3):
        column = surface.vertices[:, axis]
        sides |= (column < low[axis]).astype(np.uint8) << 2 * axis
        sides |= (column > high[axis]).astype(np.uint8) << 2 * axis + 1
    a, b, c = (sides[corner] for corner in surface.faces.T)
    out: NDArray[np.bool_] = (a & b & c) == 0
    return out


def normals_at(surface: Surface, rows: NDArray) -> Float:
    """Return the unit normals (r, 3) at some vertices."""
    chosen = np.zeros(len(surface.vertices), dtype=bool)
    chosen[rows] = True
    part = Region.cut(surface, triples.some(chosen[surface.faces]))
    return np.asarray(part.surface.vertex_normals[np.searchsorted(part.vertex, rows)])
