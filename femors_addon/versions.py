# SPDX-License-Identifier: GPL-3.0-or-later
"""Which versions a result comes from."""

from __future__ import annotations

import platform

import numpy
import scipy

from .version import version


def versions() -> dict[str, str]:
    """Return the versions that a result depends on, by name."""
    return {
        "FEMORS": version(),
        "Python": platform.python_version(),
        "NumPy": numpy.__version__,
        "SciPy": scipy.__version__,
        "System": f"{platform.system()} {platform.machine()}",
    }
