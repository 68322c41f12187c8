# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar tab FEMORS."""

from __future__ import annotations

import bpy

from . import legend, panels, preferences, quality, reports


def register() -> None:
    """Register the panels."""
    preferences.register()
    for cls in (*panels.classes, *quality.classes, *reports.classes):
        bpy.utils.register_class(cls)
    legend.register()


def unregister() -> None:
    """Take the panels back."""
    legend.unregister()
    for cls in reversed((*panels.classes, *quality.classes, *reports.classes)):
        bpy.utils.unregister_class(cls)
    preferences.unregister()
