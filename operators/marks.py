# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks in a scene: empties that know their name, in a collection or as children of a mesh."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..femors_addon.progress import FemorsError

Array = NDArray[Any]
NAME = "femors_landmark"
"""Custom property of an empty: its landmark's name, which Blender may have had to number."""
FIGURES = ("distance", "residual", "stretch", "projected", "spread", "templates")
"""Custom properties of a predicted landmark, as in `landmarks.Prediction`, with "femors_" before each."""
SIZE = 0.01
"""Of what the landmarks span: how large an empty is drawn."""


def name_of(item: bpy.types.Object) -> str:
    """Return the name of the landmark that an empty is: without the number that Blender has added."""
    return str(item.get(NAME) or re.sub(r"\.\d{3,}$", "", item.name))


def add(
    context: bpy.types.Context,
    title: str,
    names: Sequence[str],
    points: Array,
    figures: Mapping[str, Sequence[Any]] | None = None,
    parent: bpy.types.Object | None = None,
) -> bpy.types.Collection:
    """Make an empty at each world point (k, 3), in a new collection in the scene; or leave nothing.

    Parameters
    ----------
    figures : mapping of str to sequence, optional
        What is known of each landmark, see `FIGURES`; NaN is not written.
    parent : object, optional
        The mesh that the landmarks are to belong to.
    """
    collection = bpy.data.collections.new(title)
    made = []
    try:
        size = SIZE * (float(np.linalg.norm(np.ptp(points, axis=0))) or 100.0)
        for row, (name, point) in enumerate(zip(names, points, strict=True)):
            item = bpy.data.objects.new(name, None)
            made.append(item)
            item.empty_display_type, item.empty_display_size = "SPHERE", size
            item.show_name = True
            note(item, name, {key: values[row] for key, values in (figures or {}).items()})
            if parent is not None:
                item.parent = parent
                item.matrix_parent_inverse = parent.matrix_world.inverted()
            item.location = point
            collection.objects.link(item)
        context.scene.collection.children.link(collection)
        context.view_layer.update()
    except Exception:
        for item in made:
            bpy.data.objects.remove(item)
        bpy.data.collections.remove(collection)
        raise
    return collection


def note(item: bpy.types.Object, name: str, figures: Mapping[str, Any]) -> None:
    """Write a landmark's name and figures to its empty, in place of those that it had."""
    item[NAME] = name
    for key in FIGURES:
        if f"femors_{key}" in item.keys():  # noqa: SIM118  (an object is no dict)
            del item[f"femors_{key}"]
    for key, value in figures.items():
        if not np.isnan(value):
            item[f"femors_{key}"] = value


def world(item: bpy.types.Object) -> Array:
    """Return the (3,) float64 world position of an empty."""
    return np.array(item.matrix_world.translation, dtype=np.float64)


def named(items: Sequence[bpy.types.Object], where: str) -> dict[str, bpy.types.Object]:
    """Return empties by the names of their landmarks.

    Raises
    ------
    FemorsError
        A name stands twice.
    """
    out: dict[str, bpy.types.Object] = {}
    for item in items:
        if name_of(item) in out:
            raise FemorsError(
                f"The landmark '{name_of(item)}' stands twice in {where} ('{out[name_of(item)].name}' and "
                f"'{item.name}'): rename one of them"
            )
        out[name_of(item)] = item
    return out


def children(item: bpy.types.Object) -> dict[str, Array]:
    """Return by name the world positions of the empties that are children of a mesh object."""
    empties = [child for child in item.children if child.type == "EMPTY" and child.users_scene]
    empties.sort(key=lambda child: child.name)
    return {name: world(child) for name, child in named(empties, f"'{item.name}'").items()}
