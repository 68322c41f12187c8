# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures and histograms of bodies before and after a removal of overclosure, for a report's page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from .bodies import Body
from .mesh import Float, Int, Surface
from .overclosure_check import gap_map
from .picture import BONE, Look, facing, views
from .plots import histogram
from .report_figures import SOURCE, TARGET, heat_pictures, with_unit
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
    exclude = list(exclude)
    shapes = {body.name: _surface(body) for body in before}
    sights = views([surface for surface, _ in shapes.values()])
    reach = max(EDGES * float(np.median([one.mean_edge for one, _ in shapes.values()])), DEEP * deepest)
    states = {"before": {body.name: body.nodes for body in before}}
    if after is not None:
        states["after"] = dict(after)
    items: list[Item] = []
    gaps = {}
    for state, nodes in states.items():
        together = [surface.moved(nodes[name][rows]) for name, (surface, rows) in shapes.items()]
        colours = [COLOURS[number % len(COLOURS)] for number in range(len(together))]
        for sight, word in zip(sights, ("", ", a quarter turn on"), strict=True):
            items.append(Figure(Look.of(together, sight).coloured(colours), f"All bodies {state}{word}"))
        placed = [Body(body.name, body.mesh.moved(nodes[body.name])) for body in before]
        gaps[state] = gap_map(placed, reach, exclude=exclude)
    near = {name: any((gaps[state][name] < reach).any() for state in states) for name in shapes}
    moved = {
        body.name: np.linalg.norm(states.get("after", states["before"])[body.name] - body.nodes, axis=1)
        for body in before
    }
    told = [name for name in shapes if near[name] or moved[name].any()]
    for name in told[:MOST]:
        surface, rows = shapes[name]
        least = np.minimum.reduce([gaps[state][name][rows] for state in states])
        touching = surface.vertices[least <= np.percentile(least, NEAREST)]
        own = [facing(sight, [touching]) for sight in views([surface])]
        placed_there = {state: surface.moved(nodes[name][rows]) for state, nodes in states.items()}
        looks = {
            state: [Look.of([here], sight) for sight in own]
            for state, here in placed_there.items()
            if near[name] or state == "after"
        }
        if moved[name].any():
            items.append(f"{name}: how far it was moved.")
            shown = {"displacement": moved[name][rows]}
            items += heat_pictures(placed_there["after"], shown, looks["after"], unit)
        for state, here in placed_there.items() if near[name] else ():
            items.append(f"{name}, {state}: gap to the nearest other body; negative inside it.")
            items += heat_pictures(here, {"gap": gaps[state][name][rows]}, looks[state], unit)
    if len(told) > MOST:
        items.append(f"Pictures of the first {MOST} of {len(told)} bodies that touch others or were moved.")
    plots = []
    for name in told:
        far = moved[name][moved[name] > 0]
        drawn = histogram({"": far}, with_unit("displacement", unit), "moved nodes")
        plots.append((drawn, f"{name}: how far its nodes were moved."))
        close = {state: gaps[state][name][gaps[state][name] < reach] for state in states}
        drawn = histogram(close, with_unit("gap", unit), "nodes near another body")
        plots.append((drawn, f"{name}: gap to the nearest other body; negative inside it."))
    spread = tuple(Figure(drawn, words) for drawn, words in plots if drawn)
    return [Section("Pictures", tuple(items)), Section("Distributions", spread)]


def _surface(body: Body) -> tuple[Surface, Int]:
    """Return a body's surface, and the node of each of its vertices."""
    if isinstance(body.mesh, Surface):
        return body.mesh, np.arange(len(body.mesh.vertices), dtype=np.int32)
    return body.mesh.surface()
