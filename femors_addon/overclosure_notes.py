# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user should know of bodies before and after a removal, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from .bodies import Solid
from .cutouts import Region
from .findings import Excluded, Finding
from .intersect import crossings
from .overclosure_figures import BodyResult, mid_sides_of
from .progress import counted

if TYPE_CHECKING:
    from .effort import Effort

ALIKE = 0.9  # of both bodies' volumes: bodies that share more look like one
WIDE = 0.1  # of the smaller body's size: a gap above it looks like one in another unit
UNLIKE = 200.0  # times the size of another body: more looks like another unit of length
ROUNDED = 0.5  # of the gap: rounding that is more of it is told
DEEPER = 1.01  # times as deep as before: an excluded pair that is, is told
MUCH = 0.5  # of its volume: a body that is changed by more is another shape


def notes_of(
    solids: Sequence[Solid], before: Sequence[Finding], after: Sequence[Finding] | None = None
) -> list[str]:
    """Return what the user should know of bodies and of what was found among them, in words.

    `after` is what is found where they are now, if that is not what was found before.
    """
    notes = [note for solid in solids for note in solid.notes]
    for solid in solids:
        if solid.open_edges:
            notes.append(
                f"{solid.name}: the surface is open ({counted(solid.open_edges, 'border edge')}); "
                "its normals tell which side is inside, and bodies wholly inside it are not found"
            )
        if len(solid.inverted_input):
            notes.append(
                f"{solid.name}: elements inverted before: {len(solid.inverted_input)}; left alone, and not "
                "in the scaled Jacobians"
            )
        crossed = _crossed(solid, solids, before)
        if crossed:
            notes.append(
                f"{solid.name}: {counted(crossed, 'face')} near the overclosure crossed others of "
                "the same body before; which side is inside is uncertain there"
            )
    sizes = sorted((solid.begun_surface.diagonal, solid.name) for solid in solids)
    if sizes[0][0] * UNLIKE < sizes[-1][0]:
        notes.append(
            f"'{sizes[-1][1]}' is {sizes[-1][0] / sizes[0][0]:.0f} times as large as '{sizes[0][1]}': "
            "are all bodies in one unit of length?"
        )
    of = {solid.name: solid.begun_surface for solid in solids}
    for finding in before:
        size, larger = sorted(of[name].diagonal for name in finding.names)
        if size * UNLIKE < larger:
            continue  # all that follows would come from the other unit, which is told above
        room = max(abs(of[name].volume) for name in finding.names)
        if finding.shared is not None and finding.shared > ALIKE * room > 0:
            notes.append(f"{finding.one} and {finding.two}: take up nearly the same room; are they one body?")
        if finding.gap > WIDE * size:
            notes.append(
                f"{finding.one} and {finding.two}: the gap of {finding.gap:g} is {finding.gap / size:.0%} of "
                "the smaller body's size; is it in the bodies' unit?"
            )
    return notes + mid_sides_of(solids, before if after is None else after)


def _crossed(solid: Solid, solids: Sequence[Solid], before: Sequence[Finding]) -> int:
    """Return how many faces of a body cross others of it where its box meets that of one it overlaps."""
    crossed = 0
    surface = solid.begun_surface
    for finding in before:
        if solid.name in finding.names and not finding.clear:
            other = next(s for s in solids if s.name in finding.names and s is not solid).begun_surface
            low = np.maximum(surface.bounds[0], other.bounds[0])
            high = np.minimum(surface.bounds[1], other.bounds[1])
            near = Region.of(surface, low, high).surface
            crossed = max(crossed, len(np.unique(crossings(near, near))))
    return crossed


def afterwards(
    bodies: Sequence[BodyResult],
    solids: Sequence[Solid],
    excluded: Sequence[Excluded],
    efforts: Sequence[Effort],
    before: Sequence[Finding],
) -> Iterator[str]:
    """Say what a removal did beside what it was for: folds, bodies changed much, pairs pushed elsewhere."""
    yield from _folds(bodies)
    yield from _changes(bodies, solids)
    yield from _deeper(excluded)
    parted = {finding.names for finding in before if not finding.clear}
    if any(body.moved for body in bodies):
        yield from _rounded([one for one in efforts if one.pair.names in parted and one.pair.gap > 0])


def _rounded(efforts: Sequence[Effort]) -> Iterator[str]:
    """Tell where bodies are so far from the origin that single precision costs more than half of the gap."""

    def cost(effort: Effort) -> float:
        return effort.margin / effort.pair.gap

    worst = max(efforts, key=cost, default=None)
    if worst is not None and cost(worst) > ROUNDED:
        one, two = worst.pair.names
        yield (
            f"{one} and {two}: so far from the origin single precision (STL files, Blender) rounds by "
            f"{worst.margin / 4.0:.2g}; whatever they are written to, up to {worst.margin:.2g} is added to "
            "the gap for it: move the bodies nearer the origin for less"
        )


def _folds(bodies: Sequence[BodyResult]) -> list[str]:
    return [
        f"{body.name}: {counted(body.folded, 'face crosses', 'faces cross')} others of the same body since"
        for body in bodies
        if body.folded
    ]


def _changes(bodies: Sequence[BodyResult], solids: Sequence[Solid]) -> list[str]:
    """Tell of bodies that are hardly themselves any more."""
    notes = []
    for body, solid in zip(bodies, solids, strict=True):
        before, after = body.volume
        change = body.xor
        if change is None and before > 0 and not solid.open_edges:  # a sheet has no volume
            change = abs(after - before) / before
        if change is not None and change > MUCH:
            words = f"what the removal took away and added is {100.0 * change:.0f} % of its volume"
            notes.append(f"{body.name}: {words}; are the bodies in their places?")
    return notes


def _deeper(excluded: Sequence[Excluded]) -> Iterator[str]:
    """Say which excluded pairs have been pushed into each other."""
    for pair in excluded:
        if pair.depth_after > DEEPER * pair.depth_before:
            before = f"{pair.depth_before:.3g}" if pair.depth_before else "not at all"
            yield (
                f"{pair.one} and {pair.two}, an excluded pair, overlap by {pair.depth_after:.3g}, {before} "
                "before: others pushed them together"
            )
