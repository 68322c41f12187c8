# SPDX-License-Identifier: GPL-3.0-or-later
"""What a morph works with: both meshes at all levels, the source aligned, the target's search structure."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from .align import Alignment, align
from .cleaning import Cleaned
from .crew import at_once
from .curve import numbered, ordered
from .folds import Reference
from .icp import SAMPLE
from .landmark_pairs import Pairs
from .mesh import Float, Int, Surface
from .morph_settings import MorphSettings
from .nearest import SurfaceIndex
from .poses import canonical_frame
from .progress import Progress, part, repeating
from .reduce import pyramid
from .schedule import node_counts
from .steer import Pull, lead
from .transforms import inverse, transformed


@dataclasses.dataclass(frozen=True, eq=False)
class Work:
    """What stays the same through all iterations.

    Attributes
    ----------
    ours, theirs : Cleaned
        Source and target, numbered along a curve, see `curve`.
    numbers : (n,) int32
        Which number each of the source's nodes had before.
    alignment : Alignment
    rest : Surface
        The source's own element shapes, mirrored where it was.
    reference : Reference
        The source aligned.
    index : SurfaceIndex
        Of the target.
    sources, targets : list of Surface
        Of each level, from the coarsest to the dense one; the sources aligned.
    size : float
        Diagonal of the target's bounding box.
    pairs : Pairs or None
        Landmarks that are believed or not.
    weight : float
        Of the landmarks' pull.
    """

    ours: Cleaned
    theirs: Cleaned
    numbers: Int
    alignment: Alignment
    rest: Surface
    reference: Reference
    index: SurfaceIndex
    sources: list[Surface]
    targets: list[Surface]
    size: float
    pairs: Pairs | None
    weight: float

    @property
    def aligned(self) -> Surface:
        """The source aligned."""
        return self.reference.surface

    def pull(self, level: int) -> Pull | None:
        """What the landmarks do on a level; None where they do nothing."""
        if self.pairs is None or self.weight == 0 or not self.pairs.good.any():
            return None
        good = self.pairs.good
        source = transformed(self.alignment.matrix, self.pairs.source[good])
        return Pull(self.sources[level], source, self.pairs.target[good], self.index, self.size, self.weight)

    def at_level(self, level: int, free: Float) -> Float:
        """Values of the dense nodes (n,) at a level's nodes: those of the nearest dense node."""
        if level == len(self.sources) - 1:
            return free
        return np.asarray(free[cKDTree(self.aligned.vertices).query(self.sources[level].vertices)[1]])

    @classmethod
    def begun(
        cls,
        ours: Cleaned,
        theirs: Cleaned,
        settings: MorphSettings,
        pairs: Pairs | None,
        progress: Progress,
    ) -> Work:
        """Reduce both meshes, number them along a curve, and align the source.

        Which edges collapse depends on the order of the vertices. For the source's pose not to change it,
        that is the order as read, and the curve is laid along the source's own axes.
        """
        progress(0.0, "reduced meshes")
        read, aim = ours.surface, theirs.surface
        counts = _counts(read, aim, settings)

        def of_source(look: Progress) -> tuple[Cleaned, Int, list[Surface]]:
            """The source along the curve, its numbers, and its levels, all made upright."""
            own = canonical_frame(read.vertices)
            turned = read.moved(transformed(own, read.vertices))
            levels, back = _reduced(turned, counts[0], look), inverse(own)
            levels = [level.moved(transformed(back, level.vertices)) for level in levels]
            return *ordered(ours, turned.vertices), levels

        def of_target(_look: Progress) -> tuple[Cleaned, SurfaceIndex]:
            """The target along the curve, and its search structure."""
            target = ordered(theirs, aim.vertices)[0]
            return target, SurfaceIndex(target.surface)

        (ours, numbers, levels), targets, (theirs, index) = at_once(
            of_source,
            lambda look: _reduced(aim, counts[1], look),
            of_target,
            progress=repeating(progress, 0.0, "reduced meshes"),
        )
        source, target = ours.surface, theirs.surface
        options: dict[str, Any] = {"partial": settings.partial, "fix_units": settings.fix_units}
        options |= {"fix_mirror": settings.fix_mirror, "samples": _samples(levels, [*targets, target])}
        options |= {"progress": part(progress, 0.05, 0.25)}
        if pairs is None:
            alignment = align(source, target, settings.alignment, **options)
        else:
            alignment, pairs = lead(source, target, settings.alignment, pairs, **options)
        moved = [mesh.moved(transformed(alignment.matrix, mesh.vertices)) for mesh in (*levels, source)]
        rest = source
        if np.linalg.det(alignment.matrix[:3, :3]) < 0:  # a mirror image: the maths wants it outward again
            moved = [Surface(mesh.vertices, mesh.faces[:, ::-1]) for mesh in moved]
            rest = Surface(rest.vertices * [-1.0, 1.0, 1.0], moved[-1].faces)
        weight = settings.landmark_weight if settings.steer else 0.0
        return cls(
            ours=ours,
            theirs=theirs,
            numbers=numbers,
            alignment=alignment,
            rest=rest,
            reference=Reference(moved[-1]),
            index=index,
            sources=moved,
            targets=[*targets, target],
            size=target.diagonal,
            pairs=pairs,
            weight=weight,
        )


def _counts(source: Surface, target: Surface, settings: MorphSettings) -> list[list[int]]:
    """Node counts of the reduced meshes of both, from the coarsest on."""
    counts = [node_counts(settings, len(mesh.vertices)) for mesh in (source, target)]
    if settings.reduction == 0 or len(counts[0]) != len(counts[1]):
        counts[1] = counts[0]
    return counts


def _reduced(surface: Surface, counts: list[int], progress: Progress) -> list[Surface]:
    """Reduced meshes, numbered along the curve when all are made."""
    return [numbered(level) for level in pyramid(surface, counts, progress)]


def _samples(levels: list[Surface], targets: list[Surface]) -> tuple[Surface, Surface] | None:
    """The coarsest levels of both, where they are as fine as the alignment wants them."""
    if not levels or not all(0.9 < len(mesh.vertices) / SAMPLE < 1.5 for mesh in (levels[0], targets[0])):
        return None
    return levels[0], targets[0]
