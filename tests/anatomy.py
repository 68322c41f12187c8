# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the real bones are that do not belong to the project, and the marks of tests that need them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from femors_addon.mesh import Surface

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("FEMORS_DATA", ROOT.parent / "shared" / "data"))
PAIR, SMALL = DATA / "femur_pair", DATA / "femur_small"

needs_pair = pytest.mark.skipif(not (PAIR / "meshes.npz").exists(), reason=f"the femur pair is not at {PAIR}")
needs_small = pytest.mark.skipif(not (SMALL / "femur.stl").exists(), reason=f"no femora at {SMALL}")


def femur_pair() -> tuple[Surface, Surface]:
    """Source and target of the femur pair."""
    with np.load(PAIR / "meshes.npz") as data:
        source, target = (
            Surface(data[f"{name}_vertices"], data[f"{name}_faces"]) for name in ("source", "target")
        )
    return source, target
