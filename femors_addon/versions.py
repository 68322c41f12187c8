# SPDX-License-Identifier: GPL-3.0-or-later
"""Which versions a result comes from."""

from __future__ import annotations

import platform
import tomllib
from pathlib import Path

import numpy
import scipy


def version() -> str:
    """Return the version, which stands in the extension's manifest and nowhere else."""
    manifest = Path(__file__).parent.parent / "blender_manifest.toml"
    try:
        return str(tomllib.loads(manifest.read_text(encoding="utf-8"))["version"])
    except OSError:
        return "unknown (blender_manifest.toml is missing)"


def versions() -> dict[str, str]:
    """Return the versions that a result depends on, by name."""
    return {
        "FEMORS": version(),
        "Python": platform.python_version(),
        "NumPy": numpy.__version__,
        "SciPy": scipy.__version__,
        "System": f"{platform.system()} {platform.machine()}",
    }
