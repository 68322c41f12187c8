# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators: read the scene, run the core, write the scene. NumPy and SciPy are imported as they run."""

from __future__ import annotations

import bpy

from . import (
    animate,
    command,
    decks,
    dependencies,
    heat,
    job,
    landmarks,
    morph,
    overclosure,
    presets,
    props,
    quality,
    report,
    transfer,
)

TOOLS = (*quality.classes, *report.classes, *animate.classes, *presets.classes)


def register() -> None:
    """Register properties, operators and the command line."""
    dependencies.forget()
    props.register()
    job.register()
    for cls in morph.classes:
        bpy.utils.register_class(cls)
    decks.register()
    overclosure.register()
    transfer.register()
    landmarks.register()
    heat.register()
    for cls in TOOLS:
        bpy.utils.register_class(cls)
    command.register()


def unregister() -> None:
    """End a running job and take everything back, in reverse."""
    command.unregister()
    for cls in reversed(TOOLS):
        bpy.utils.unregister_class(cls)
    heat.unregister()
    landmarks.unregister()
    transfer.unregister()
    overclosure.unregister()
    decks.unregister()
    job.unregister()
    for cls in reversed(morph.classes):
        bpy.utils.unregister_class(cls)
    props.unregister()
