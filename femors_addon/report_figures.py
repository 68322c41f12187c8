# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures and histograms of a morph, or of any mesh that carries numbers, for a report's page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from . import triples
from .colours import DIVERGING, painted, span
from .mesh import Float, Surface
from .nearest import SurfaceIndex
from .picture import BONE, Colours, Look, views
from .plots import bar, histogram
from .quality import aspect_ratio
from .quantities import QUANTITIES, triangle_jacobians
from .report_html import Figure, Item, Section

SOURCE, TARGET = (0.80, 0.67, 0.50), (0.55, 0.66, 0.78)
MAP = "lagoon"
ROUNDING = 1e-5  # of the size: lengths below are not worth a picture


def morph_figures(
    aligned: Surface | None,
    morphed: Surface,
    target: Surface | None,
    values: Mapping[str, ArrayLike],
    unit: str = "",
) -> list[Section]:
    """Return the sections "Pictures" and "Distributions" of a morph.

    Parameters
    ----------
    aligned, morphed, target : Surface
        Source after the alignment, result, and the shape to reach, all in one place; None where it is not
        known any more.
    values : dict of str to (n,) array
        Of the result's vertices, by the keys of `quantities.QUANTITIES`.
    unit : str
        Of lengths; "" where it is not known.
    """
    every = [one for one in (aligned, morphed, target) if one is not None]
    sights = views(every)
    items: list[Item] = []
    parts = ((aligned, SOURCE, "Source, aligned"), (target, TARGET, "Target"), (morphed, BONE, "Result"))
    looks = {}
    for surface, colour, name in parts:
        if surface is not None:
            looks[name] = [Look.of([surface], sight) for sight in sights]
            items += from_all(looks[name], [colour], name)
    items += heat_pictures(morphed, values, looks["Result"], unit)
    distances: dict[str, Float] = {}
    if target is not None:
        far = _away(target.vertices, morphed)
        items += _heat(
            target, far, looks["Target"], with_unit("Distance of the target from the result", unit)
        )
        if aligned is not None:
            distances["source, aligned"] = _by_node(target, _away(target.vertices, aligned))
        distances["result"] = _by_node(target, far)
    shapes = {"source": aligned, "result": morphed}
    aspects = {name: aspect_ratio(one) for name, one in shapes.items() if one is not None}
    jacobians = {name: triangle_jacobians(one) for name, one in shapes.items() if one is not None}
    plots = [
        (
            histogram(distances, with_unit("distance", unit)),
            "Distance of the target's vertices from the surface.",
        ),
        *_spread(morphed, values, unit),
        (histogram(aspects, "aspect ratio", "faces"), "Aspect ratio of the faces."),
        (
            histogram(jacobians, "scaled Jacobian", "faces"),
            "Scaled Jacobian of the faces (1 is equilateral).",
        ),
    ]
    spread = tuple(Figure(drawn, caption) for drawn, caption in plots if drawn)
    return [Section("Pictures", tuple(items)), Section("Distributions", spread)]


def mesh_figures(
    surface: Surface, other: Surface | None, values: Mapping[str, ArrayLike], unit: str = ""
) -> list[Section]:
    """Return the sections "Pictures" and "Distributions" of one mesh, beside another where there is one."""
    sights = views([surface] if other is None else [surface, other])
    looks = [Look.of([surface], sight) for sight in sights]
    items: list[Item] = from_all(looks, [BONE], "Mesh")
    if other is not None:
        both = [Look.of([surface, other], sight) for sight in sights]
        items += from_all(both, [BONE, TARGET], "With the other mesh (blue)")
    items += heat_pictures(surface, values, looks, unit)
    plots = [
        (histogram({"": aspect_ratio(surface)}, "aspect ratio", "faces"), "Aspect ratio of the faces."),
        (
            histogram({"": triangle_jacobians(surface)}, "scaled Jacobian", "faces"),
            "Scaled Jacobian of the faces.",
        ),
        *_spread(surface, values, unit),
    ]
    spread = tuple(Figure(drawn, caption) for drawn, caption in plots if drawn)
    return [Section("Pictures", tuple(items)), Section("Distributions", spread)]


def _away(points: Float, surface: Surface) -> Float:
    """Return (p,) distances of points from a surface, each node taken once: an STL file has it six times."""
    first, which = triples.placed(surface.vertices)
    merged = Surface(surface.vertices[first], which[surface.faces])
    one, every = triples.placed(points)
    return SurfaceIndex(merged).closest(points[one]).distance[every]


def _by_node(surface: Surface, values: ArrayLike) -> Float:
    """Return the values (n,) of vertices that faces use; those at one place count once where they agree."""
    used = np.unique(surface.faces)
    known = np.asarray(values, dtype=np.float64)[used]
    return known[triples.unique_rows(np.column_stack((surface.vertices[used], known)))[0]]


def heat_pictures(
    surface: Surface, values: Mapping[str, ArrayLike], looks: list[Look], unit: str
) -> list[Item]:
    """Return, for each quantity, the surface coloured by it in all looks at it, and the legend."""
    items: list[Item] = []
    for key, label in _labels(values, unit):
        items += _heat(surface, values[key], looks, label, QUANTITIES[key].signed)
    return items


def _heat(
    surface: Surface, values: ArrayLike, looks: list[Look], label: str, signed: bool = False
) -> list[Item]:
    """Return a surface coloured by values of its vertices, and the legend; a sentence where all are 0."""
    numbers, least = np.asarray(values, dtype=float), ROUNDING * surface.diagonal
    if np.abs(numbers).max(initial=0.0) < least:
        return [f"{label}: 0 everywhere, but for rounding."]
    name = DIVERGING if signed else MAP
    low, high = span(numbers, signed, least)
    colours = painted(numbers, low, high, name)
    legend = Figure(bar(name, low, high, label), "Values beyond the ends have the end's colour.")
    return [*from_all(looks, [colours], label), legend]


def _labels(values: Mapping[str, ArrayLike], unit: str) -> list[tuple[str, str]]:
    out = []
    for key, quantity in QUANTITIES.items():
        if key in values and not quantity.of_faces:
            out.append((key, with_unit(quantity.label, unit)))
    return out


def _spread(surface: Surface, values: Mapping[str, ArrayLike], unit: str) -> list[tuple[str, str]]:
    """Return a histogram and its caption for each quantity that is more than rounding."""
    least = ROUNDING * surface.diagonal
    return [
        (histogram({key: _by_node(surface, values[key])}, label), f"{label} at the vertices.")
        for key, label in _labels(values, unit)
        if np.abs(np.asarray(values[key])).max(initial=0.0) >= least
    ]


def with_unit(label: str, unit: str) -> str:
    """Return what an axis says, with the unit, or whose it is where it is not known."""
    return f"{label} ({unit or 'in the unit of the meshes'})"


def from_all(looks: list[Look], colours: Sequence[Colours], name: str) -> list[Item]:
    """Return pictures of surfaces in the two views of `picture.views`, and what they are called."""
    words = ("", ", a quarter turn on")
    return [Figure(look.coloured(colours), name + word) for look, word in zip(looks, words, strict=True)]
