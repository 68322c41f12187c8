# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar tab FEMORS, and the preferences."""

from __future__ import annotations

import bpy

from . import overclosure, panels, preferences, transfer

CLASSES = (*preferences.classes, *panels.classes, *overclosure.classes, *transfer.classes)
"""Panels in the order of the sidebar."""


def register() -> None:
    """Register the preferences and the panels."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take them back, in reverse."""
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
