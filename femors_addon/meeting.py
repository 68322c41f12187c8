# SPDX-License-Identifier: GPL-3.0-or-later
"""Edges of two bodies that pierce each other's faces, looked for again and again while the bodies move.

Which faces are near each other is remembered, with some slack: until the bodies have moved by as much, no
other pair can cross, and only those are tested. What is found is what `intersect.piercings` finds.
"""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from . import balls, intersect, triples
from .bodies import Solid
from .crew import together
from .cutouts import Region
from .mesh import Float, Int, Surface

Index = NDArray[np.int64]

WIDE = 3.0  # slacks: faces that are farther apart are not kept
SLACK = 0.15  # mean edges of the finer body: how far bodies may move before faces are searched anew
REACH = 0.58  # of a face's longest side: no place in it is farther from its nearest corner (1 / sqrt 3)
AT_ONCE = 20_000  # faces searched together


@dataclasses.dataclass(frozen=True, eq=False)
class Pierced:
    """Edges (k, 2) by their vertices, lower first, and where (k,) on them; in the order of edge and face."""

    ends: Int
    t: Float

    @classmethod
    def none(cls) -> Pierced:
        """Return no edges."""
        return cls(np.zeros((0, 2), np.int32), np.zeros(0))


class Meeting:
    """Two bodies, and the faces of each that may cross the other's."""

    def __init__(self, one: Solid, two: Solid) -> None:
        self._bodies = one, two
        self._slack = SLACK * min(one.edge, two.edge)
        self._parts: tuple[Region, Region] | None = None  # the faces
        self._places: list[Float] = []  # and where all vertices of both were when these were searched
        self._pairs = (np.zeros(0, np.int64), np.zeros(0, np.int64))  # by their numbers in these parts

    def forget(self) -> None:
        """Search anew the next time."""
        self._parts = None

    def pierced(self, shifts: tuple[Float, Float], bounds: tuple[Float, Float]) -> tuple[Pierced, Pierced]:
        """Find the edges of each body that pierce the other.

        Parameters
        ----------
        shifts : (3,), (3,)
            By which the bodies stand off their places.
        bounds : (n,), (m,)
            No vertex of the one is nearer to the other, and the other way round.
        """
        if self._outdated(shifts):
            self._search(shifts, bounds)
        if not len(self._pairs[0]):
            return Pierced.none(), Pierced.none()
        assert self._parts is not None
        now = [
            Surface(body.vertices[part.vertex] + shift, part.surface.faces)
            for body, part, shift in zip(self._bodies, self._parts, shifts, strict=True)
        ]
        planes = intersect.Planes.of(*now)
        f, g = self._pairs
        size = balls.AT_ONCE
        blocks = [slice(start, start + size) for start in range(0, len(f), size)]
        found = together([partial(_tested, planes, f[block], g[block]) for block in blocks])
        return (
            _edges([one for one, _ in found], self._parts[0], len(now[1].faces)),
            _edges([two for _, two in found], self._parts[1], len(now[0].faces)),
        )

    def _outdated(self, shifts: tuple[Float, Float]) -> bool:
        """Whether faces may cross that did not count as near when they were searched.

        Those that are kept are by the slack apart where they are no pair, the others by three.
        """
        if self._parts is None:
            return True
        near = far = 0.0
        for body, part, place, shift in zip(self._bodies, self._parts, self._places, shifts, strict=True):
            moved = triples.length(body.vertices + shift - place)
            near += float(moved[part.vertex].max(initial=0.0))
            far += float(moved.max(initial=0.0))
        return near > self._slack or far > WIDE * self._slack

    def _search(self, shifts: tuple[Float, Float], bounds: tuple[Float, Float]) -> None:
        """Look for the faces that may cross before the bodies have moved by the slack."""
        parts = [
            Region.near(body.surface, bound, shift, body.longest_now, REACH, WIDE * self._slack)
            for body, bound, shift in zip(self._bodies, bounds, shifts, strict=True)
        ]
        self._parts = parts[0], parts[1]
        self._places = [body.vertices + shift for body, shift in zip(self._bodies, shifts, strict=True)]
        self._pairs = np.zeros(0, np.int64), np.zeros(0, np.int64)
        one, two = (part.surface for part in parts)
        if not len(one.faces) or not len(two.faces):
            return
        classes = [balls.size_classes(s, np.arange(len(s.faces))) for s in (one, two)]
        jobs = [
            partial(_near, a, b, slice(start, start + AT_ONCE), self._slack)
            for a in classes[0]
            for b in classes[1]
            for start in range(0, len(a.face), AT_ONCE)
        ]
        # a large face is searched in pieces
        keys = np.unique(np.concatenate([f * len(two.faces) + g for f, g in together(jobs)]))
        self._pairs = keys // len(two.faces), keys % len(two.faces)


def _near(one: balls.Balls, two: balls.Balls, part: slice, slack: float) -> tuple[Index, Index]:
    """Return the pairs of faces of which balls are within the slack of each other."""
    rows = one.tree.indices[part]
    reach = float(one.radius.max() + two.radius.max()) * (1.0 + 1e-9) + slack
    tree = cKDTree(one.tree.data[rows], balanced_tree=False)
    pairs = tree.sparse_distance_matrix(two.tree, reach, output_type="ndarray")
    f, g = rows[pairs["i"]], pairs["j"]
    near = pairs["v"] <= (one.radius[f] + two.radius[g]) * (1.0 + 1e-9) + slack
    return one.face[f[near]].astype(np.int64), two.face[g[near]].astype(np.int64)


def _tested(planes: list[intersect.Planes], f: Index, g: Index) -> tuple[tuple, tuple]:
    """Test pairs of faces; return (ends, face, t) of edges that pierce: of the first, and of the second."""
    one, two = planes
    f, g, f_over_g, g_over_f = intersect.straddling(one, f, two, g)
    row, ends, t = intersect.pierced(one, f, two, g, f_over_g, False)
    first = ends, g[row], t
    row, ends, t = intersect.pierced(two, g, one, f, g_over_f, False)
    return first, (ends, f[row], t)


def _edges(found: list[tuple], part: Region, count: int) -> Pierced:
    """Put together what was found of the edges of one body; each face at an edge has found it."""
    ends, face, t = (np.concatenate(column) for column in zip(*found, strict=True))
    n = len(part.vertex)
    _, rank = np.unique(ends[:, 0].astype(np.int64) * n + ends[:, 1], return_inverse=True)
    _, first = np.unique(rank * count + face, return_index=True)
    return Pierced(part.vertex[ends[first]], t[first])
