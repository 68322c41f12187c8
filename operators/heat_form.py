# SPDX-License-Identifier: GPL-3.0-or-later
"""What a heat map's properties do when they change. Without bpy, on purpose: see `form`."""

from __future__ import annotations

from typing import Any, ClassVar


class Listener:
    """Whom a change is told to: `heat.repaint`, as long as the extension is registered."""

    repaint: ClassVar[Any] = None


def changed(form: Any, context: Any) -> None:
    """Paint anew what is shown as a heat map."""
    if Listener.repaint is not None:
        Listener.repaint(context)
