# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's preferences.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

import bpy

from ..femors_addon.version import version
from ..operators import dependencies, preferences_form
from .figures import UNITS, draw_sentence

PACKAGE = __package__.rpartition(".")[0]

MAPS = (
    ("lagoon", "Lagoon", "Dark violet over blue and green to light yellow"),
    ("ember", "Ember", "Dark red over orange to light yellow"),
    ("grey", "Grey", "Dark to light grey, for print"),
)
"""Those of `femors_addon.colours`, which takes SciPy to import; a test compares them."""


class FEMORS_preferences(bpy.types.AddonPreferences):
    """What holds in every file."""

    bl_idname = PACKAGE

    unit: bpy.props.EnumProperty(
        name="Default Unit",
        description="What a length of 1 means in scenes whose unit was never set, for tables and legends",
        items=[("NONE", "Not Known", "Lengths are called scene units")]
        + [(key, name, f"A length of 1 is 1 {name}") for key, (_, name) in UNITS.items()],
        default="NONE",
    )
    threads: bpy.props.IntProperty(
        name="Threads",
        description="For whatever goes block by block; 0 takes all processors. Results do not depend on it",
        default=1,
        min=0,
        max=256,
        update=preferences_form.changed,
    )
    memory: bpy.props.IntProperty(
        name="Memory Limit (MB)",
        description=(
            "A morph, a removal of overclosure, a transfer or a measurement of quality that would need more "
            "is refused before it starts; 0 is no limit"
        ),
        default=0,
        min=0,
        soft_max=65536,
        update=preferences_form.changed,
    )
    colour_map: bpy.props.EnumProperty(
        name="Colours",
        description="Colour map of heat maps without a sign; equal steps look equal in each of them",
        items=MAPS,
        default="lagoon",
        update=preferences_form.repaint,
    )

    def draw(self, context: bpy.types.Context) -> None:
        """Draw what is missing, then the settings."""
        layout = self.layout
        sentence = dependencies.missing()
        if sentence:
            draw_sentence(layout, context, sentence, "ERROR")
        layout.use_property_split = True
        column = layout.column()
        for name in ("unit", "colour_map", "threads", "memory"):
            column.prop(self, name)
        draw_sentence(layout, context, f"FEMORS {version()} with {dependencies.found()}")


classes = (FEMORS_preferences,)


def register() -> None:
    """Register the class, and let what was saved hold from now on."""
    for cls in classes:
        bpy.utils.register_class(cls)
    addon = bpy.context.preferences.addons.get(PACKAGE)
    if addon is not None and addon.preferences is not None:
        preferences_form.changed(addon.preferences, bpy.context)


def unregister() -> None:
    """Take the class back."""
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
