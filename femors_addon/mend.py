# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces that stay folded or crossing when the displacement is smoothed: their nodes are spread out anew.

Where source and target differ in shape, thin plates and slender faces above all, no smooth displacement of
the source's own patch may lie flat on the target. The patch around such a face is then laid out as Tutte
(1963) embeds a graph: each node at the mean of its neighbours, all weighing alike, which folds no face
of a flat patch; and is laid back onto the target.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from . import triples
from .correspond import FACING, at_border, interpolated_normals
from .folds import Reference, folded
from .intersect import enclosing_balls, self_intersections
from .mesh import Float, Int, Surface
from .morph_settings import MorphSettings
from .nearest import SurfaceIndex
from .progress import Progress, silent
from .progress import part as section
from .quality import aspect_ratio, flipped_faces

PATCHES = (1, 2, 3, 4, 6)  # edges around a bad face, one attempt after the other
ROUNDS = 8  # of averaging, per edge of the patch's width
SLENDER, GROWTH = 10.0, 3.0  # aspect ratio, and times that of the source, beyond which a face is squeezed
SQUEEZED = 0.1  # what a squeezed face counts beside one that is folded or crosses others
LARGEST = 0.06  # of the nodes: a patch may have so many, or a process could be smoothed away,
FARTHEST = 1.5  # mean edges: and its nodes may go so far
REACH = 16  # edges around the bad faces that may move: all patches, one after the other, reach as far
CLOSE = 0.5  # mean edges: so near the target a node is laid on it whichever way it faces


def mended(
    rest: Surface,
    reference: Reference,
    displacement: Float,
    target: SurfaceIndex,
    free: Float | None,
    settings: MorphSettings,
    progress: Progress = silent,
    left: ArrayLike = (),
) -> tuple[Float, int]:
    """Spread out the nodes around faces that fold over or cross others or are squeezed, where it helps.

    Parameters
    ----------
    rest : Surface
        The source as it was, which tells what was folded before.
    reference : Reference
        The source as the displacement starts from.
    displacement : (n, 3) float64
        The state to be mended.
    target : SurfaceIndex
        What the nodes are laid onto.
    free : (n,) float64 or None
        0 for the nodes that stay, as those of an open border do.
    settings : MorphSettings
        Where nodes are not to lie on the target (`projection` 0), nothing is mended here.
    progress : Progress
        May raise `Cancelled`.
    left : (k,) int
        Faces that are known to be folded or to cross others; crossings are not looked for elsewhere than
        around these and others that want mending.

    Returns
    -------
    displacement : (n, 3) float64
        Unchanged but in the patches that have fewer bad faces so.
    left : int
        Faces folded or crossing in it.
    """
    left = np.asarray(left, dtype=np.int32)
    if settings.projection == 0:
        return displacement, len(left)
    aligned = reference.surface
    positions = aligned.vertices + displacement
    moved = aligned.moved(positions)
    known = np.union1d(left, flipped_faces(rest, moved))
    wanting = np.union1d(known, np.flatnonzero(_squeezed(rest, moved))).astype(np.int32)
    if not len(wanting):
        return displacement, 0
    may = ~aligned.border if free is None else ~aligned.border & (free > 0)
    part = _Part.around(wanting, moved, may)
    work = _Patches(part.of(rest), Reference(part.of(aligned)), part, target, settings)
    begun = positions[part.nodes]
    pairs = self_intersections(part.of(moved))
    bad = work.badness(begun, pairs)
    unseen = len(np.setdiff1d(known, part.faces[bad >= 1.0]))  # a component inside out, all of it
    best, still = work.mend(begun, pairs, bad, CLOSE, section(progress, 0.0, 0.5))
    if (still >= 1.0).any():
        loose, after = work.mend(begun, pairs, bad, 0.0, section(progress, 0.5, 1.0))
        if (after >= 1.0).sum() < (still >= 1.0).sum():
            best, still = loose, after
    changed = (best != begun).any(axis=1)  # rounding must not move the others
    out = displacement.copy()
    out[part.nodes[changed]] = best[changed] - aligned.vertices[part.nodes[changed]]
    return out, unseen + int((still >= 1.0).sum())


@dataclasses.dataclass(frozen=True, eq=False)
class _Part:
    """The part of a mesh that mending can touch, with all that its faces may come to cross.

    Attributes
    ----------
    nodes, faces : (k,), (j,) int32
        Rows in the whole mesh, ascending.
    corners : (j, 3) int32
        Corners of the faces as rows of `nodes`.
    may : (k,) bool
        Nodes that may move.
    whole : (j,) bool
        Faces whose corners have all their faces here, so that folds can be told.
    edge : float
        Mean edge of the whole mesh, and
    count : int
        its nodes.
    """

    nodes: Int
    faces: Int
    corners: Int
    may: np.ndarray
    whole: np.ndarray
    edge: float
    count: int

    @classmethod
    def around(cls, wanting: Int, moved: Surface, may: np.ndarray) -> _Part:
        """The part around the faces that want mending."""
        inside = _patch(moved, wanting, REACH)
        wide = _patch(moved, wanting, REACH + 1)
        moving = triples.some((inside & may).take(moved.faces))
        centre, radius = enclosing_balls(moved.corners)
        edge, used = moved.mean_edge, np.flatnonzero(moving)
        near = triples.some(wide.take(moved.faces))
        if len(used):
            # a face may go so far, and grow by twice that
            limit = radius + radius[used].max() + 3.0 * FARTHEST * edge
            away = cKDTree(centre[used]).query(centre, distance_upper_bound=float(limit.max()) * 1.01)[0]
            near |= away <= limit
        faces = np.flatnonzero(near).astype(np.int32)
        nodes, corners = triples.renumbered(moved.faces[faces], len(moved.vertices))
        whole = triples.every(wide.take(moved.faces[faces]))
        return cls(nodes, faces, corners, (inside & may)[nodes], whole, edge, len(moved.vertices))

    def of(self, surface: Surface) -> Surface:
        """The part of the mesh at some positions."""
        return Surface(surface.vertices[self.nodes], self.corners)


@dataclasses.dataclass(frozen=True, eq=False)
class _Patches:
    """What stays the same through all attempts."""

    rest: Surface
    reference: Reference
    part: _Part
    target: SurfaceIndex
    settings: MorphSettings

    @property
    def aligned(self) -> Surface:
        """The part as the displacement starts from."""
        return self.reference.surface

    def mend(
        self, positions: Float, pairs: Int, bad: Float, close: float, progress: Progress
    ) -> tuple[Float, Float]:
        """Try one width after the other; return positions (k, 3) and how bad each face is there (j,).

        `pairs` (q, 2) are the faces that cross at the positions given, and `bad` (j,) their badness.
        """
        for number, rings in enumerate(PATCHES):
            progress(number / len(PATCHES), "mending folded faces")
            # beyond the target's reach a squeezed face is none of our business
            at = np.flatnonzero(bad if close else bad >= 1.0)
            if not len(at):
                break
            inside = _patch(self.aligned, at, rings) & self.part.may
            trial = self._spread_out(positions, np.flatnonzero(inside), rings, close)
            crossed = self._crossed(pairs, positions, trial)
            after = self.badness(trial, crossed)
            better = _better(self.aligned, inside, bad, after)
            better &= self._small(inside, np.linalg.norm(trial - positions, axis=1))
            trial[~better] = positions[~better]
            if not better.all():
                crossed = self._crossed(pairs, positions, trial)
                after = self.badness(trial, crossed)
            if after.sum() < bad.sum():
                positions, bad, pairs = trial, after, crossed
        return positions, bad

    def _spread_out(self, positions: Float, nodes: Int, rings: int, close: float) -> Float:
        """Move the nodes towards the mean of their neighbours, all weighing alike, and onto the target.

        Those that lie within `close` mean edges of it are laid on it again and again, whichever way they
        face; without, only those that face as the target does, and once, at the end.
        """
        aligned, target, edge = self.aligned, self.target, self.part.edge
        rows = aligned.adjacency[nodes]
        rows = sparse.diags(1.0 / np.maximum(np.asarray(rows.sum(axis=1)).ravel(), 1.0)) @ rows
        out = positions.copy()
        for number in range(1, rings + 1):
            for _ in range(ROUNDS):
                out[nodes] = 0.5 * (out[nodes] + rows @ out)
            if close or number == rings:
                moved = aligned.moved(out)
                found = target.closest(out[nodes])
                normals = interpolated_normals(target.surface, found.face, found.barycentric)
                kept = np.einsum("ij,ij->i", moved.vertex_normals[nodes], normals) > FACING
                kept |= found.distance < close * edge
                if self.settings.partial != "none":
                    kept &= ~at_border(target.surface, found.face, found.barycentric)
                step = found.point[kept] - out[nodes[kept]]
                out[nodes[kept]] += self.settings.projection * step
        return out

    def _small(self, inside: np.ndarray, movement: Float) -> np.ndarray:
        """False (n,) for the nodes of patches that are a good part of the mesh, or move far."""
        patch, count = _hanging(self.aligned, inside)
        size = np.bincount(patch, minlength=count + 1)
        far = np.zeros(count + 1)
        np.maximum.at(far, patch, movement)
        small = (size <= LARGEST * self.part.count) & (far <= FARTHEST * self.part.edge)
        small[count] = True
        return np.asarray(small[patch])

    def _crossed(self, pairs: Int, before: Float, after: Float) -> Int:
        """Return the pairs of faces (k, 2) that cross, where `pairs` did before some nodes moved.

        Only faces that moved, and those near them, are tested.
        """
        faces = self.aligned.faces
        moved = triples.some(triples.some(before != after).take(faces))
        if not moved.any():
            return pairs
        (old, reach_old), (new, reach_new) = (
            enclosing_balls(where.take(faces, axis=0)) for where in (before, after)
        )
        tree = cKDTree(np.concatenate((old[moved], new[moved])))
        reach = max(float(reach_old[moved].max()), float(reach_new[moved].max()))
        limit = (reach + reach_new) * (1.0 + 1e-9)
        near = np.flatnonzero(tree.query(new, distance_upper_bound=float(limit.max()) * 1.01)[0] <= limit)
        found = near[self_intersections(Surface(after, faces[near]))].astype(np.int32).reshape(-1, 2)
        kept = pairs[~moved[pairs].any(axis=1)]
        return np.concatenate((kept, found[moved[found].any(axis=1)]))

    def badness(self, positions: Float, pairs: Int) -> Float:
        """Return 1 (j,) for the faces folded over or crossing others, though neither in `rest` nor in the
        reference; `SQUEEZED` for those squeezed, and 0 for the others.

        `pairs` (q, 2) are the faces that cross.
        """
        moved = self.aligned.moved(positions)
        out = SQUEEZED * _squeezed(self.rest, moved)
        out[folded(self.reference, moved)] = 1.0
        out[flipped_faces(self.rest, moved)] = 1.0
        out[~self.part.whole] = 0.0
        out[np.setdiff1d(np.unique(pairs), self.reference.crossing)] = 1.0
        return out


def _squeezed(rest: Surface, moved: Surface) -> np.ndarray:
    """True (m,) for the faces far more slender than they were."""
    return aspect_ratio(moved) > np.maximum(SLENDER, GROWTH * aspect_ratio(rest))


def _patch(surface: Surface, faces: Int, rings: int) -> np.ndarray:
    """True (n,) for the nodes within `rings` edges of the faces, their own corners being the first."""
    inside = np.zeros(len(surface.vertices), dtype=bool)
    inside[surface.faces[faces].ravel()] = True
    for _ in range(rings - 1):
        inside |= surface.adjacency @ inside.astype(float) > 0
    return inside


def _hanging(surface: Surface, inside: np.ndarray) -> tuple[Int, int]:
    """Number (n,) of the patch that each node is in, and how many there are; the last stands for none."""
    nodes = np.flatnonzero(inside)
    count, label = csgraph.connected_components(surface.adjacency[nodes][:, nodes], directed=False)
    patch = np.full(len(inside), count, dtype=np.int32)
    patch[nodes] = label
    return patch, int(count)


def _better(surface: Surface, inside: np.ndarray, before: Float, after: Float) -> np.ndarray:
    """True (n,) for the nodes of patches, each hanging together, that are less bad than before."""
    patch, count = _hanging(surface, inside)

    def tally(badness: Float) -> Float:
        counted = np.bincount(patch[surface.faces].ravel(), np.repeat(badness, 3), count + 1)
        return np.asarray(counted, dtype=float)

    fewer = tally(after) < tally(before) - 1e-9
    fewer[count] = True
    return np.asarray(fewer[patch])
