# SPDX-License-Identifier: GPL-3.0-or-later
"""Alignment: the source laid onto the target as a whole, rigid, similar or affine, from any starting pose.

The start comes from landmarks, or from all the ways to lay the principal axes together (`poses`); ICP
leads from there (`icp`).
"""

from __future__ import annotations

import dataclasses
from functools import partial as bound

import numpy as np

from .crew import at_once
from .icp import Cloud, Fit, Registration, icp, matched
from .mesh import Float, Surface
from .nearest import SurfaceIndex
from .poses import best_start, canonical_frame, decided
from .progress import Progress, silent
from .transforms import inverse, landmark_transform, transformed
from .units import unit_factor, unlike_sizes

TOLERANCE = 1e-5  # of the target's size: ICP ends when no sample moves by more
DOUBT = "the part fits the whole in several places about equally well: look at the pose, or give landmarks"
DOUBT_WHOLE = (
    "the source fits the target about equally well in quite different poses: "
    "look at the pose, or give landmarks"
)
CHECK_STEPS = 40  # of ICP with all samples, before a mirror image is spoken of
LOOK = 2000  # nodes of each mesh whose distances decide where the samples do not
MIRROR_MARGIN = 0.85  # a mirrored fit must be better by this factor to be spoken of


@dataclasses.dataclass(frozen=True, eq=False)
class Alignment:
    """Where the source is laid before it is deformed.

    Attributes
    ----------
    matrix : (4, 4) float64
        Source coordinates to aligned coordinates, for column vectors.
    residual : float
        Root mean square distance between the aligned samples, in the target's unit.
    warnings : tuple of str
        A unit mismatch, a mirrored pair, a pose that is one of several.
    """

    matrix: Float
    residual: float
    warnings: tuple[str, ...] = ()


def align(
    source: Surface,
    target: Surface,
    kind: str = "affine",
    *,
    partial: str = "none",
    fix_units: bool = False,
    fix_mirror: bool = False,
    landmarks: tuple[Float, Float] | None = None,
    samples: tuple[Surface, Surface] | None = None,
    progress: Progress = silent,
) -> Alignment:
    """Lay the source onto the target.

    Parameters
    ----------
    source, target : Surface
        Cleaned surfaces.
    kind : {"none", "rigid", "similarity", "affine"}
        What the transform may do.
    partial : {"none", "source", "target"}
        Which of the two shows only a part of the other.
    fix_units, fix_mirror : bool
        Apply a unit factor or a mirror image where one is found; otherwise only say so.
    landmarks : ((k, 3), (k, 3)), optional
        Paired landmarks on source and target: the start, instead of trying poses.
    samples : (Surface, Surface), optional
        Reduced versions of the two, to search with, where they are there already.

    Raises
    ------
    FemorsError
        Landmarks that fix no transform (`landmark_transform`).
    Cancelled
        From `progress`.
    """
    factor, said = _units(source, target, partial, fix_units)
    # to scale a source that seems to be in another unit would be to convert the unit unasked
    rigid = bool(said) and factor is None
    said += unlike_sizes(source, target, partial)
    start = np.eye(4) if factor is None else np.diag([factor, factor, factor, 1.0])
    if kind == "none":
        work = _registration(source, target, partial, start, samples)
        return Alignment(start, float(matched(work, np.eye(4)[None]).misfit[0]), said)
    kind = "rigid" if rigid else kind
    progress(0.0, "alignment: samples")
    # in its own principal frame the source is reduced alike from whatever pose it comes
    canonical = canonical_frame(transformed(start, source.vertices))
    start = canonical @ start
    work = _registration(source, target, partial, start, samples)
    if landmarks is not None:
        points = transformed(start, landmarks[0])
        first = landmark_transform(points, landmarks[1], "rigid" if kind == "rigid" else "similarity")
    else:
        meshes = source.moved(transformed(start, source.vertices)), target
        first, mirrored = _choose_hand(work, meshes, inverse(canonical), kind, fix_mirror, progress)
        said += mirrored
    matrix, residual = _refined(work, first, kind, progress)
    progress(1.0, "alignment")
    return Alignment(matrix @ start, residual, said)


def _units(source: Surface, target: Surface, partial: str, fix: bool) -> tuple[float | None, tuple[str, ...]]:
    """Return (the factor to apply, what to say): a factor that seems needed is applied only if wished."""
    factor = unit_factor(source, target, partial)
    if factor is None:
        return None, ()
    words = f"the source seems to be in another unit: {factor:g} times its size would fit the target"
    if fix:
        return factor, (words + ", and was applied",)
    words += (
        "; tick Convert units to apply it (it was not scaled), or set Overlap if one is a part of the other"
    )
    return None, (words,)


def _registration(
    source: Surface,
    target: Surface,
    partial: str,
    start: Float,
    samples: tuple[Surface, Surface] | None,
) -> Registration:
    """The two as ICP needs them, the source moved by `start`."""
    one, two = samples or (None, None)
    moved = source.moved(transformed(start, source.vertices))
    sample = None if one is None else one.moved(transformed(start, one.vertices))
    ours, theirs = at_once(lambda _: Cloud.of(moved, sample), lambda _: Cloud.of(target, two))
    return Registration(ours, theirs, partial, TOLERANCE * target.diagonal)


def _choose_hand(
    work: Registration,
    meshes: tuple[Surface, Surface],
    own: Float,
    kind: str,
    fix: bool,
    progress: Progress,
) -> tuple[Float, tuple[str, ...]]:
    """Best start of the source as it is, and of its mirror image; which, and what to say of it.

    `meshes` are the two that `work` has samples of: where the samples tell too little, these do.
    """
    progress(0.05, "alignment: starting pose")
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    plain, other = at_once(
        lambda _: best_start(work, own, kind, np.eye(4)),
        lambda _: best_start(work, own, kind, mirror),
    )
    words = DOUBT if work.partial != "none" else DOUBT_WHOLE
    if plain.misfit <= work.tolerance or other.misfit > plain.misfit:
        plain = decided(work, plain, own, kind)
        return plain.matrix, (words,) if plain.doubtful else ()
    plain, other = at_once(
        lambda _: decided(work, plain, own, kind),
        lambda _: decided(work, other, own @ mirror, kind),
    )
    doubt = (words,) if plain.doubtful else ()
    # the search ends with few samples, and one of the two may have stopped short
    one, two = icp(work, np.array([plain.matrix, other.matrix]), kind, CHECK_STEPS)
    misfits = one.misfit, two.misfit
    if work.partial == "none" and MIRROR_MARGIN * one.misfit < two.misfit < one.misfit:
        one, two = at_once(*(bound(_refined, work, fit.matrix, kind) for fit in (plain, other)))
        index = SurfaceIndex(meshes[1])
        misfits = _apart(meshes[0], index, one.matrix), _apart(meshes[0], index, two.matrix)
    if misfits[1] > MIRROR_MARGIN * misfits[0]:
        return plain.matrix, doubt
    better = 100 * (1 - misfits[1] / misfits[0])
    told = f"the source's mirror image fits the target better by {better:.0f} % (left against right?)"
    if fix:
        doubt = (words,) if other.doubtful else ()
        return other.matrix, (told + "; it was mirrored", *doubt)
    if work.partial == "none":  # the wrong hand fits nowhere well
        doubt = ()
    return plain.matrix, (told + "; tick Mirror if better to use it", *doubt)


def _apart(source: Surface, target: SurfaceIndex, matrix: Float) -> float:
    """Root mean square distance of some nodes of each to the other's surface, the source being moved.

    Samples are as far from the nearest node as nodes are from each other: of a shape that is nearly its own
    mirror image they tell little.
    """
    moved = SurfaceIndex(source.moved(transformed(matrix, source.vertices)))
    squares = [
        there.closest(here.surface.vertices[:: max(len(here.surface.vertices) // LOOK, 1)]).distance ** 2
        for here, there in ((moved, target), (target, moved))
    ]
    return float(np.sqrt(np.mean([part.mean() for part in squares])))


def _refined(work: Registration, first: Float, kind: str, progress: Progress) -> Fit:
    """ICP with all samples, freer from kind to kind."""
    progress(0.6, "alignment: rigid")
    (fit,) = icp(work, first[None], "rigid", 60)
    if kind != "rigid":
        progress(0.7, f"alignment: {kind}")
        (fit,) = icp(work, fit.matrix[None], "similarity", 60)
    if kind == "affine":
        (fit,) = icp(work, fit.matrix[None], "affine", 100)
    return fit
