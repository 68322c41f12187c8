# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks in a scene: empties that know their name, in a collection or as children of a mesh."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import bpy

from ..femors_addon.progress import FemorsError
from .lazy import Array, np

NAME = "femors_landmark"
"""Custom property of an empty: its landmark's name, which Blender may have had to number."""
FIGURES = ("distance", "residual", "stretch", "projected", "spread", "templates")
"""Custom properties of a predicted landmark, as in `landmarks.Prediction`, with "femors_" before each."""
MADE = "femors_landmarks_of"
"""Custom property of a collection: the title that its landmarks were predicted under."""
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
    again: bool = False,
) -> bpy.types.Collection:
    """Make an empty at each world point (k, 3), in a new collection in the scene; or leave nothing.

    Parameters
    ----------
    again : bool
        Use the collection of this title that an earlier call has made: its landmarks of these names are
        moved, others stay.
    figures : mapping of str to sequence, optional
        What is known of each landmark, see `FIGURES`; NaN is not written.
    parent : object, optional
        The mesh that the landmarks are to belong to.
    """
    if parent is not None and abs(parent.matrix_world.determinant()) < 1e-30:
        raise FemorsError(
            f"'{parent.name}' is scaled to zero in some direction: correct its scale (Alt+S resets it)"
        )
    known = _made_before(context, title) if again else None
    if known is not None:
        return _renewed(context, known, names, points, figures or {})
    collection = bpy.data.collections.new(title)
    collection[MADE] = title
    made = []
    try:
        size = SIZE * (float(np.linalg.norm(np.ptp(points, axis=0))) or 100.0)
        for row, (name, point) in enumerate(zip(names, points, strict=True)):
            item = _empty(name, size)
            made.append(item)
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


def gathered(context: bpy.types.Context, title: str, items: Sequence[bpy.types.Object]) -> None:
    """Put new objects into a new collection of their own: beside the old ones each name would stand twice."""
    collection = bpy.data.collections.new(title)
    context.scene.collection.children.link(collection)
    for item in items:
        for other in item.users_collection:
            other.objects.unlink(item)
        collection.objects.link(item)
    context.view_layer.update()


def _empty(name: str, size: float) -> bpy.types.Object:
    item = bpy.data.objects.new(name, None)
    item.empty_display_type, item.empty_display_size = "SPHERE", size
    item.show_name = True
    return item


def _made_before(context: bpy.types.Context, title: str) -> bpy.types.Collection | None:
    """The collection in this scene that was made under a title, whatever it is called now."""
    for collection in context.scene.collection.children_recursive:
        if collection.get(MADE) == title:
            return collection
    return None


def _renewed(
    context: bpy.types.Context,
    collection: bpy.types.Collection,
    names: Sequence[str],
    points: Array,
    figures: Mapping[str, Sequence[Any]],
) -> bpy.types.Collection:
    there = {name_of(item): item for item in collection.objects if item.type == "EMPTY"}
    size = SIZE * (float(np.linalg.norm(np.ptp(points, axis=0))) or 100.0)
    for row, (name, point) in enumerate(zip(names, points, strict=True)):
        item = there.get(name)
        if item is None:
            item = _empty(name, size)
            collection.objects.link(item)
        context.view_layer.update()
        placed = item.matrix_world.copy()
        placed.translation = point
        item.matrix_world = placed
        note(item, name, {key: values[row] for key, values in figures.items()})
    context.view_layer.update()
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
