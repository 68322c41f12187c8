# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar tab FEMORS, and the preferences."""

from __future__ import annotations

import bpy

from . import legend, overclosure, panels, preferences, quality, reports, transfer

CLASSES = (*panels.classes, *overclosure.classes, *transfer.classes, *quality.classes, *reports.classes)
"""Panels in the order of the sidebar."""


def register() -> None:
    """Register the preferences, the panels and the legend."""
    preferences.register()
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    legend.register()


def unregister() -> None:
    """Take them back, in reverse."""
    legend.unregister()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
    preferences.unregister()
