# SPDX-License-Identifier: GPL-3.0-or-later
"""What a morph gives back: vertices, field, history, figures and warnings."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from . import triples
from .carry import Carrier
from .cleaning import Cleaned
from .files import Location
from .folds import Reference
from .grnn import DisplacementField
from .keptfield import KeptField
from .mesh import Float, Int, Surface
from .morph_settings import MorphSettings
from .nearest import Closest, SurfaceIndex
from .progress import Progress
from .quality import Comparison, compare
from .steer import Steering
from .transforms import transformed

REACH = 0.002  # of the target's size: a fit is reached when 99 % of both surfaces are closer than an
# edge and this
ROUNDED = 1e-9  # of the size: no distance at all
AT_PLACE = 1e-12  # of the size: a node stands where it was laid
LARGE_FACE = 2.0  # mean areas of the morphed faces: the middle of a target's face is asked for, too


@dataclasses.dataclass(frozen=True)
class Step:
    """What one iteration did.

    Attributes
    ----------
    level : str
        Stage: reduced, fine or dense.
    nodes : int
        Of the mesh that was worked on.
    iteration : int
        Counted from one within its level.
    rms : float
        Root mean square length of the displacement vectors found, before the step.
    largest : float
        Largest movement of a node in the step.
    spread : float
        Of the field.
    """

    level: str
    nodes: int
    iteration: int
    rms: float
    largest: float
    spread: float


@dataclasses.dataclass(frozen=True, eq=False)
class MorphResult:
    """A morphed source.

    Attributes
    ----------
    vertices : (n, 3) float64
        Position of every vertex of the source that was given, in its order.
    transform : (4, 4) float64
        The alignment: source to aligned source.
    field : DisplacementField
        From aligned positions to displacements; its centres are the cleaned source's nodes.
    faces : (m, 3) int32
        Triangles over the field's centres, outward.
    residual : (c,) float64
        Misfit around each morphed centre, see `misfit_around`.
    history : tuple of Step
    converged : bool
        Whether the two surfaces have come together: see `stop_reason`.
    stop_reason : str
    warnings : tuple of str
        Whatever the user should know of the input and the result.
    before, after : Comparison
        The aligned source and the result against the target.
    surface_distance : (n,) float64
        Distance of each result vertex to the target's surface.
    displacement : (n,) float64
        How far each vertex was moved after the alignment.
    settings : MorphSettings
    seconds : float
        CPU time of the whole.
    steering : Steering, optional
        What became of paired landmarks.
    """

    vertices: Float
    transform: Float
    field: DisplacementField
    faces: Int
    residual: Float
    history: tuple[Step, ...]
    converged: bool
    stop_reason: str
    warnings: tuple[str, ...]
    before: Comparison
    after: Comparison
    surface_distance: Float
    displacement: Float
    settings: MorphSettings
    seconds: float
    steering: Steering | None = None

    def apply(self, points: ArrayLike) -> Float:
        """Carry points (k, 3) of the source's space along; see `carry.Carrier.carry`.

        A point of the surface stays in its triangle, a point off it keeps its offset, and far away the
        deformation fades out until the alignment alone is left.
        """
        return self._carrier.carry(points).points

    @cached_property
    def _carrier(self) -> Carrier:
        return Carrier(self.kept())

    def kept(self, source: str = "", target: str = "", date: str = "") -> KeptField:
        """Return alignment and displacement as a thing of their own, named after the pair.

        Parameters
        ----------
        source, target : str
            What the two are called.
        date : str
            When it was made, ISO 8601.
        """
        figures = {
            "vertices": len(self.vertices),
            "stop_reason": self.stop_reason,
            "target_to_surface": self.after.target_to_surface.as_dict(),
            "surface_to_target": self.after.surface_to_target.as_dict(),
        }
        return KeptField(
            self.transform,
            self.field.centres,
            self.field.displacements,
            self.faces,
            self.residual,
            self.field.spread,
            source,
            target,
            date,
            figures,
        )

    def report(self) -> dict[str, Any]:
        """Return everything but the arrays, for JSON."""
        return {
            "settings": dataclasses.asdict(self.settings),
            "transform": self.transform.tolist(),
            "converged": self.converged,
            "stop_reason": self.stop_reason,
            "warnings": list(self.warnings),
            "before": self.before.as_dict(),
            "after": self.after.as_dict(),
            "history": [dataclasses.asdict(step) for step in self.history],
            "cpu_seconds": round(self.seconds, 3),
            **({} if self.steering is None else {"landmarks": self.steering.as_dict()}),
        }

    def summary(self) -> str:
        """Return a table of the figures for a person: median [1st, 99th percentile] and maximum."""
        rows = [
            ("surface, source to target", "surface_to_target"),
            ("surface, target to source", "target_to_surface"),
            ("nearest vertex", "hausdorff"),
            ("aspect ratio", "aspect"),
            ("dihedral angle, degrees", "dihedral"),
            ("movement", "movement"),
        ]
        lines = [f"{'':28}{'aligned':44}{'morphed'}"]
        for label, name in rows:
            lines.append(f"{label:28}{getattr(self.before, name)!s:44}{getattr(self.after, name)!s}")
        for label, name in (("flipped faces", "flipped"), ("self-intersecting faces", "self_intersecting")):
            lines.append(f"{label:28}{getattr(self.before, name):<44}{getattr(self.after, name)}")
        if self.steering is not None:
            lines.append(self.steering.sentence())
        lines.append(f"{self.stop_reason}; {self.seconds:.1f} s of CPU time")
        return "\n".join(lines)

    def save_field(self, path: Location, source: str = "", target: str = "", date: str = "") -> None:
        """Write what `kept` returns as an ``.npz`` file; `keptfield.load` reads it."""
        self.kept(source, target, date).save(path)


def result_of(
    source: Surface,
    cleaned: tuple[Cleaned, Cleaned],
    placed: tuple[Float, Reference, SurfaceIndex],
    field: DisplacementField,
    landed: Float,
    settings: MorphSettings,
    history: tuple[Step, ...],
    bad: int,
    warnings: tuple[str, ...],
    progress: Progress,
    weighted: bool = False,
) -> MorphResult:
    """Carry the cleaned mesh's displacement to the given source, and measure.

    Parameters
    ----------
    placed : (matrix, reference, index)
        The alignment (4, 4), the aligned cleaned source, and the target's search structure.
    field : DisplacementField
        Its centres are the aligned nodes, its displacements their movement.
    landed : (n, 3) float64
        Where on the target each of them was laid last; NaN where that is not known.
    bad : int
        Faces that stayed folded or crossing.
    weighted : bool
        Whether weights kept some of the source from moving.
    """
    ours, theirs = cleaned
    matrix, reference, index = placed
    aligned = reference.surface
    morphed = aligned.moved(aligned.vertices + field.displacements)
    vertices = np.empty_like(source.vertices)
    used = ours.vertex_map >= 0
    vertices[used] = morphed.vertices[ours.vertex_map[used]]
    if not used.all():
        kept = KeptField(
            matrix,
            field.centres,
            field.displacements,
            aligned.faces,
            np.zeros(len(field.centres)),
            field.spread,
        )
        vertices[~used] = Carrier(kept).carry(source.vertices[~used]).points
    movement = np.linalg.norm(vertices - transformed(matrix, source.vertices), axis=1)
    progress(0.2, "measuring")
    distance = np.zeros(len(vertices))
    clean_distance = _to_surface(index, morphed.vertices, landed)
    distance[used] = clean_distance[ours.vertex_map[used]]
    distance[~used] = index.closest(vertices[~used]).distance
    back = SurfaceIndex(morphed).closest(theirs.surface.vertices)
    before = compare(
        ours.surface,
        _wound_as(ours, aligned),
        theirs.surface,
        target_index=index,
        self_intersecting=len(reference.crossing),
    )
    progress(0.6, "measuring")
    after = compare(
        ours.surface,
        _wound_as(ours, morphed),
        theirs.surface,
        target_index=index,
        to_target=clean_distance,
        from_target=back.distance,
        # nothing bad is left in a source without crossings: that has been looked at
        self_intersecting=0 if not bad and not before.self_intersecting else None,
    )
    size = theirs.surface.diagonal
    edge = max(aligned.mean_edge, theirs.surface.mean_edge)
    converged, reason = _verdict(after, settings, size, edge, weighted)
    if settings.spread_start > 0.25 * size:
        words = f"the first spread, {settings.spread_start:g}, is large beside the target's size, {size:.3g}"
        warnings = (*warnings, f"{words}: lengths of the preset are in mm")
    if bad:
        warnings = (*warnings, f"{bad} faces fold over or cross others, though they did not in the source")
    progress(1.0, "done")
    return MorphResult(
        vertices=vertices,
        transform=matrix,
        field=field,
        faces=aligned.faces,
        residual=misfit_around(morphed, clean_distance, theirs.surface, back, settings.partial),
        history=history,
        converged=converged,
        stop_reason=reason,
        warnings=warnings,
        before=before,
        after=after,
        surface_distance=distance,
        displacement=movement,
        settings=settings,
        seconds=0.0,
    )


def _to_surface(index: SurfaceIndex, points: Float, landed: Float) -> Float:
    """Return the distance (n,) of points to a surface; those at a known place on it are not searched."""
    away = np.linalg.norm(points - landed, axis=1)
    rest = np.flatnonzero(~(away < AT_PLACE * index.surface.diagonal))
    away[rest] = index.closest(points[rest]).distance
    return away


def misfit_around(
    morphed: Surface,
    to_target: Float,
    target: Surface,
    back: Closest | None = None,
    partial: str = "none",
) -> Float:
    """Return (n,) how far the two surfaces are apart around each vertex of the morphed one, at most.

    The vertices themselves were laid onto the target, so that their own distance says nothing. What does
    are the target's vertices, and middles of faces that are large beside the morphed ones, back to the
    morphed surface: each counts for the corners of the face that it is closest to, and for their
    neighbours.

    Parameters
    ----------
    to_target : (n,) float64
        Distance of each vertex to the target's surface.
    back : Closest, optional
        Closest points of the target's vertices on the morphed surface, where they are known; all of
        these vertices have faces then.
    partial : {"none", "source", "target"}
        With "source", what is closest to the border is beyond it, and not counted.
    """
    large = target.faces[target.face_areas > LARGE_FACE * morphed.face_areas.mean()]
    middles = triples.total(target.vertices.take(large, axis=0)) / 3.0
    points = np.concatenate((target.vertices[np.unique(target.faces)], middles))
    unknown = points if back is None else middles
    found = SurfaceIndex(morphed).closest(unknown) if len(unknown) else None
    parts = [part for part in (back, found) if part is not None]
    corners = morphed.faces[np.concatenate([part.face for part in parts])]
    away = np.concatenate([part.distance for part in parts])
    if partial == "source":
        inner = ~morphed.border[corners].any(axis=1)
        corners, away, points = corners[inner], away[inner], points[inner]
    out = np.full(len(morphed.vertices), -1.0)
    np.maximum.at(out, corners, away[:, None])
    lone = out < 0  # a target coarser than the source
    if lone.any() and len(points):
        out[lone] = away[cKDTree(points).query(morphed.vertices[lone])[1]]
    around = out.copy()
    np.maximum.at(around, morphed.faces, out[morphed.faces].max(axis=1)[:, None])
    around = np.maximum(around, to_target)
    return np.where(around > ROUNDED * target.diagonal, around, 0.0)


def _wound_as(ours: Cleaned, surface: Surface) -> Surface:
    """The positions with the cleaned source's own faces (a mirror image has them turned)."""
    return ours.surface.moved(surface.vertices)


def _verdict(
    after: Comparison, settings: MorphSettings, size: float, edge: float, weighted: bool
) -> tuple[bool, str]:
    """Whether the surfaces have come together, and in which words.

    A fit is reached when 99 % of each surface is within an edge and a little of the other. The face
    that closes a cut has no counterpart: a partial mesh is judged by its median.
    """
    if weighted:
        return True, "done, as far as the weights let the source move"
    limit = edge + REACH * size
    part, name = ("99 %", "p99") if settings.partial == "none" else ("half", "median")
    gaps = []
    if settings.partial != "target":
        gaps.append(("the result", "the target", getattr(after.surface_to_target, name)))
    if settings.partial != "source":
        gaps.append(("the target", "the result", getattr(after.target_to_surface, name)))
    here, there, gap = max(gaps, key=lambda entry: entry[2])
    gap = gap if gap > 1e-9 * size else 0.0  # rounding is nothing to report
    if gap > limit:
        return False, f"not converged: only {part} of {here} is within {gap:.3g} of {there}"
    if settings.partial != "none":
        return True, f"converged over the shared part: half of {here} is within {gap:.3g} of {there}"
    return True, f"converged: 99 % of each surface is within {gap:.3g} of the other"
