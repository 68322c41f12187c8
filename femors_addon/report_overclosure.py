# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures and histograms of bodies before and after a removal of overclosure, for a report's page."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property

import numpy as np

from .bodies import Body
from .mesh import Float, Int, Surface
from .overclosure_check import gap_map
from .picture import BONE, Look, facing, views
from .plots import histogram
from .report_figures import SOURCE, TARGET, from_all, heat_pictures, with_unit
from .report_html import Figure, Item, Section

NEAREST = 1.0  # per cent of a body's vertices: those nearest another body are to be seen
COLOURS = (BONE, TARGET, SOURCE, (0.45, 0.66, 0.38), (0.72, 0.60, 0.75))
MOST = 6  # bodies that have pictures of their own
EDGES = 3.0  # mean edges around a body in which gaps are shown, or
DEEP = 1.5  # times the deepest overlap, where that is more


def overclosure_figures(
    before: Sequence[Body],
    after: Mapping[str, Float] | None,
    deepest: float,
    exclude: Iterable[tuple[str, str]] = (),
    unit: str = "",
) -> list[Section]:
    """Return the sections "Pictures" and "Distributions" of a removal, or of a check.

    Parameters
    ----------
    before : sequence of Body
    after : dict of str to (n, 3) array or None
        Where each body's nodes are now, by its name; None where nothing was to be moved.
    deepest : float
        Depth of the deepest overlap before.
    exclude : iterable of pairs of names
        Pairs that may overlap.
    unit : str
        Of lengths; "" where it is not known.
    """
    shapes = {body.name: _surface(body) for body in before}
    reach = max(EDGES * float(np.median([one.mean_edge for one, _ in shapes.values()])), DEEP * deepest)
    sights = views([surface for surface, _ in shapes.values()])
    states = {"before": {body.name: body.nodes for body in before}}
    if after is not None:
        states["after"] = dict(after)
    exclude, items, gaps = list(exclude), list[Item](), {}
    for state, nodes in states.items():
        surfaces = [surface.moved(nodes[name][rows]) for name, (surface, rows) in shapes.items()]
        colours = [COLOURS[number % len(COLOURS)] for number in range(len(surfaces))]
        items += from_all([Look.of(surfaces, sight) for sight in sights], colours, f"All bodies {state}")
        placed = [Body(body.name, body.mesh.moved(nodes[body.name])) for body in before]
        gaps[state] = gap_map(placed, reach, exclude=exclude)
    told = []
    for name, shape in shapes.items():
        one = _Seen(name, *shape, {s: states[s][name] for s in states}, {s: gaps[s][name] for s in states})
        if one.moved.any() or one.near(reach):
            told.append(one)
    for one in told[:MOST]:
        items += one.pictures(reach, unit)
    if len(told) > MOST:
        items.append(f"Pictures of the first {MOST} of {len(told)} bodies that touch others or were moved.")
    spread = tuple(figure for one in told for figure in one.plots(reach, unit))
    return [Section("Pictures", tuple(items)), Section("Distributions", spread)]


@dataclasses.dataclass(frozen=True, eq=False)
class _Seen:
    """A body in each state, "before" and perhaps "after"."""

    name: str
    surface: Surface
    rows: Int  # the node of each of the surface's vertices
    nodes: Mapping[str, Float]  # (n, 3) by state
    gaps: Mapping[str, Float]  # (n,) by state

    @cached_property
    def moved(self) -> Float:
        """(n,) how far each node was moved."""
        return np.linalg.norm(self.nodes.get("after", self.nodes["before"]) - self.nodes["before"], axis=1)

    def near(self, reach: float) -> bool:
        """Whether another body is within reach in some state."""
        return any((gap < reach).any() for gap in self.gaps.values())

    def pictures(self, reach: float, unit: str) -> list[Item]:
        """How far the body was moved, and its gaps, seen from where it touches others."""
        least = np.minimum.reduce([gap[self.rows] for gap in self.gaps.values()])
        touching = self.surface.vertices[least <= np.percentile(least, NEAREST)]
        own = [facing(sight, [touching]) for sight in views([self.surface])]
        near, there = self.near(reach), {s: self.surface.moved(n[self.rows]) for s, n in self.nodes.items()}
        looks = {
            state: [Look.of([here], sight) for sight in own]
            for state, here in there.items()
            if near or state == "after"
        }
        items: list[Item] = []
        if self.moved.any():
            shown = {"displacement": self.moved[self.rows]}
            items.append(f"{self.name}: how far it was moved.")
            items += heat_pictures(there["after"], shown, looks["after"], unit)
        for state, here in there.items() if near else ():
            items.append(f"{self.name}, {state}: gap to the nearest other body; negative inside it.")
            items += heat_pictures(here, {"gap": self.gaps[state][self.rows]}, looks[state], unit)
        return items

    def plots(self, reach: float, unit: str) -> list[Figure]:
        """Histograms of the same."""
        close = {state: gap[gap < reach] for state, gap in self.gaps.items()}
        plots = (
            (
                histogram({"": self.moved[self.moved > 0]}, with_unit("displacement", unit), "moved nodes"),
                f"{self.name}: how far its nodes were moved.",
            ),
            (
                histogram(close, with_unit("gap", unit), "nodes near another body"),
                f"{self.name}: gap to the nearest other body; negative inside it.",
            ),
        )
        return [Figure(drawn, words) for drawn, words in plots if drawn]


def _surface(body: Body) -> tuple[Surface, Int]:
    """Return a body's surface, and the node of each of its vertices."""
    if isinstance(body.mesh, Surface):
        return body.mesh, np.arange(len(body.mesh.vertices), dtype=np.int32)
    return body.mesh.surface()
