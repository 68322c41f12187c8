# SPDX-License-Identifier: GPL-3.0-or-later
"""What overlaps what, and how deep: found anew from the surfaces as they are, and trusted by nothing else.

The same measure finds overclosures before a removal and certifies afterwards that there are none.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csgraph

from . import triples
from .bodies import Body, Solid
from .booleans import shared_volume
from .contact import Region
from .crew import each, together
from .distances import Distances, Target, distances
from .intersect import crossings, piercings
from .mesh import Float, Surface, edge_matrix
from .progress import FemorsError, Progress, silent

WIDEST = 1e6  # the largest gap, as in the settings
SWALLOWED = 0.5  # of a body's nodes inside another: as many leaving by the wrong side, and it is contained
TOLERANCE = 1e-5  # of the unit: by how much a gap may miss what is asked for
CLEAR, NEAR, OVERLAP, CONTAINED = "clear", "too near", "overlap", "contained"

PairGaps = Mapping[tuple[str, str], float]
"""Gaps of single pairs, by their two names in either order."""


Bounds = dict[tuple[str, str], Float]
"""By the names of a body and of another: no signed distance of the body's vertices (n,) is smaller."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """Two bodies that overlap, or are closer than the band.

    Attributes
    ----------
    one, two : str
        Names of the bodies.
    gap : float
        Least distance asked for, in the unit of the coordinates.
    least : float
        Smallest signed distance of a node of one to the surface of the other; negative inside.
    over : tuple of int
        Nodes of each body that are closer than the gap.
    crossings : int
        Pairs of triangles that cross.
    contained : str
        Name of the body of which a whole piece lies inside the other, "" where there is none.
    where : tuple of float
        Place of the smallest distance.
    shared : float or None
        Volume that both take up; None where it could not be computed.
    state : str
        "clear", "too near", "overlap" or "contained".
    """

    one: str
    two: str
    gap: float
    least: float
    over: tuple[int, int]
    crossings: int
    contained: str
    where: tuple[float, float, float]
    shared: float | None
    state: str

    @property
    def names(self) -> tuple[str, str]:
        """Both names."""
        return self.one, self.two

    @property
    def depth(self) -> float:
        """How deep the deepest node is inside the other body; 0 where none is."""
        return max(0.0, -self.least)

    @property
    def clear(self) -> bool:
        """Whether nothing crosses, nothing is contained, and the gap holds."""
        return self.state == CLEAR

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {**dataclasses.asdict(self), "depth": self.depth}

    def __str__(self) -> str:
        if self.state == CLEAR:
            return f"{self.one} - {self.two}: clear, {self.least:.4g} apart"
        words = [f"{self.over[0] + self.over[1]} nodes closer than {self.gap:g}"]
        if self.depth > 0:
            words.insert(0, f"{self.depth:.4g} deep")
        if self.crossings:
            words.append(f"{self.crossings} crossing pairs of triangles")
        if self.shared:
            words.append(f"shared volume {self.shared:.4g}")
        if self.contained:
            words.append(f"a piece of '{self.contained}' lies wholly inside the other")
        place = ", ".join(f"{x:.4g}" for x in self.where)
        return f"{self.one} - {self.two}: {self.state}, {', '.join(words)}, at ({place})"


def tolerance(gap: float, size: float) -> float:
    """Return by how much a gap may be missed: 1e-5 of the unit, less where gap or bodies are tiny."""
    return min(TOLERANCE, 1e-3 * gap if gap > 0 else 1e-6 * size)


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

    out = dict.fromkeys(itertools.combinations(range(len(solids)), 2), gap)
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
        Compute shared volumes, which needs manifold3d.
    bounds : dict, optional
        Is given what became known of the vertices.
    """
    found = []
    targets = [Target(solid) for solid in solids]
    measured = each(
        [
            lambda i=i, j=j, g=gap: measure(targets[i], targets[j], g, max(band, 2.0 * g), volumes, bounds)
            for (i, j), gap in gaps.items()
        ]
    )
    with contextlib.closing(measured):  # where progress raises, what has not begun is dropped
        for number, (i, j) in enumerate(gaps):
            progress(number / len(gaps), f"checking {solids[i].name} and {solids[j].name}")
            finding = next(measured)
            if finding is not None:
                found.append(finding)
    return sorted(found, key=lambda f: f.least)


def measure(
    one: Target, two: Target, gap: float, band: float, volumes: bool = True, bounds: Bounds | None = None
) -> Finding | None:
    """Measure a pair anew; None where no node of one is within `band` of the other and nothing crosses."""
    a, b = one.surface, two.surface
    reach = band + 1e-9 * max(a.diagonal, b.diagonal)
    if (np.maximum(a.bounds[0], b.bounds[0]) - reach > np.minimum(a.bounds[1], b.bounds[1])).any():
        return None
    least, where, over = np.inf, np.zeros(3), []
    inside, near = [], []
    limit = gap - tolerance(gap, max(a.diagonal, b.diagonal))
    slack = _rounding(a) + _rounding(b)
    ways = ((one, two), (two, one))
    both = together([lambda s=own.surface, o=other: distances(s, o, reach) for own, other in ways])
    for (own, other), found in zip(ways, both, strict=True):
        if bounds is not None:
            bounds[own.solid.name, other.solid.name] = found.bound
        near.append(_close(own.surface, found, slack, own.longest))
        rows, distance, wrong = found.rows, found.signed - slack, found.wrong  # less in single precision
        over.append(int((distance < limit).sum()))
        if len(rows) and distance.min() < least:
            least, where = float(distance.min()), own.surface.vertices[rows[np.argmin(distance)]]
        deep: NDArray[np.bool_] = np.zeros(len(own.surface.vertices), dtype=bool)
        deep[rows[distance < 0]] = True
        # a ball whose socket has closed in on it comes free by its own side: that is no body in a body
        swallowed = deep.any() and wrong[distance < 0].mean() > SWALLOWED
        inside.append(deep if swallowed else np.zeros_like(deep))
    met = together(
        [
            lambda: len(crossings(*(part.bare() for part in near))),
            lambda: len(crossings(*(_single(part) for part in near))),
        ]
    )
    pairs = max(met)
    if least >= band and not pairs:
        return None
    if least >= reach:  # large faces cross, and no node is near
        ends = ((one, two), (two, one))
        least = min(float(distances(s.surface, o, np.inf).signed.min()) for s, o in ends)
    if pairs and least > 0:  # edges cross, and no node is inside: the place is theirs
        c, d = near
        places = np.concatenate((piercings(c, d).points(c), piercings(d, c).points(d)))
        where = places[len(places) // 2] if len(places) else where
    contained = ""
    for own, other, deep in ((one, two, inside[0]), (two, one, inside[1])):
        if not contained and deep.any() and _whole_piece(own.surface, other.surface, deep):
            contained = own.solid.name
    state = CLEAR
    if contained:
        state = CONTAINED
    elif pairs or least < -slack:
        state = OVERLAP
    elif sum(over):
        state = NEAR
    shared = 0.0 if state in (CLEAR, NEAR) else None
    if shared is None and volumes:
        shared = shared_volume(a, b)
    return Finding(
        one.solid.name,
        two.solid.name,
        gap,
        float(least),
        (over[0], over[1]),
        pairs,
        contained,
        (float(where[0]), float(where[1]), float(where[2])),
        shared,
        state,
    )


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


def _close(surface: Surface, found: Distances, slack: float, longest: float) -> Surface:
    """The faces that may cross the other surface: all their corners are within a side's length of it."""
    faces = surface.faces
    farthest = triples.greatest(found.apart[faces]) - slack
    chosen = np.flatnonzero(farthest <= longest)
    sides = np.sqrt(triples.longest_squared(surface.vertices.take(faces[chosen], axis=0)))
    return Region.cut(surface, chosen[farthest[chosen] <= sides * (1.0 + 1e-9) + slack]).surface


def _single(surface: Surface) -> Surface:
    """The surface with its coordinates in single precision, as Blender has them."""
    return surface.moved(surface.vertices.astype(np.float32).astype(np.float64))


def _rounding(surface: Surface) -> float:
    """Return how far single precision moves a vertex, at most."""
    rounded = surface.vertices.astype(np.float32).astype(np.float64)
    return float(triples.length(rounded - surface.vertices).max(initial=0.0))


def _whole_piece(surface: Surface, other: Surface, deep: NDArray[np.bool_]) -> bool:
    """Whether a connected piece of a surface lies inside the other without crossing it."""
    _, piece = csgraph.connected_components(edge_matrix(surface.edges, len(surface.vertices)), directed=False)
    outside = np.zeros(int(piece.max()) + 1, dtype=bool)
    np.logical_or.at(outside, piece, ~deep)
    whole = np.flatnonzero(~outside)
    if not len(whole):
        return False
    faces = np.isin(piece[surface.faces[:, 0]], whole)
    part = Surface(surface.vertices, surface.faces[faces])
    crossing = np.unique(piece[part.faces[crossings(part, other)[:, 0], 0]])
    return bool(len(np.setdiff1d(whole, crossing)))
