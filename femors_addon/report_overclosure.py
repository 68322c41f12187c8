# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures and histograms of bodies before and after a removal of overclosure, for a report's page."""

from __future__ import annotations

import colorsys
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from .bodies import Body
from .mesh import Float, Int, Surface
from .overclosure_check import gap_map
from .picture import BONE, Look, facing, views
from .plots import histogram, key
from .report_figures import SOURCE, TARGET, from_all, heat_pictures, with_unit
from .report_html import Figure, Item, Section

NEAREST = 1.0  # per cent of a body's vertices: those nearest another body are to be seen
COLOURS = (
    *(BONE, TARGET, SOURCE, (0.45, 0.66, 0.38), (0.72, 0.60, 0.75), (0.82, 0.47, 0.42), (0.36, 0.62, 0.64)),
    *((0.90, 0.78, 0.35), (0.52, 0.46, 0.66), (0.62, 0.62, 0.60)),
)
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
    states = {"before": {body.name: body.nodes for body in before}}
    if after is not None:
        states["after"] = dict(after)
    reach = max(EDGES * float(np.median([one.mean_edge for one, _ in shapes.values()])), DEEP * deepest)
    exclude, gaps = list(exclude), {}
    for state, nodes in states.items():
        placed = [Body(body.name, body.mesh.moved(nodes[body.name])) for body in before]
        gaps[state] = gap_map(placed, reach, exclude=exclude)
    items, told = _together(shapes, states), []
    spread: list[Figure] = []
    for body in sorted(before, key=lambda one: float(gaps["before"][one.name].min())):  # the deepest first
        surface, rows = shapes[body.name]
        nodes = {state: places[body.name] for state, places in states.items()}
        moved = np.linalg.norm(nodes.get("after", body.nodes) - body.nodes, axis=1)
        gap = {state: values[body.name] for state, values in gaps.items()}
        near = any((values < reach).any() for values in gap.values())
        if not (near or moved.any()):
            continue
        told.append(body.name)
        if len(told) <= MOST:
            places = {state: surface.moved(where[rows]) for state, where in nodes.items()}
            on = {state: values[rows] for state, values in gap.items()} if near else {}
            items += _alone(body.name, surface, places, moved[rows], on, unit)
        spread += _spread(body.name, moved, {state: v[v < reach] for state, v in gap.items()}, unit)
    if len(told) > MOST:
        items.append(
            f"Pictures of {MOST} of {len(told)} bodies that touch others or were moved, deepest first."
        )
    return [Section("Pictures", tuple(items)), Section("Distributions", tuple(spread))]


def _colour(number: int) -> tuple[float, float, float]:
    """Return a colour for each body; beyond those that were chosen by the golden section of the wheel."""
    if number < len(COLOURS):
        return COLOURS[number]
    hue, vivid, bright = 0.618034 * number % 1.0, (0.35, 0.55)[number % 2], (0.65, 0.8, 0.9)[number % 3]
    return colorsys.hsv_to_rgb(hue, vivid, bright)


def _together(
    shapes: Mapping[str, tuple[Surface, Int]], states: Mapping[str, Mapping[str, Float]]
) -> list[Item]:
    """Return pictures of all bodies in each state."""
    sights = views([surface for surface, _ in shapes.values()])
    colours = [_colour(number) for number in range(len(shapes))]
    items: list[Item] = []
    for state, nodes in states.items():
        together = [surface.moved(nodes[name][rows]) for name, (surface, rows) in shapes.items()]
        looks = [Look.of(together, sight) for sight in sights]
        items += from_all(looks, colours, f"All bodies {state}" if len(states) > 1 else "All bodies")
    return [*items, Figure(key(dict(zip(shapes, colours, strict=True))), "Which is which.")]


def _alone(
    name: str,
    surface: Surface,
    places: Mapping[str, Surface],
    moved: Float,
    gaps: Mapping[str, Float],
    unit: str,
) -> list[Item]:
    """Return pictures of a body, seen from where it touches others.

    Parameters
    ----------
    surface : Surface
        As it was given.
    places : dict of str to Surface
        In each state.
    moved : (n,) array
        How far each vertex was moved.
    gaps : dict of str to (n,) array
        To the nearest other body in each state; empty where none is near.
    """
    sights = views([surface])
    if gaps:
        least = np.minimum.reduce(list(gaps.values()))
        touching = surface.vertices[least <= np.percentile(least, NEAREST)]
        sights = [facing(sight, [touching]) for sight in sights]
    shown = [state for state in places if gaps or state == "after"]
    looks = {state: [Look.of([places[state]], sight) for sight in sights] for state in shown}
    items: list[Item] = []
    if moved.any():
        items.append(f"{name}: how far it was moved.")
        items += heat_pictures(places["after"], {"displacement": moved}, looks["after"], unit)
    for state, gap in gaps.items():
        items.append(f"{name}, {state}: gap to the nearest other body; negative inside it.")
        items += heat_pictures(places[state], {"gap": gap}, looks[state], unit)
    return items


def _spread(name: str, moved: Float, close: Mapping[str, Float], unit: str) -> list[Figure]:
    """Return histograms of how far a body's nodes were moved, and of the gaps of those near another."""
    plots = (
        (
            histogram({"": moved[moved > 0]}, with_unit("displacement", unit), "moved nodes"),
            f"{name}: how far its nodes were moved.",
        ),
        (
            histogram(close, with_unit("gap", unit), "nodes near another body"),
            f"{name}: gap to the nearest other body; negative inside it.",
        ),
    )
    return [Figure(drawn, words) for drawn, words in plots if drawn]


def _surface(body: Body) -> tuple[Surface, Int]:
    """Return a body's surface, and the node of each of its vertices."""
    if isinstance(body.mesh, Surface):
        return body.mesh, np.arange(len(body.mesh.vertices), dtype=np.int32)
    return body.mesh.surface()
