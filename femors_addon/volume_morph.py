# SPDX-License-Identifier: GPL-3.0-or-later
"""Morph a finite-element mesh: its outer surface by Algorithm 1, then its interior as one more layer.

The interior starts from the field of the surface's displacements (a GRNN, as in the paper) and is
relaxed to the harmonic one, which neither overshoots nor bunches up. Mid-side nodes stay on their
edges. No element that was valid is inverted: see `kept_valid`.
"""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .cleaning import Cleaned, clean
from .grnn import DisplacementField
from .interior import harmonic, stiffness
from .mesh import Float, Int, Surface
from .morph import morph
from .morph_fit import misfit_around, verdict
from .morph_result import MorphResult
from .morph_settings import MorphSettings
from .nearest import SurfaceIndex
from .progress import FemorsError, Preview, Progress, counted, part, silent
from .quality import compare
from .strays import without_strays
from .transforms import mirrors, transformed
from .volume import Ids, VolumeMesh, carry_mid_nodes
from .volume_quality import VolumeQuality, scaled_jacobians
from .volume_shapes import reshaped

SPREAD = 1.5  # mean surface edges: spread of the field that starts the interior
BACK = 0.7  # share of its way that a node of an inverted element keeps, per attempt
ATTEMPTS = 12  # attempts before such a node stays where it began
LEAST = 0.02  # scaled Jacobian that a valid element keeps, at least, or half of its own where that is less


@dataclasses.dataclass(frozen=True, eq=False)
class VolumeMorphResult:
    """A morphed finite-element mesh.

    Attributes
    ----------
    nodes : (n, 3) float64
        Position of every node, in the mesh's order.
    surface : MorphResult
        The morph of the outer surface, with its field, history and figures.
    before, after : VolumeQuality
        Figures of the elements that were valid on input.
    inverted_input : (k,) int64
        Ids of the elements that were inverted on input; they were left alone.
    inverted_new : (k,) int64
        Ids of elements inverted by the morph: always empty.
    inverted : int
        How many elements are inverted in the result; one that was on input may have become valid.
    held : (k,) int32
        Indices of the nodes that were stopped short of the target, so that no element is inverted.
    held_by : float
        Largest distance that one of them was held back.
    """

    nodes: Float
    surface: MorphResult
    before: VolumeQuality
    after: VolumeQuality
    inverted_input: Ids
    inverted_new: Ids
    inverted: int
    held: Int
    held_by: float
    seconds: float

    def apply(self, points: ArrayLike) -> Float:
        """Carry points (k, 3) of the source's space along, by the surface's field."""
        return self.surface.apply(points)

    def report(self) -> dict[str, Any]:
        """Return everything but the arrays, for JSON."""
        return {
            **self.surface.report(),
            "volume": {
                "before": {**self.before.as_dict(), "inverted": len(self.inverted_input)},
                "after": {**self.after.as_dict(), "inverted": self.inverted},
                "volume_change": self.volume_change,
                "inverted_on_input": self.inverted_input.tolist(),
                "newly_inverted": self.inverted_new.tolist(),
                "nodes_held_back": len(self.held),
                "held_back_by": self.held_by,
            },
            "cpu_seconds": round(self.seconds, 3),
        }

    @property
    def volume_change(self) -> float:
        """Change of the volume, as a share of what it was."""
        return self.after.volume / self.before.volume - 1.0 if self.before.volume else 0.0

    def summary(self) -> str:
        """Return the surface's table and the elements' figures, for a person."""
        table, verdict = self.surface.summary().rsplit("\n", 1)
        lines = [
            table,
            f"{'scaled Jacobian':28}{_jacobian(self.before):36}{_jacobian(self.after)}",
            f"{'volume':28}{self.before.volume:<36.6g}{self.after.volume:.6g} ({self.volume_change:+.1%})",
            f"{'inverted elements':28}{len(self.inverted_input):<36}{self.inverted}",
        ]
        if len(self.inverted_input):
            left_out = counted(len(self.inverted_input), "element that was", "elements that were")
            lines.append(f"these scaled Jacobians leave out the {left_out} inverted before")
        if len(self.held):
            lines.append(
                f"{counted(len(self.held), 'node')} held back by up to {self.held_by:.3g} to keep "
                "elements valid"
            )
        return "\n".join([*lines, f"{verdict.split(';')[0]}; {self.seconds:.1f} s of CPU time"])


def _jacobian(quality: VolumeQuality) -> str:
    return f"min {quality.minimum:.3f}, 1 % {quality.p01:.3f}, median {quality.median:.3f}"


def morph_volume(
    mesh: VolumeMesh,
    target: Surface,
    settings: MorphSettings | None = None,
    progress: Progress = silent,
    *,
    weights: ArrayLike | None = None,
    preview: Preview | None = None,
    **options: Any,
) -> VolumeMorphResult:
    """Morph a mesh of solid elements onto a target surface.

    Parameters
    ----------
    mesh : VolumeMesh
        Its outer surface is the source.
    target : Surface
    settings : MorphSettings, optional
    progress : Progress
    weights : (n,) array, optional
        Of all nodes, from 0 to 1: how far each may follow.
    preview : Preview, optional
        Given all nodes (n, 3), those inside where they were.
    **options
        As for `morph.morph`.

    Raises
    ------
    FemorsError
        No solid elements; a mirror image, which would turn every element inside out.
    """
    started = time.process_time()
    settings = settings or MorphSettings()
    if not mesh.solid:
        raise FemorsError("the source has no solid elements; morph its surface instead")
    surface, at = mesh.surface()
    kept = at  # nodes that the interior does not move: the surface's, and those of no weight
    if weights is not None:
        weights = np.asarray(weights, dtype=float).ravel()
        if len(weights) != len(mesh.nodes):
            raise FemorsError(f"weights must be {len(mesh.nodes)} numbers, one for each node")
        options["weights"] = weights[at]
        kept = np.union1d(at, np.flatnonzero(weights == 0)).astype(np.int32)
    if preview is not None:
        options["preview"] = at_nodes(preview, mesh.nodes, at)
    result = morph(surface, target, settings, part(progress, 0.0, 0.7), **options)
    if mirrors(result.transform):
        raise FemorsError(
            "a mirror image would turn every element inside out; mirror the target instead, or take another"
        )
    jacobian = scaled_jacobians(mesh)
    valid = jacobian > 0
    aligned = mesh.moved(transformed(result.transform, mesh.nodes))
    progress(0.7, "volume: interior")
    goal = _with_interior(aligned, result.vertices, at, kept, surface.mean_edge)
    progress(0.8, "volume: element shapes")
    laid_on = settings.projection == 1.0 and settings.partial == "none" and weights is None
    cleaned = clean(surface.vertices, surface.faces)
    ours, theirs = without_strays(cleaned, clean(target.vertices, target.faces))
    laid_on &= ours is cleaned  # what only goes along must not be laid on the target
    index = SurfaceIndex(theirs.surface) if laid_on else None
    goal = reshaped(mesh, goal, kept, jacobian, index, part(progress, 0.8, 0.9))
    progress(0.9, "volume: no element inverted")
    nodes, held, held_by = kept_valid(aligned, goal, valid)
    progress(0.95, "volume: figures")
    final = mesh.moved(nodes)
    after = scaled_jacobians(final)
    ids = mesh.element_ids
    progress(1.0, "done")
    return VolumeMorphResult(
        nodes=nodes,
        surface=_as_it_ended(result, surface, (ours, theirs), nodes[at], weights is not None),
        before=VolumeQuality.of(mesh, valid),
        after=VolumeQuality.of(final, valid),
        inverted_input=np.asarray(ids[~valid]),
        inverted_new=np.asarray(ids[valid & (after <= 0)]),
        inverted=int((after <= 0).sum()),
        held=held,
        held_by=held_by,
        seconds=time.process_time() - started,
    )


def at_nodes(preview: Preview, nodes: Float, at: Int) -> Preview:
    """Return a preview for positions of the nodes `at`; the others (of n, 3) stay as given."""

    def show(vertices: Float) -> None:
        moved = nodes.copy()
        moved[at] = vertices
        preview(moved)

    return show


def _as_it_ended(
    result: MorphResult, surface: Surface, cleaned: tuple[Cleaned, Cleaned], vertices: Float, weighted: bool
) -> MorphResult:
    """Measure the surface again, where the elements have moved its nodes (n, 3) since it was morphed."""
    if np.array_equal(vertices, result.vertices):
        return result
    ours, theirs = cleaned
    index = SurfaceIndex(theirs.surface)
    used = ours.vertex_map >= 0
    moved = np.empty_like(ours.surface.vertices)
    moved[ours.vertex_map[used]] = vertices[used]
    distance, off = index.closest(vertices).distance, index.closest(moved).distance
    last = ours.surface.moved(moved)
    ending = SurfaceIndex(last)
    back = ending.closest(theirs.surface.vertices)
    after = compare(
        ours.surface,
        last,
        theirs.surface,
        target_index=index,
        to_target=off,
        from_target=back.distance,
    )
    size, edge = theirs.surface.diagonal, max(last.mean_edge, theirs.surface.mean_edge)
    residual = misfit_around(last, off, theirs.surface, back, result.settings.partial, ending)
    converged, reason = verdict(off, back.distance, residual, result.settings, size, edge, weighted)
    aligned = transformed(result.transform, surface.vertices)
    field = dataclasses.replace(result.field, displacements=moved - result.field.centres)
    return dataclasses.replace(
        result,
        vertices=vertices,
        field=field,
        residual=residual,
        surface_distance=distance,
        displacement=np.linalg.norm(vertices - aligned, axis=1),
        after=after,
        converged=converged,
        stop_reason=reason,
    )


# --- interior ---------------------------------------------------------------------------------------
def _with_interior(aligned: VolumeMesh, outer: Float, at: Int, kept: Int, edge: float) -> Float:
    """All nodes (n, 3): those `at` the surface go to `outer`, all but those `kept` follow harmonically."""
    goal = aligned.nodes.copy()
    goal[at] = outer
    displacement = goal - aligned.nodes
    inside = np.ones(len(goal), dtype=bool)
    inside[kept] = False
    field = DisplacementField(aligned.nodes[at], displacement[at], SPREAD * edge)
    displacement[inside] = field(aligned.nodes[inside])
    displacement = harmonic(stiffness(aligned), displacement, inside)
    return carry_mid_nodes(aligned, aligned.nodes + displacement)


# --- the guarantee ------------------------------------------------------------------------------------
def kept_valid(aligned: VolumeMesh, goal: Float, valid: np.ndarray) -> tuple[Float, Int, float]:
    """Go from `aligned` towards `goal` (n, 3) as far as no valid element is inverted.

    In `aligned`, an affine image of the source, every element is as valid as it was. Nodes of elements
    that the goal would invert stop ever farther from it, and at last where they
    began: with all its nodes there an element is valid, so that the search ends.

    Returns
    -------
    nodes : (n, 3) float64
    held : (k,) int32
        The nodes that stopped short.
    held_by : float
        The largest distance that one of them is from its goal.
    """
    begun = scaled_jacobians(aligned)
    floor = np.where(valid, np.minimum(LEAST, 0.5 * begun), -np.inf)
    share = np.ones(len(goal))
    attempts = np.zeros(len(goal), dtype=int)
    step = goal - aligned.nodes
    while True:
        nodes = aligned.nodes + share[:, None] * step
        nodes[share == 1.0] = goal[share == 1.0]
        nodes = carry_mid_nodes(aligned, nodes)
        bad = np.flatnonzero(scaled_jacobians(aligned.moved(nodes)) < floor)
        if not len(bad):
            break
        touched = np.unique(aligned.restricted(bad)[1])
        free = touched[share[touched] > 0]
        attempts[free] += 1
        share[free] = np.where(attempts[free] > ATTEMPTS, 0.0, share[free] * BACK)
    held = np.flatnonzero(share < 1.0).astype(np.int32)
    by = np.linalg.norm(nodes[held] - goal[held], axis=1)
    return nodes, held, float(by.max(initial=0.0))
