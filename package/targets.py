# SPDX-License-Identifier: GPL-3.0-or-later
"""What is built: one zip for each platform, the Pythons in it, and the packages that it brings."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "requirements" / "wheels.lock.toml"
CACHE = Path(os.environ.get("FEMORS_CACHE") or Path.home() / ".cache" / "femors") / "wheels"
"""Wheels that were fetched before, by file name; each is compared with the lock before it is used."""

PURE = {
    "meshio": "5.3.5",
    "rich": "15.0.0",
    "markdown-it-py": "4.3.0",
    "mdurl": "0.1.2",
    "pygments": "2.21.0",
}
"""What reads VTK and Gmsh, and what that needs beside NumPy: the same wheel everywhere."""
COMPILED = {"scipy": "1.15.3", "fast-simplification": "0.2.0"}
"""One pin for the Blenders of blender.org, 4.2 to 5.2."""
PROVIDED = {"numpy": {"3.11": ("1.24.3", "1.26.4"), "3.13": ("2.2.4", "2.3.4"), "3.14": ("2.4.0",)}}
"""What Blender has by itself and no zip may bring: the versions that were seen in it, by Python."""
LICENCES = {
    "scipy": "BSD-3-Clause",
    "fast-simplification": "MIT",
    "meshio": "MIT",
    "rich": "MIT",
    "markdown-it-py": "MIT",
    "mdurl": "MIT",
    "pygments": "BSD-2-Clause",
}
"""SPDX identifiers, as read in the licence texts of these wheels; all may go with GPL-3.0-or-later."""
COMPANIONS = {
    "scipy": "OpenBLAS and LAPACK (BSD-3-Clause-Attribution), the GCC runtime (GPL-3.0 with GCC exception; "
    "its libquadmath LGPL-2.1-or-later)",
    "fast-simplification": "on Linux libgomp of the GCC runtime (GPL-3.0 with GCC exception)",
}
"""What compiled wheels hold besides, as their own licence texts say."""

LINUX = tuple(f"manylinux_2_{n}_x86_64" for n in (28, 27, 26, 24, 17)) + ("manylinux2014_x86_64",)
"""The C library 2.28, which Blender itself wants, and older ones."""


@dataclass(frozen=True)
class Build:
    """One zip: its name's end, Blender's word for the platform, pip's, and versions by Python."""

    name: str
    platform: str
    tags: tuple[str, ...]
    pythons: dict[str, dict[str, str]]


OFFICIAL = {"3.11": PURE | COMPILED, "3.13": PURE | COMPILED}
BUILDS = (
    Build("linux-x64", "linux-x64", LINUX, OFFICIAL),
    Build("windows-x64", "windows-x64", ("win_amd64",), OFFICIAL),
    Build("macos-arm64", "macos-arm64", ("macosx_12_0_arm64",), OFFICIAL),
    Build("macos-x64", "macos-x64", ("macosx_11_0_x86_64",), OFFICIAL),
    # Debian's own Blender: Python 3.14 with NumPy 2.4, which SciPy 1.15 was not made for. Not for users.
    Build("linux-x64-debian-test", "linux-x64", LINUX, {"3.14": PURE | COMPILED | {"scipy": "1.18.1"}}),
)
