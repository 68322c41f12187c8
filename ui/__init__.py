# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar tab FEMORS."""

from __future__ import annotations

import bpy

from . import overclosure, panels, transfer

CLASSES = (*panels.classes, *overclosure.classes, *transfer.classes)
"""In the order of the sidebar."""


def register() -> None:
    """Register the panels."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take the panels back."""
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
