# SPDX-License-Identifier: GPL-3.0-or-later
"""``blender --command femors ...``: the command line of the core, in Blender's own Python."""

from __future__ import annotations

import signal
import sys
from typing import Any, ClassVar

import bpy

from ..femors_addon.progress import FemorsError
from . import dependencies


class Command:
    """The command's registration; Blender takes it back by this handle only."""

    handle: ClassVar[Any] = None


def run(argv: list[str]) -> int:
    """Run the command line; return its exit code."""
    try:
        dependencies.require()
    except FemorsError as error:
        print(f"femors: {error}", file=sys.stderr)
        return 2
    from ..femors_addon import cli

    # Blender takes Ctrl-C for itself, and would go on
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return cli.main(argv)
    finally:
        if before is not None:  # one set in C, as Blender's, cannot be put back from Python
            signal.signal(signal.SIGINT, before)


def register() -> None:
    """Register the command."""
    Command.handle = bpy.utils.register_cli_command("femors", run)


def unregister() -> None:
    """Take the command back."""
    bpy.utils.unregister_cli_command(Command.handle)
    Command.handle = None
