# SPDX-License-Identifier: GPL-3.0-or-later
"""The form of the morph, saved and loaded the way of Blender's own presets.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

from typing import ClassVar

import bpy
from bl_operators.presets import AddPresetBase

from ..femors_addon.morph_settings import MorphSettings
from ..femors_addon.settings import specs

FOLDER = "femors/morph"
FORM = "bpy.context.scene.femors"


class FEMORS_MT_presets(bpy.types.Menu):
    """Presets that the user has saved"""

    bl_idname = "FEMORS_MT_presets"
    bl_label = "My Presets"
    preset_subdir = FOLDER
    preset_operator = "script.execute_preset"
    draw = bpy.types.Menu.draw_preset


class FEMORS_OT_preset_add(AddPresetBase, bpy.types.Operator):
    """Save the settings of the morph under a name, or remove those that were chosen last"""

    bl_idname = "femors.preset_add"
    bl_label = "Save Morph Preset"
    preset_menu = "FEMORS_MT_presets"
    preset_subdir = FOLDER
    # Whole paths and no `preset_defines`: an older Blender on Python 3.13 cannot evaluate those.
    # The built-in preset comes first: choosing it fills in what then follows.
    preset_values: ClassVar[list[str]] = [
        f"{FORM}.{name}"
        for name in (
            *sorted(specs(MorphSettings), key=lambda name: name != "preset"),
            *("result", "use_evaluated", "hide_target"),
        )
    ]

    name: bpy.props.StringProperty(
        name="Name", description="Name of the preset", maxlen=64, options={"SKIP_SAVE"}
    )
    remove_name: bpy.props.BoolProperty(
        name="Remove by Name",
        description="Remove the preset of this name",
        default=False,
        options={"HIDDEN", "SKIP_SAVE"},
    )
    remove_active: bpy.props.BoolProperty(
        name="Remove",
        description="Remove the preset that was chosen last",
        default=False,
        options={"HIDDEN", "SKIP_SAVE"},
    )


classes = (FEMORS_MT_presets, FEMORS_OT_preset_add)
