# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces that stay folded or crossing when the displacement is smoothed: their nodes are spread out anew.

Where source and target differ in shape, thin plates and slender faces above all, no smooth displacement of
the source's own patch may lie flat on the target. The patch around such a face is then laid out as Tutte
(1963) embeds a graph: each node at the mean of its neighbours, all weighing alike, which folds no face
of a flat patch; and is laid back onto the target. What is bad even so gives up some of the fit
(`stepback`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from . import triples
from .correspond import compatible
from .faults import Judge, State, slender
from .folds import Reference
from .mesh import Float, Int, Surface
from .morph_settings import MorphSettings
from .nearest import SurfaceIndex
from .patches import Hanging, Part, evened, patch
from .progress import Progress, silent
from .progress import part as section
from .quality import aspect_ratio, flipped_faces
from .stepback import BACK, ROUNDS, hopeless, step_back

PATCHES = (1, 2, 3, 4, 6)  # edges around a bad face, one attempt after the other
LARGEST = 0.06  # of the nodes: a patch may have so many, or a process could be smoothed away
REACH = 16  # edges around a bad face that may move: all patches, one after the other, reach as far
FARTHEST = 1.5  # mean edges: how far a node may go, or it would be another fault
FARTHER, LOSS = 5.0, 0.05  # mean edges, and of the size: as the last resort
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
        Faces that are known to be folded or to cross others; crossings are looked for of these, of others
        that want mending, and of what moves.

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
    wanting = np.union1d(known, np.flatnonzero(aspect_ratio(moved) > slender(rest))).astype(np.int32)
    if not len(wanting):
        return displacement, 0
    may = ~aligned.border if free is None else ~aligned.border & (free > 0)
    far = FARTHEST * moved.mean_edge
    part = Part.around(wanting, moved, may, REACH, far)
    judge = Judge(rest, reference, part)
    begun = judge.state(positions[part.nodes], np.searchsorted(part.faces, wanting))
    unseen = len(np.setdiff1d(known, part.faces[begun.worst]))  # a component inside out, all of it
    state = spread_out(judge, begun, target, settings, CLOSE, section(progress, 0.0, 0.3))
    lost = hopeless(begun, state)  # then the last resort alone: the others take as long, and help as little
    if len(state.worst) and not lost:
        loose = spread_out(judge, begun, target, settings, 0.0, section(progress, 0.3, 0.6))
        if len(loose.worst) < len(state.worst):
            state = loose
    out = part.carried(positions, state.positions)
    farther = max(far, min(FARTHER * moved.mean_edge, LOSS * target.surface.diagonal))
    for limit, stage in ((far, (0.6, 0.8)), (farther, (0.8, 1.0)))[lost:]:
        if not len(state.worst):  # else fit is given up where it takes that
            break
        worst = part.faces[state.worst]
        part = Part.around(worst, aligned.moved(out), may, max(BACK), limit)
        judge = Judge(rest, reference, part)
        state = judge.state(out[part.nodes], np.searchsorted(part.faces, worst))
        state = step_back(judge, state, target, settings, section(progress, *stage))
        out = part.carried(out, state.positions)
    changed = (out != positions).any(axis=1)  # rounding must not move the others
    after = displacement.copy()
    after[changed] = out[changed] - aligned.vertices[changed]
    return after, unseen + len(state.worst)


def spread_out(
    judge: Judge,
    state: State,
    target: SurfaceIndex,
    settings: MorphSettings,
    close: float,
    progress: Progress = silent,
) -> State:
    """Lay patches around bad faces out anew, one width after the other, and keep those that are better so.

    Those nodes that lie within `close` mean edges of the target are laid on it again and again, whichever
    way they face, and squeezed faces get their room; without, only those that face as the target does, and
    once, at the end.
    """
    part, aligned = judge.part, judge.aligned
    for number, rings in enumerate(PATCHES):
        progress(number / len(PATCHES), "mending folded faces")
        # beyond the target's reach a squeezed face is none of our business
        at = np.flatnonzero(state.bad) if close else state.worst
        if not len(at):
            break
        inside = patch(aligned, at, rings) & part.may
        trial = _evened_onto(
            aligned, state.positions, np.flatnonzero(inside), rings, target, settings, close * part.edge
        )
        after = judge.after(state, trial)
        patches = Hanging.of(aligned, inside)
        fewer = patches.better(state.bad, after.bad)
        fewer &= patches.small(triples.length(trial - state.positions), LARGEST * part.count, part.far)
        if not fewer.all():
            after = judge.after(state, np.where(fewer[:, None], trial, state.positions))
        if after.bad.sum() < state.bad.sum():
            state = after
    return state


def _evened_onto(
    aligned: Surface,
    positions: Float,
    nodes: Int,
    rings: int,
    target: SurfaceIndex,
    settings: MorphSettings,
    close: float,
) -> Float:
    """Move nodes, all being at positions (k, 3), towards the mean of their neighbours and onto the target."""
    out = positions
    for number in range(1, rings + 1):
        out = evened(aligned, out, nodes, ROUNDS)
        if close or number == rings:
            point, kept = compatible(aligned.moved(out), nodes, target, settings.partial, close)
            step = point[kept] - out[nodes[kept]]
            out[nodes[kept]] += settings.projection * step
    return out
