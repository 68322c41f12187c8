# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar tab FEMORS."""

from __future__ import annotations

import bpy

from . import overclosure, panels


def register() -> None:
    """Register the panels."""
    for cls in (*panels.classes, *overclosure.classes):
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take the panels back."""
    for cls in reversed((*panels.classes, *overclosure.classes)):
        bpy.utils.unregister_class(cls)
