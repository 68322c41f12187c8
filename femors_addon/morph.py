# SPDX-License-Identifier: GPL-3.0-or-later
"""Algorithm 1: deform a source mesh onto a target and keep its connectivity.

Both meshes are cleaned, the source is aligned, reduced versions are made, and from the coarsest to
the dense one: displacement vectors are found in both directions, a GRNN smooths them into one field,
the source takes a step along it, and the spread falls. On the dense mesh the nodes are laid onto the
target and the elements regain their shapes. See `schedule` for the numbers, `morph_settings` for what
can be set.
"""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from . import settings as declared
from .cleaning import Cleaned, clean, distinct_nodes
from .correspond import Target, Vectors, by_nearest, by_surface, shortened, widening
from .crew import aside, at_once, crew
from .folds import bad_faces, unfolded
from .grnn import DisplacementField
from .landmark_pairs import Pairs
from .limits import require_memory
from .mend import mended
from .mesh import Float, Int, Surface
from .morph_outcome import Outcome, compared_before, result_of
from .morph_result import MorphResult, Step
from .morph_settings import PRESETS, MorphSettings
from .morph_work import Work
from .outgrowths import reached
from .progress import FemorsError, Preview, Progress, part, repeating, silent
from .relax import Shapes, averaging, guarded, settle, slide
from .schedule import CARRY, Stage, stages
from .steer import Steering
from .strays import without_strays
from .transforms import transformed
from .units import unit_factor
from .watch import Watch

__all__ = ["PRESETS", "MorphResult", "MorphSettings", "morph"]

MEMORY_LEAST, MEMORY_NODE = 30e6, 2.3e3  # bytes: what a morph was measured to take, and per node of both
FIELD_SPREAD = 0.75  # mean edges: the spread of the field that is kept


@crew()
def morph(
    source: Surface,
    target: Surface,
    settings: MorphSettings | None = None,
    progress: Progress = silent,
    *,
    weights: ArrayLike | None = None,
    source_landmarks: ArrayLike | None = None,
    target_landmarks: ArrayLike | None = None,
    landmark_names: Sequence[str] | None = None,
    preview: Preview | None = None,
) -> MorphResult:
    """Morph `source` onto `target`.

    Parameters
    ----------
    source, target : Surface
        As the user has them: unmerged, inverted, open or in several pieces; both in one unit of
        length, or see `MorphSettings.fix_units`.
    settings : MorphSettings, optional
        The *Standard* preset where it is not given.
    progress : Progress
        Called with the fraction done and a text; may raise `Cancelled`.
    weights : (n,) array, optional
        Share, in [0, 1], of the deformation that each source vertex takes. The alignment moves the
        whole mesh all the same.
    source_landmarks, target_landmarks : (k, 3) arrays, optional
        Paired landmarks that the alignment starts from, and that pull with `MorphSettings.steer`.
    landmark_names : sequence of str, optional
        What the pairs are called in warnings; numbers from 1 where not given.
    preview : Preview, optional
        Given the source's vertices after the alignment, each iteration and each round of relaxation.

    Raises
    ------
    FemorsError
        A mesh that is no surface, unpaired landmarks, settings outside their limits, a source that is in
        another unit than the target without `MorphSettings.fix_units`.
    Cancelled
        From `progress`.
    """
    started = time.process_time()
    settings = settings or MorphSettings()
    declared.check(settings)
    nodes = distinct_nodes(source) + distinct_nodes(target)
    require_memory(MEMORY_LEAST + MEMORY_NODE * nodes, f"a morph with {nodes} nodes in both meshes")
    progress(0.0, "cleaning")
    whole, theirs = at_once(
        lambda _: clean(source.vertices, source.faces, "source"),
        lambda _: clean(target.vertices, target.faces, "target"),
    )
    ours, theirs = without_strays(whole, theirs)
    factor = None if settings.fix_units else unit_factor(ours.surface, theirs.surface, settings.partial)
    if factor is not None:  # no deformation makes a bone of a thousandth of one
        raise FemorsError(
            f"the source seems to be in another unit: {factor:g} times its size would fit the target; "
            "tick Convert units to have it scaled, or set Overlap if one is a part of the other"
        )
    pairs = _paired(source_landmarks, target_landmarks, landmark_names, theirs.surface.diagonal)
    work = Work.begun(ours, theirs, settings, pairs, progress)
    if ours is whole:
        whole = work.ours
    ours, theirs = work.ours, work.theirs
    weight = _clean_weights(weights, ours, len(source.vertices))
    watch = Watch(preview, source.vertices, ours, work.alignment.matrix, work.sources)
    watch.dense(np.zeros_like(work.aligned.vertices))
    # how far the two are apart now is only told at the end
    measuring = part(progress, 0.88, 0.9)
    with aside(
        lambda word: compared_before(ours.surface, work.reference, work.index, word), measuring
    ) as before:
        movement = _moved(work, weight, settings, progress, watch)
        compared = before()
    warnings = [*ours.notes, *theirs.notes, *work.alignment.warnings]
    if work.pairs is not None:
        warnings += work.pairs.warnings()
    elif settings.steer:
        warnings.append("landmarks were to pull, but no pairs of them are given")
    if weights is not None and settings.alignment != "none":
        warnings.append(
            "weights limit the deformation, not the alignment; choose no alignment to keep parts still"
        )
    spread = settings.field_spread or FIELD_SPREAD * work.aligned.mean_edge
    field = DisplacementField(work.aligned.vertices, movement.displacement, spread)
    matrix, landed, bad = work.alignment.matrix, movement.landed, movement.bad
    outcome = Outcome(ours, theirs, whole, matrix, work.reference, work.index, field, landed, bad, compared)
    measuring = part(progress, 0.9, 1.0)
    shares = None if weights is None else np.asarray(weights, dtype=float).ravel()
    result = result_of(outcome, source, settings, movement.history, warnings, measuring, shares)
    steering = None if work.pairs is None else _steered(result, work.pairs, settings)
    seconds = time.process_time() - started
    return dataclasses.replace(_as_read(result, work.numbers), steering=steering, seconds=seconds)


def _as_read(result: MorphResult, numbers: Int) -> MorphResult:
    """Number the field's nodes (c,) as in the mesh that was cleaned; `numbers` are these."""
    back, field = np.argsort(numbers), result.field
    return dataclasses.replace(
        result,
        field=dataclasses.replace(
            field, centres=field.centres[back], displacements=field.displacements[back]
        ),
        faces=numbers[result.faces],
        residual=result.residual[back],
    )


def _steered(result: MorphResult, pairs: Pairs, settings: MorphSettings) -> Steering:
    """Measure what is left between the landmarks."""
    aligned = transformed(result.transform, pairs.source)
    apart = [
        np.linalg.norm(points - pairs.target, axis=1) for points in (aligned, result.apply(pairs.source))
    ]
    return Steering(pairs.names, apart[0], apart[1], pairs.good, settings.steer, pairs.faults)


class _Movement(NamedTuple):
    """How the aligned nodes move."""

    displacement: Float  # (n, 3)
    landed: Float  # (n, 3) where on the target each was laid last; NaN where it was not
    bad: int  # faces that stayed folded or crossing
    history: list[Step]


def _moved(
    work: Work, weight: Float | None, settings: MorphSettings, progress: Progress, watch: Watch
) -> _Movement:
    """Deform, lay the nodes onto the target, mend; `weight` (n,) are the shares that nodes take of it."""
    # whatever may move at all is morphed as a whole, and takes its share of it in the end
    free = None if weight is None else (weight > 0).astype(float)
    rest, reference, index = work.rest, work.reference, work.index
    settling, mending = part(progress, 0.7, 0.86), part(progress, 0.86, 0.88)
    with aside(
        lambda word: Shapes.of(rest, reference, index.surface, word),
        repeating(progress, 0.7, "shapes of elements"),
    ) as known:
        displacement, history = _deform(work, free, settings, part(progress, 0.25, 0.7), watch)
        shapes = known()
    displacement, left, landed = settle(
        shapes, reference, displacement, index, free, settings, settling, watch.dense
    )
    if settings.partial == "none" and settings.projection == 1.0:
        displacement, left, landed = reached(
            reference, (displacement, left, landed), index, free, shapes.mean, settings
        )
    displacement, bad = mended(rest, reference, displacement, index, free, settings, mending, left)
    watch.dense(displacement)
    if weight is not None:
        displacement, left = unfolded(reference, weight[:, None] * displacement, shapes.mean, bad_faces, free)
        bad = len(left)
    return _Movement(displacement, landed, bad, history)


def _paired(
    source: ArrayLike | None, target: ArrayLike | None, names: Sequence[str] | None, size: float
) -> Pairs | None:
    if source is None and target is None:
        return None
    if source is None or target is None:
        raise FemorsError("landmarks are needed on both meshes, in the same order")
    one, two = (np.asarray(points, dtype=float).reshape(-1, 3) for points in (source, target))
    return Pairs.of(one, two, names, size)


def _clean_weights(weights: ArrayLike | None, ours: Cleaned, count: int) -> Float | None:
    """Weights of the cleaned vertices: the largest of those merged into each."""
    if weights is None:
        return None
    given = np.asarray(weights, dtype=float).ravel()
    if len(given) != count or not np.isfinite(given).all() or given.min() < 0 or given.max() > 1:
        raise FemorsError(f"weights must be {count} numbers from 0 to 1, one for each source vertex")
    out = np.zeros(len(ours.surface.vertices))
    used = ours.vertex_map >= 0
    np.maximum.at(out, ours.vertex_map[used], given[used])
    return out


def _deform(
    work: Work, free: Float | None, settings: MorphSettings, progress: Progress, watch: Watch
) -> tuple[Float, list[Step]]:
    """Run all stages; return the displacement of the dense mesh (n, 3) and the history."""
    edges = [max(s.mean_edge, t.mean_edge) for s, t in zip(work.sources, work.targets, strict=True)]
    plan = stages(settings, edges, work.size)
    history: list[Step] = []
    level, displacement = 0, np.zeros_like(work.sources[0].vertices)

    def to_level(there: int) -> Float:
        if there == level:
            return displacement
        carried = _carried(work, level, there, displacement, edges, settings)
        return carried if free is None else carried * work.at_level(there, free)[:, None]

    for number, stage in enumerate(plan):
        level, displacement = stage.level, to_level(stage.level)
        reporter = part(progress, number / len(plan), (number + 1) / len(plan))
        displacement = _run(work, stage, displacement, free, settings, history, reporter, watch)
    return to_level(len(work.sources) - 1), history


def _carried(
    work: Work, here: int, there: int, displacement: Float, edges: list[float], settings: MorphSettings
) -> Float:
    """Take a level's displacement to a finer level, by the field that it makes."""
    published = settings.correspondence == "nearest" and settings.spread_start > 0
    spread = settings.spread_start if published else CARRY * edges[here]
    return DisplacementField(work.sources[here].vertices, displacement, spread)(work.sources[there].vertices)


def _run(
    work: Work,
    stage: Stage,
    displacement: Float,
    free: Float | None,
    settings: MorphSettings,
    history: list[Step],
    progress: Progress,
    watch: Watch,
) -> Float:
    """Iterate on one level; `free` (n,) is 1 for the dense nodes that may move, else 0."""
    rest, aim = work.sources[stage.level], work.targets[stage.level]
    rest.border  # noqa: B018  worked out once here, the moved surfaces share it
    target = Target.of(work.index, aim)
    mean = averaging(rest)
    share = None if free is None else work.at_level(stage.level, free)
    pull = work.pull(stage.level)
    calm, count = False, len(stage.iterations)
    published = settings.correspondence == "nearest"
    for number, iteration in enumerate(stage.iterations):
        if calm and number < count - 1:
            continue  # nothing moves any more: only the last and finest is left to try
        where = f"{stage.name}, {len(rest.vertices)} nodes, iteration {number + 1} of {count}"
        under_way = repeating(progress, number / count, where)
        moved = rest.moved(rest.vertices + displacement)
        vectors = _vectors(moved, aim, target, iteration.normal_weight, settings.partial, under_way)
        if not len(vectors.centres):
            break
        asked = vectors.displacements if published else shortened(vectors.displacements, iteration.spread)
        # the next iteration measures anew what a rough field leaves
        field = DisplacementField(vectors.centres, asked, iteration.spread, rough=not published)
        along = functools.partial(widening, field) if settings.partial == "target" else field
        step = stage.step_scale * along(moved.vertices, under_way)
        after = slide(moved, displacement + step, mean, settings.sliding)
        if pull is not None:
            after = pull(after, iteration.spread)
        step = (after - displacement) if share is None else share[:, None] * (after - displacement)
        if rest is work.aligned:
            step = guarded(rest, displacement, step, mean)
        displacement = displacement + step
        largest = float(np.sqrt(np.max(np.sum(step**2, axis=1))))
        history.append(
            Step(stage.name, len(rest.vertices), number + 1, vectors.rms, largest, iteration.spread)
        )
        progress((number + 1) / count, f"{where}, RMS {vectors.rms:.3g}")
        watch(stage.level, displacement)
        calm = largest < settings.tolerance * work.size
    return displacement


def _vectors(
    moved: Surface,
    aim: Surface,
    target: Target,
    normal_weight: float | None,
    partial: str,
    progress: Progress,
) -> Vectors:
    if normal_weight is None:
        return by_surface(moved, target, partial, progress)
    return by_nearest(moved, aim, normal_weight, partial)
