# SPDX-License-Identifier: GPL-3.0-or-later
"""How a morph came out: its result on the mesh as given, measured."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from . import triples
from .cached import cached_property
from .carry import Carrier
from .cleaning import Cleaned
from .crew import at_once
from .folds import Reference
from .grnn import DisplacementField
from .intersect import self_intersections
from .keptfield import KeptField
from .mesh import Float, Surface
from .morph_fit import misfit_around, part_of_whole, verdict
from .morph_result import MorphResult, Step
from .morph_settings import MorphSettings
from .nearest import Closest, SurfaceIndex
from .progress import Progress, counted, part, repeating
from .quality import Comparison, Stat, compare, dihedral_angles, flipped_faces
from .transforms import transformed

AT_PLACE = 1e-12  # of the size: a node stands where it was laid
LARGE_SPREAD = 0.25  # of the size: the first spread of a preset in another unit
BLUNT, SHARP = 60.0, 120.0  # degrees between two faces: an edge that a morph has pleated was, and is
AS_SHARP = 2.0  # times the share of such edges in the target: so many may the morph make
BEFORE = 50_000  # vertices of each mesh whose distances stand for all of them before the morph


@dataclasses.dataclass(frozen=True, eq=False)
class Outcome:
    """What a morph ends with, on the cleaned meshes.

    Attributes
    ----------
    source, target : Cleaned
        The two, and the way back to what was given.
    whole : Cleaned
        The source with its strays, which only go along; else `source`.
    matrix : (4, 4) float64
        The alignment.
    reference : Reference
        The aligned source (c nodes).
    index : SurfaceIndex
        Of the target.
    field : DisplacementField
        Its centres are the aligned nodes, its displacements their movement.
    landed : (c, 3) float64
        Where on the target each of them was laid last; NaN where that is not known.
    bad : int
        Faces that stayed folded or crossing.
    before : Comparison
        The aligned source against the target.
    """

    source: Cleaned
    target: Cleaned
    whole: Cleaned
    matrix: Float
    reference: Reference
    index: SurfaceIndex
    field: DisplacementField
    landed: Float
    bad: int
    before: Comparison

    @cached_property
    def aligned(self) -> Surface:
        """The source where the alignment puts it, wound as it is in `source`, mirrored or not."""
        return self.source.surface.moved(self.reference.surface.vertices)

    @cached_property
    def morphed(self) -> Surface:
        """The source where the morph puts it, outward."""
        surface = self.reference.surface
        return surface.moved(surface.vertices + self.field.displacements)

    @cached_property
    def to_target(self) -> Float:
        """(c,) distance of each morphed node to the target's surface; what was laid on it is not searched."""
        points = self.morphed.vertices
        distance = np.linalg.norm(points - self.landed, axis=1)
        away = np.flatnonzero(~(distance < AT_PLACE * self.index.surface.diagonal))
        distance[away] = self.index.closest(points[away]).distance
        return distance

    def vertices(self, given: Float, weights: Float | None = None) -> Float:
        """Return where the morph puts the vertices (n, 3) as given.

        Those of no face, and strays, go by the field, each by its share of `weights` (n,).
        """
        out = np.empty_like(given)
        used = self.source.vertex_map >= 0
        out[used] = self.morphed.vertices[self.source.vertex_map[used]]
        if not used.all():
            field, faces = self.field, self.reference.surface.faces
            unknown = np.zeros(len(field.centres))
            kept = KeptField(self.matrix, field.centres, field.displacements, faces, unknown, field.spread)
            start, end = transformed(self.matrix, given[~used]), Carrier(kept).carry(given[~used]).points
            share = 1.0 if weights is None else weights[~used, None]
            out[~used] = np.where(share == 1.0, end, start + share * (end - start))
        return out

    def distances(self, vertices: Float) -> Float:
        """Return the distance (n,) of what `vertices` gave to the target's surface."""
        out = np.zeros(len(vertices))
        used = self.source.vertex_map >= 0
        out[used] = self.to_target[self.source.vertex_map[used]]
        out[~used] = self.index.closest(vertices[~used]).distance
        return out


def result_of(
    outcome: Outcome,
    given: Surface,
    settings: MorphSettings,
    history: Sequence[Step],
    warnings: Sequence[str],
    progress: Progress,
    weights: Float | None = None,
) -> MorphResult:
    """Carry the cleaned mesh's displacement to the mesh as given, and measure.

    Parameters
    ----------
    outcome : Outcome
    given : Surface
        The source as the user has it.
    settings, history
        Of the morph.
    warnings : sequence of str
        What is known so far.
    progress : Progress
    weights : (n,) float64, optional
        How far each vertex was allowed to follow.
    """
    target, morphed = outcome.target.surface, outcome.morphed
    vertices = outcome.vertices(given.vertices, weights)
    progress(0.2, "measuring")
    distance = outcome.distances(vertices)
    pleats: tuple[str, ...]
    (back, residual), after, pleats = at_once(
        lambda word: _way_back(outcome, settings.partial, word),
        lambda word: _after(outcome, word),
        lambda _: _pleated(outcome.aligned, morphed, target),
        progress=repeating(progress, 0.4, "measuring"),
    )
    before = outcome.before
    after = dataclasses.replace(after, target_to_surface=Stat.of(back.distance))
    aligned = transformed(outcome.matrix, given.vertices)
    if outcome.whole is not outcome.source:
        before, after = (
            _with_strays(outcome.whole, before, aligned),
            _with_strays(outcome.whole, after, vertices),
        )
    crossed = after.self_intersecting - before.self_intersecting
    edge = max(outcome.aligned.mean_edge, target.mean_edge)
    converged, reason = verdict(
        outcome.to_target, back.distance, residual, settings, target.diagonal, edge, weights is not None
    )
    faults = _folded(outcome.bad)
    hints = part_of_whole(outcome.source.surface, morphed, target, settings.partial, converged)
    hints += pleats
    progress(1.0, "done")
    return MorphResult(
        vertices=vertices,
        transform=outcome.matrix,
        field=outcome.field,
        faces=morphed.faces,
        residual=residual,
        history=tuple(history),
        converged=converged,
        stop_reason=reason,
        warnings=(*warnings, *_warnings(settings, target.diagonal), *(faults or _ran_into(crossed)), *hints),
        faults=faults,
        before=before,
        after=after,
        surface_distance=distance,
        displacement=np.linalg.norm(vertices - aligned, axis=1),
        settings=settings,
        seconds=0.0,
    )


def _way_back(outcome: Outcome, partial: str, progress: Progress) -> tuple[Closest, Float]:
    """Closest points of the target's vertices on the morphed source, and the misfit around its nodes."""
    target, index = outcome.target.surface, SurfaceIndex(outcome.morphed)
    back = index.closest(target.vertices, progress)
    return back, misfit_around(outcome.morphed, outcome.to_target, target, back, partial, index)


def compared_before(
    source: Surface, reference: Reference, index: SurfaceIndex, progress: Progress
) -> Comparison:
    """Compare the aligned source with the target; of very dense meshes a sample tells how far they are.

    Parameters
    ----------
    source : Surface
        As it was.
    reference : Reference
        The same aligned.
    index : SurfaceIndex
        Of the target.
    """
    crossing = reference.crossed(part(progress, 0.0, 0.4))
    return compare(
        source,
        source.moved(reference.surface.vertices),
        index.surface,
        target_index=index,
        self_intersecting=len(crossing),
        sample=BEFORE,
        progress=part(progress, 0.4, 1.0),
    )


def _after(outcome: Outcome, progress: Progress) -> Comparison:
    """Compare the morphed source with the target; `target_to_surface` is left empty, to be put in."""
    source = outcome.source.surface
    return compare(
        source,
        source.moved(outcome.morphed.vertices),
        outcome.target.surface,
        target_index=outcome.index,
        to_target=outcome.to_target,
        from_target=np.zeros(0),
        # nothing bad is left in a source without crossings: that has been looked at
        self_intersecting=0 if not outcome.bad and not outcome.before.self_intersecting else None,
        progress=progress,
    )


def _with_strays(whole: Cleaned, comparison: Comparison, vertices: Float) -> Comparison:
    """Count flipped and crossing faces with the strays too, the vertices (n, 3) as given being there."""
    used = whole.vertex_map >= 0
    points = np.empty_like(whole.surface.vertices)
    points[whole.vertex_map[used]] = vertices[used]
    moved = whole.surface.moved(points)
    return dataclasses.replace(
        comparison,
        flipped=len(flipped_faces(whole.surface, moved)),
        self_intersecting=len(np.unique(self_intersections(moved))),
    )


def _warnings(settings: MorphSettings, size: float) -> list[str]:
    """Return what is to be said of the settings, the target being known."""
    if settings.spread_start <= LARGE_SPREAD * size:
        return []
    words = f"the first spread, {settings.spread_start:g}, is large beside the target's size, {size:.3g}"
    return [f"{words}: lengths of the preset are in mm"]


def _folded(bad: int) -> tuple[str, ...]:
    one = "face folds over or crosses others, though it did not in the source"
    many = "faces fold over or cross others, though they did not in the source"
    return (counted(bad, one, many),) if bad else ()


def _pleated(source: Surface, morphed: Surface, target: Surface) -> tuple[str, ...]:
    """What to say of edges that have become sharp, where the target has few such edges to be laid on."""
    was, now, theirs = (dihedral_angles(surface)[::2] for surface in (source, morphed, target))
    new = np.flatnonzero((now > SHARP) & (was < BLUNT))
    if len(new) * max(len(theirs), 1) <= AS_SHARP * (theirs > SHARP).sum() * len(now):
        return ()
    middles = morphed.vertices[morphed.edge_faces[1][new]].mean(axis=1)
    first = middles[np.argmin(triples.length(middles - np.median(middles, axis=0)))]
    place = ", ".join(f"{x:.4g}" for x in first)
    edges = counted(len(new), "edge is", "edges are")
    words = f"bent by more than {SHARP:g} degrees, by less than {BLUNT:g} in the source"
    return (f"{edges} {words}: pleats, which are neither folds nor crossings; look near ({place})",)


def _ran_into(crossed: int) -> tuple[str, ...]:
    more = counted(crossed, "more face crosses", "more faces cross")
    return (f"{more} others: pieces that were carried along run into the rest",) if crossed > 0 else ()
