# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a new object stands in the file: beside the one that it was made from, and where it is seen."""

from __future__ import annotations

import bpy


def place(context: bpy.types.Context, item: bpy.types.Object, like: bpy.types.Object) -> None:
    """Put a new object into the collections of another, and into the scene where none of them shows it.

    Nothing can be put into collections of other files. Those of another scene, or that this view layer
    leaves out, would hide the result from whoever has asked for it.
    """
    for collection in like.users_collection:
        if collection.library is None and collection.override_library is None:
            collection.objects.link(item)
    context.view_layer.update()  # until then it does not know the new object
    if not seen(context.view_layer, item):
        context.scene.collection.objects.link(item)
        context.view_layer.update()


def seen(layer: bpy.types.ViewLayer, item: bpy.types.Object) -> bool:
    """Whether an object is in a view layer; one of another file may have its name."""
    return item in layer.objects.values()
