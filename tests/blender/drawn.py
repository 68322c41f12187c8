# SPDX-License-Identifier: GPL-3.0-or-later
"""What a panel draws, without a window."""

from __future__ import annotations

from types import SimpleNamespace

import bpy


class Layout:
    """Takes down what is drawn, and how."""

    def __init__(self):
        self.said, self.buttons = [], []

    def row(self, **options):
        return self

    column = split = box = row

    def label(self, text="", icon="NONE"):
        self.said.append(text or icon)

    def prop(self, data, name, **options):
        self.buttons.append(name)

    def separator(self, **options):
        self.said.append("---")


def sidebar(width: float, scale: float = 1.0):
    """A context whose region is as wide as this."""
    return SimpleNamespace(
        region=SimpleNamespace(width=width),
        scene=bpy.context.scene,
        preferences=SimpleNamespace(system=SimpleNamespace(ui_scale=scale)),
    )
