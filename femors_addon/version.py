# SPDX-License-Identifier: GPL-3.0-or-later
"""Which FEMORS this is."""

from __future__ import annotations

import functools
import tomllib
from pathlib import Path


@functools.cache
def version() -> str:
    """Return the version, which stands in the extension's manifest and nowhere else."""
    manifest = Path(__file__).parent.parent / "blender_manifest.toml"
    try:
        return str(tomllib.loads(manifest.read_text(encoding="utf-8"))["version"])
    except OSError:
        return "unknown (blender_manifest.toml is missing)"
