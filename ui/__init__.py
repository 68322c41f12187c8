# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar tab FEMORS."""

from __future__ import annotations

import bpy

from . import panels, transfer


def register() -> None:
    """Register the panels."""
    for cls in (*panels.classes, *transfer.classes):
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take the panels back."""
    for cls in reversed((*panels.classes, *transfer.classes)):
        bpy.utils.unregister_class(cls)
