# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces that stay folded or crossing when the displacement is smoothed: their nodes are spread out anew.

Where source and target differ in shape, thin plates and slender faces above all, no smooth displacement of
the source's own patch may lie flat on the target. The patch around such a face is then laid out as Tutte
(1963) embeds a graph: each node at the mean of its neighbours, all weighing alike, which folds no face
of a flat patch; and is laid back onto the target. What is bad even so gives up some of the fit, by
whichever way of stepping back off the target leaves least of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.spatial import cKDTree

from . import triples
from .balls import enclosing_balls
from .cached import cached_property
from .correspond import FACING, at_border, interpolated_normals
from .folds import Reference, folded, harmonic
from .intersect import self_intersections
from .mesh import Float, Int, Surface
from .morph_settings import MorphSettings
from .nearest import SurfaceIndex
from .patches import Part, better, evened, hanging, patch, turned
from .progress import Progress, silent
from .progress import part as section
from .quality import aspect_ratio, flipped_faces
from .relax import averaging

PATCHES = (1, 2, 3, 4, 6)  # edges around a bad face, one attempt after the other
ROUNDS = 8  # of averaging, per edge of the patch's width
SLENDER, GROWTH = 10.0, 3.0  # aspect ratio, and times that of the source, beyond which a face is squeezed
SQUEEZED = 0.1  # what a squeezed face counts beside one that is folded or crosses others
LARGEST = 0.06  # of the nodes: a patch may have so many, or a process could be smoothed away
REACH = 16  # edges around a bad face that may move: all patches, one after the other, reach as far
FARTHEST = 1.5  # mean edges: how far a node may go, or it would be another fault
BACK = (2, 3, 5, 8)  # edges around a bad face that step back
TIMES = 12  # that a way is chosen: where bones have nothing in common each takes away a little, and long
TURNS = (0.3, 1.5)  # heights that a face on its back is given when it is turned over, beside its own
FARTHER, LOSS = 5.0, 0.05  # mean edges, and of the size: as the last resort
APPROACHES, HOLDS = 6, 5  # half-way steps back to the target, and times that nodes of each may be held
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
    wanting = np.union1d(known, np.flatnonzero(aspect_ratio(moved) > _limits(rest))).astype(np.int32)
    if not len(wanting):
        return displacement, 0
    may = ~aligned.border if free is None else ~aligned.border & (free > 0)
    far = FARTHEST * moved.mean_edge
    work = _Patches.around(wanting, rest, aligned, positions, may, target, settings, REACH, far)
    begun = positions[work.part.nodes]
    pairs = self_intersections(work.part.of(moved))
    bad = work.badness(begun, pairs)
    unseen = len(np.setdiff1d(known, work.part.faces[bad >= 1.0]))  # a component inside out, all of it
    best, still = work.mend(begun, pairs, bad, CLOSE, section(progress, 0.0, 0.3))
    if (still >= 1.0).any():
        loose, after = work.mend(begun, pairs, bad, 0.0, section(progress, 0.3, 0.6))
        if (after >= 1.0).sum() < (still >= 1.0).sum():
            best, still = loose, after
    out = work.carried(positions, best)
    farther = max(far, min(FARTHER * moved.mean_edge, LOSS * target.surface.diagonal))
    for limit, stage in ((far, (0.6, 0.8)), (farther, (0.8, 1.0))):
        if not (still >= 1.0).any():  # else fit is given up where it takes that
            break
        left = work.part.faces[still >= 1.0]
        work = _Patches.around(left, rest, aligned, out, may, target, settings, max(BACK), limit)
        begun = out[work.part.nodes]
        bad = work.badness(begun, self_intersections(work.part.of(aligned.moved(out))))
        best, still = work.step_back(begun, bad, section(progress, *stage))
        out = work.carried(out, best)
    changed = (out != positions).any(axis=1)  # rounding must not move the others
    after = displacement.copy()
    after[changed] = out[changed] - aligned.vertices[changed]
    return after, unseen + int((still >= 1.0).sum())


@dataclasses.dataclass(frozen=True, eq=False)
class _Patches:
    """What stays the same through all attempts."""

    rest: Surface
    reference: Reference
    part: Part
    target: SurfaceIndex
    settings: MorphSettings

    @classmethod
    def around(
        cls,
        wanting: Int,
        rest: Surface,
        aligned: Surface,
        positions: Float,
        may: np.ndarray,
        target: SurfaceIndex,
        settings: MorphSettings,
        reach: int,
        far: float,
    ) -> _Patches:
        """What it takes to mend the faces `wanting` of the mesh at `positions` (n, 3); see `Part.around`."""
        part = Part.around(wanting, aligned.moved(positions), may, reach, far)
        return cls(part.of(rest), Reference(part.of(aligned)), part, target, settings)

    @cached_property
    def slender(self) -> Float:
        """Aspect ratio (j,) beyond which each face is squeezed."""
        return _limits(self.rest)

    def carried(self, positions: Float, mended: Float) -> Float:
        """Return all positions (n, 3), those of the part (k, 3) being `mended`."""
        out = positions.copy()
        out[self.part.nodes] = mended
        return out

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
            inside = patch(self.aligned, at, rings) & self.part.may
            trial = self._spread_out(positions, np.flatnonzero(inside), rings, close)
            after = self.badness(trial, self._crossed(pairs, positions, trial))
            fewer = better(self.aligned, inside, bad, after)
            fewer &= self._small(inside, np.linalg.norm(trial - positions, axis=1), LARGEST)
            trial, after, crossed = self._partly(positions, pairs, trial, fewer)
            if after.sum() < bad.sum():
                positions, bad, pairs = trial, after, crossed
        return positions, bad

    def step_back(self, positions: Float, bad: Float, progress: Progress = silent) -> tuple[Float, Float]:
        """Mend what is left at the cost of the fit; return positions (k, 3) and what is bad (j,).

        All the ways that there are (`_ways`) are tried on the patches around bad faces and the best is
        taken, until nothing is bad or no way helps; then nodes return towards the target as far as no face
        gets worse. Nothing goes farther than `part.far` from where it was, which would be another fault.
        """
        pairs = self_intersections(self.aligned.moved(positions))
        mean = averaging(self.aligned)
        begun = positions
        for _ in range(TIMES):
            if not (bad >= 1.0).any():
                break
            found = self._best(begun, positions, pairs, bad, mean, progress)
            if found is None:
                break
            positions, bad, pairs = found
        nodes = np.flatnonzero((positions != begun).any(axis=1))
        nearer, after, _ = self._approached(positions, bad, pairs, nodes, progress)
        far = triples.length(nearer - begun).max(initial=0.0) > self.part.far
        return (positions, bad) if far else (nearer, after)

    def _best(
        self,
        begun: Float,
        positions: Float,
        pairs: Int,
        bad: Float,
        mean: sparse.csr_matrix,
        progress: Progress,
    ) -> tuple[Float, Float, Int] | None:
        """The state after that way of stepping back that leaves least bad; None where none leaves less."""
        best, least = None, (int((bad >= 1.0).sum()), float(bad.sum()))
        for trial, inside in self._ways(positions, np.flatnonzero(bad >= 1.0), mean):
            progress(0.5, "stepping back from the target")
            if not (trial != positions).any():
                continue
            after = self.badness(trial, self._crossed(pairs, positions, trial))
            fewer = better(self.aligned, inside, bad, after)
            fewer &= self._small(inside, triples.length(trial - begun), 1.0)
            state = self._partly(positions, pairs, trial, fewer)
            left = (int((state[1] >= 1.0).sum()), float(state[1].sum()))
            if left < least:
                best, least = state, left
        return best

    def _ways(self, positions: Float, at: Int, mean: sparse.csr_matrix) -> Iterator[tuple[Float, np.ndarray]]:
        """Positions (k, 3) to try against the bad faces `at`, each with the nodes (k,) that it moves.

        A single face that lies on its back is turned over a side; patches are evened out; or they go back
        off the target: `aligned` has neither folds nor crossings that are not its own, and a harmonic
        displacement makes none as long as it differs little from node to node.
        """
        may = self.part.may
        ring = patch(self.aligned, at, 1) & may
        moved = self.aligned.moved(positions)
        for share in TURNS:
            for side in range(3):
                yield np.where(ring[:, None], turned(moved, at, side, share), positions), ring
        for rings in BACK:
            inside = patch(self.aligned, at, rings) & may
            away = harmonic(positions - self.aligned.vertices, inside, mean, rings)
            yield np.where(inside[:, None], self.aligned.vertices + away, positions), inside
            yield evened(self.aligned, positions, np.flatnonzero(inside), ROUNDS * rings), inside

    def _approached(
        self, positions: Float, bad: Float, pairs: Int, nodes: Int, progress: Progress
    ) -> tuple[Float, Float, Int]:
        """Move nodes towards the target as long as no face gets worse; return the state that they reach."""
        for _ in range(APPROACHES if len(nodes) else 0):
            point, kept = self._compatible(positions, nodes)
            step = np.where(kept[:, None], 0.5 * self.settings.projection * (point - positions[nodes]), 0.0)
            held = np.zeros(len(positions), dtype=bool)
            for _ in range(HOLDS):
                progress(0.9, "returning to the target")
                trial = positions.copy()
                trial[nodes] += np.where(held[nodes, None], 0.0, step)
                crossed = self._crossed(pairs, positions, trial)
                after = self.badness(trial, crossed)
                worse = np.flatnonzero(after > bad)
                if not len(worse):
                    positions, bad, pairs = trial, after, crossed
                    break
                held |= patch(self.aligned, worse, 1)
        return positions, bad, pairs

    def _compatible(self, positions: Float, nodes: Int, close: float = 0.0) -> tuple[Float, np.ndarray]:
        """Return the target's points (k, 3) closest to some nodes, and which nodes face as it does (k,)."""
        aligned, target = self.aligned, self.target
        moved = aligned.moved(positions)
        found = target.closest(positions[nodes])
        normals = interpolated_normals(target.surface, found.face, found.barycentric)
        kept = np.einsum("ij,ij->i", moved.vertex_normals[nodes], normals) > FACING
        kept |= found.distance < close * self.part.edge
        if self.settings.partial != "none":
            kept &= ~at_border(target.surface, found.face, found.barycentric)
        return found.point, kept

    def _spread_out(self, positions: Float, nodes: Int, rings: int, close: float) -> Float:
        """Move the nodes towards the mean of their neighbours, all weighing alike, and onto the target.

        Those that lie within `close` mean edges of it are laid on it again and again, whichever way they
        face; without, only those that face as the target does, and once, at the end.
        """
        out = positions
        for number in range(1, rings + 1):
            out = evened(self.aligned, out, nodes, ROUNDS)
            if close or number == rings:
                point, kept = self._compatible(out, nodes, close)
                step = point[kept] - out[nodes[kept]]
                out[nodes[kept]] += self.settings.projection * step
        return out

    def _partly(
        self, positions: Float, pairs: Int, trial: Float, chosen: np.ndarray
    ) -> tuple[Float, Float, Int]:
        """Return the trial at the chosen nodes (n,) only, how bad each face is then, and which cross."""
        trial = np.where(chosen[:, None], trial, positions)
        crossed = self._crossed(pairs, positions, trial)
        return trial, self.badness(trial, crossed), crossed

    def _small(self, inside: np.ndarray, movement: Float, largest: float) -> np.ndarray:
        """False (k,) for the nodes of patches that have more than that share of all, or move far."""
        label, count = hanging(self.aligned, inside)
        size = np.bincount(label, minlength=count + 1)
        far = np.zeros(count + 1)
        np.maximum.at(far, label, movement)
        small = (size <= largest * self.part.count) & (far <= self.part.far)
        small[count] = True
        return np.asarray(small[label])

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
        out = SQUEEZED * (aspect_ratio(moved) > self.slender)
        out[folded(self.reference, moved)] = 1.0
        out[flipped_faces(self.rest, moved)] = 1.0
        out[~self.part.whole] = 0.0
        out[np.setdiff1d(np.unique(pairs), self.reference.crossing)] = 1.0
        return out


def _limits(rest: Surface) -> Float:
    """Aspect ratio (m,) beyond which each face is far more slender than it was."""
    return np.maximum(SLENDER, GROWTH * aspect_ratio(rest))
