# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands under FEMORS in Edit > Preferences > Add-ons."""

from __future__ import annotations

import bpy

from ..femors_addon.version import version
from ..operators import dependencies
from .figures import draw_sentence


class FEMORS_preferences(bpy.types.AddonPreferences):
    """Whether FEMORS can work in this Blender, and with which packages."""

    bl_idname = __package__.rpartition(".")[0]

    def draw(self, context: bpy.types.Context) -> None:
        """Draw one sentence where something is amiss, then the versions."""
        sentence = dependencies.missing()
        if sentence:
            draw_sentence(self.layout, context, sentence, "ERROR")
        draw_sentence(self.layout, context, f"FEMORS {version()} with {dependencies.found()}")


classes = (FEMORS_preferences,)
