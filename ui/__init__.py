# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar tab FEMORS, and its preferences."""

from __future__ import annotations

import bpy

from . import panels, preferences


def register() -> None:
    """Register the preferences and the panels."""
    for cls in (*preferences.classes, *panels.classes):
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take them back, in reverse."""
    for cls in reversed((*preferences.classes, *panels.classes)):
        bpy.utils.unregister_class(cls)
