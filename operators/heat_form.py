# SPDX-License-Identifier: GPL-3.0-or-later
"""What a heat map's properties do when they change. Without bpy, on purpose: see `form`."""

from __future__ import annotations

from typing import Any


def changed(form: Any, context: Any) -> None:
    """Paint anew what is shown as a heat map."""
    from . import heat

    heat.repaint(context)


def is_mesh(form: Any, item: Any) -> bool:
    """Whether a picker offers this object: a mesh, and not one that was deleted."""
    return item.type == "MESH" and bool(item.users_scene)
