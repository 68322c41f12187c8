# SPDX-License-Identifier: GPL-3.0-or-later
"""What the preferences do when they change. Without bpy, on purpose: see `form`."""

from __future__ import annotations

from typing import Any

from ..femors_addon.limits import allow
from .heat_form import changed as repaint

__all__ = ["changed", "repaint"]


def changed(preferences: Any, context: Any) -> None:
    """Let the core know how many threads and how much memory it may take."""
    allow(preferences.threads, preferences.memory)
