# SPDX-License-Identifier: GPL-3.0-or-later
"""What overlaps what, and how deep: found anew from the surfaces as they are, and trusted by nothing else.

The same measure finds overclosures before a removal and certifies afterwards that there are none.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterable, Mapping, Sequence
from functools import partial

import numpy as np

from .bodies import Body, Solid
from .boxes import Boxes
from .crew import each
from .distances import Target, distances
from .findings import CONTAINED, NEAR, Finding
from .mesh import Float
from .pair_check import Bounds, measure
from .progress import FemorsError, Progress, silent

__all__ = [
    "CONTAINED",
    "NEAR",
    "Bounds",
    "Finding",
    "PairGaps",
    "asked_gaps",
    "find",
    "gap_map",
    "same_surface",
]

WIDEST = 1e6  # the largest gap, as in the settings

PairGaps = Mapping[tuple[str, str], float]
"""Gaps of single pairs, by their two names in either order."""


def asked_gaps(
    solids: Sequence[Solid], gap: float, exclude: Iterable[tuple[str, str]], gaps: PairGaps
) -> dict[tuple[int, int], float]:
    """Return the gap of every pair of bodies that is not excluded, by their numbers.

    Raises
    ------
    FemorsError
        A name that no body has, a pair of a body with itself, or a negative gap.
    """
    names = {solid.name: number for number, solid in enumerate(solids)}

    def numbers(pair: tuple[str, str]) -> tuple[int, int]:
        for name in pair:
            if name not in names:
                raise FemorsError(f"there is no body '{name}'; there are {', '.join(names)}")
        if pair[0] == pair[1]:
            raise FemorsError(f"'{pair[0]}' is no pair: name two bodies")
        low, high = sorted(names[name] for name in pair)
        return low, high

    out = every_pair(solids, gap)
    for pair in exclude:
        out.pop(numbers(pair), None)
    for pair, own in gaps.items():
        if not 0 <= own <= WIDEST:  # also where it is NaN
            raise FemorsError(
                f"the gap of {pair[0]} and {pair[1]} is {own:g}; it must be from 0 to {WIDEST:g}"
            )
        if numbers(pair) in out:
            out[numbers(pair)] = float(own)
    return out


def every_pair(solids: Sequence[Solid], gap: float) -> dict[tuple[int, int], float]:
    """Return a gap for every pair of bodies, by their numbers."""
    return dict.fromkeys(itertools.combinations(range(len(solids)), 2), gap)


def find(
    solids: Sequence[Solid],
    gaps: Mapping[tuple[int, int], float],
    band: float,
    progress: Progress = silent,
    volumes: bool = True,
    bounds: Bounds | None = None,
) -> list[Finding]:
    """Return every pair that overlaps or is closer than `band`, the deepest first.

    Parameters
    ----------
    gaps : mapping
        The pairs to be looked at, and what is asked of each, from `asked_gaps`.
    band : float
        Of the unit of the coordinates; pairs farther apart are not listed.
    volumes : bool
        Compute shared volumes.
    bounds : dict, optional
        Is given what became known of the vertices.
    """
    found = []
    targets = [Target(solid) for solid in solids]
    reach = {pair: max(band, 2.0 * gap) for pair, gap in gaps.items()}
    slack = 1e-6 * max((solid.surface.diagonal for solid in solids), default=0.0)  # `measure` looks closer
    apart = Boxes([solid.surface for solid in solids]).apart(list(gaps))
    pairs = [pair for pair, far in zip(gaps, apart, strict=True) if far <= reach[pair] + slack]
    measured = each(
        [partial(measure, targets[i], targets[j], gaps[i, j], reach[i, j], volumes, bounds) for i, j in pairs]
    )
    with contextlib.closing(measured):  # where progress raises, what has not begun is dropped
        for number, (i, j) in enumerate(pairs):
            progress(number / len(pairs), f"checking {solids[i].name} and {solids[j].name}")
            finding = next(measured)
            if finding is not None:
                found.append(finding)
    return sorted(found, key=lambda f: -f.edge_depth if f.edge_depth and f.least >= 0 else f.least)


def gap_map(
    bodies: Sequence[Body],
    reach: float = 0.0,
    progress: Progress = silent,
    *,
    exclude: Iterable[tuple[str, str]] = (),
) -> dict[str, Float]:
    """Return, by name of each body, the signed distance (n,) of its nodes to the nearest other body.

    Negative inside another; `reach` for what is farther away, and for nodes below the surface.

    Parameters
    ----------
    reach : float
        In the unit of the coordinates; 0 = three mean edges, the median of the bodies.
    exclude : iterable of pairs of names
        Bodies that do not count for each other.
    """
    solids = [Solid(body, 0.0) for body in bodies]
    reach = reach or 3.0 * float(np.median([solid.surface.mean_edge for solid in solids]))
    values = [np.full(len(solid.corner), reach) for solid in solids]
    pairs = asked_gaps(solids, 0.0, exclude, {})
    targets = [Target(solid) for solid in solids]
    for number, (i, j) in enumerate(pairs):
        progress(number / len(pairs), f"gaps of {solids[i].name} and {solids[j].name}")
        for own, other in ((i, j), (j, i)):
            found = distances(solids[own].surface, targets[other], reach, exact=True)
            values[own][found.rows] = np.minimum(values[own][found.rows], found.signed)
    return {solid.name: solid.by_node(value, reach) for solid, value in zip(solids, values, strict=True)}


def same_surface(one: Solid, two: Solid) -> bool:
    """Whether two bodies are copies that stand in one place."""
    a, b = one.surface, two.surface
    if len(a.vertices) != len(b.vertices):
        return False
    close = 1e-6 * max(a.diagonal, b.diagonal)
    order = [np.lexsort(np.round(s.vertices / (10 * close)).T) for s in (a, b)]
    return bool(np.abs(a.vertices[order[0]] - b.vertices[order[1]]).max(initial=0.0) <= close)
