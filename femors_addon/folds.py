# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces that a displacement folds over, presses flat or makes cross others, and smoothing that mends them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from . import triples
from .cached import cached_property
from .crew import at_once
from .intersect import self_intersections
from .mesh import Float, Int, Surface
from .progress import Progress, silent

PATCHES = (1, 1, 2, 2, 3, 3, 4)  # edges around a bad face, one attempt after the other
FLAT = 1e-3  # height by longest side: a face below it is pressed flat


@dataclasses.dataclass(frozen=True, eq=False)
class Reference:
    """A surface that moved ones are compared with, and what was wrong with it already."""

    surface: Surface

    @cached_property
    def slimness(self) -> Float:
        """Height over longest side (m,) of each face."""
        return _slimness(self.surface)

    @cached_property
    def crossing(self) -> Int:
        """Faces (k,) int32 that cross others, ascending."""
        return self.crossed(silent)

    def crossed(self, progress: Progress) -> Int:
        """Return `crossing`; where that is not known, with a word now and then."""
        if "crossing" not in self.__dict__:
            self.__dict__["crossing"] = np.unique(self_intersections(self.surface, progress))
        return np.asarray(self.__dict__["crossing"])


def folded(reference: Reference, moved: Surface, rows: NDArray | slice = slice(None)) -> Int:
    """Faces folded over or pressed flat, or about to be, in `moved`, but not in `reference`.

    Where `moved` is a part of the mesh, `rows` (m,) tells which faces of the reference it has.

    A face folds over against its own surroundings. It is pressed flat where nodes come to lie on one
    point or line, as they may where a coarse target has a corner.
    """
    before = reference.surface.facing[rows]
    over = (before > 0) & (moved.facing < np.minimum(0.05, 0.5 * before))
    flat = (_slimness(moved) < FLAT) & (reference.slimness[rows] >= FLAT)
    return np.flatnonzero(over | flat).astype(np.int32)


def _slimness(surface: Surface) -> Float:
    """Height over longest side (m,) of each face; 0 without a side."""
    longest = surface.told(triples.longest_side)
    return 2.0 * surface.face_areas / np.maximum(longest, np.finfo(float).tiny)


def bad_faces(reference: Reference, moved: Surface, progress: Progress = silent) -> Int:
    """Faces folded over or crossing others in `moved`, though not in `reference`."""
    moved.face_cross  # noqa: B018  both ask for it: worked out once
    pairs, over = at_once(
        lambda word: self_intersections(moved, word),
        lambda _: folded(reference, moved),
        progress=progress,
    )
    crossing = np.unique(pairs)
    if len(crossing):
        crossing = np.setdiff1d(crossing, reference.crossed(progress))
    return np.union1d(over, crossing).astype(np.int32)


def unfolded(
    reference: Reference,
    displacement: Float,
    mean: sparse.csr_matrix,
    judge: Callable[[Reference, Surface], Int],
    free: Float | None = None,
) -> tuple[Float, Int]:
    """Mend faces that fold over or cross others, by as little as helps.

    Around each bad face the displacement is replaced by the harmonic one that its surroundings ask
    for, in a patch that grows until the face is well: far enough out, the patch moves as one.
    `judge` names the bad faces of a reference and a moved surface; where folds alone do not end it, it
    is asked once they are gone: `bad_faces` costs more than `folded`. Nodes whose `free` is 0 stay.

    Returns
    -------
    displacement : (n, 3) float64
        The best state met: with the fewest folds, then with the fewest bad faces.
    left : (k,) int32
        Bad faces in it, as `judge` names them.
    """
    surface = reference.surface
    best, left, current = displacement, None, displacement
    fewest = (len(surface.faces) + 1, 0)
    for rings in (*PATCHES, 0):
        moved = surface.moved(surface.vertices + current)
        faces = folded(reference, moved)
        # with no fewer folds than the best it has no chance; `judge` costs
        folds, judged = len(faces), not len(faces) or (not rings and len(faces) < fewest[0])
        if judged:
            faces = judge(reference, moved)
        if (folds, len(faces)) < fewest:
            best, left, fewest = current, faces if judged else None, (folds, len(faces))
        if not len(faces) or not rings:
            break
        current = _harmonic(current, surface.faces[faces].ravel(), mean, rings, free)
    if left is None:  # only its folds are known
        left = judge(reference, surface.moved(surface.vertices + best))
    return best, left


def _harmonic(
    displacement: Float, nodes: Int, mean: sparse.csr_matrix, rings: int, free: Float | None
) -> Float:
    """Replace the displacement within `rings` edges of the nodes by the mean of its neighbours."""
    inside = np.zeros(len(displacement), dtype=bool)
    inside[nodes] = True
    for _ in range(rings - 1):
        inside |= mean @ inside.astype(float) > 0
    if free is not None:
        inside &= free > 0
    return harmonic(displacement, inside, mean, rings)


def harmonic(displacement: Float, inside: np.ndarray, mean: sparse.csr_matrix, rings: int) -> Float:
    """Replace the displacement of the nodes `inside` (n,) by the mean of its neighbours, over and over."""
    rows = mean[np.flatnonzero(inside)]
    out = displacement.copy()
    for _ in range(4 * rings * rings):
        out[inside] = rows @ out
    return out
