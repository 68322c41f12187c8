# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases of overclosure from the decks of one knee, which stay in ../shared/data."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np

from femors_addon import deckfiles
from femors_addon.bodies import Body

DATA = Path(os.environ.get("FEMORS_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")) / "knee"
PATELLA_ON_FEMUR = np.array([-10.401, 74.499, -41.976])
CARTILAGE_ON_CARTILAGE = np.array([-9.702, 71.403, -46.832])
KNEE = np.array([-9.702, 71.903, -46.832])


@dataclasses.dataclass(frozen=True)
class Case:
    """Two bodies (or the whole knee), how far they are pressed in, and what the removal may cost.

    Attributes
    ----------
    seconds : float
        CPU time allowed, of one core.
    xor : float or None
        Largest change of the body named `judged`, as a share of its volume.
    """

    kind: str
    depth: float
    seconds: float
    xor: float | None
    judged: str

    @property
    def name(self) -> str:
        """For tables and test names."""
        return f"{self.kind}, {self.depth:g} mm" if self.depth else self.kind

    def bodies(self) -> list[Body]:
        """Read the decks and press them together."""
        return BODIES[self.kind](self.depth)


def mesh(deck: str, by=(0.0, 0.0, 0.0), part: str | None = None):
    """A deck's mesh, or a part's, shifted."""
    read = deckfiles.read_deck(DATA / f"{deck}.inp")
    found = read.mesh if part is None else read.submesh(read.part(part))[0]
    return found.moved(found.nodes + np.array(by))


def _patella_femur(depth: float) -> list[Body]:
    by = PATELLA_ON_FEMUR + [0, depth, 0]
    return [Body("patella", mesh("bone_patella", by)), Body("femur", mesh("bone_femur"))]


def _tibial_femoral(depth: float) -> list[Body]:
    tibial = mesh("cartilage_tibia_tet", (0, 0, depth - 0.023), "CART-TIBIA-LAT")
    return [Body("tibial", tibial), Body("femoral", mesh("cartilage_femur_tet"))]


def _patellar_femoral(depth: float) -> list[Body]:
    patellar = mesh("cartilage_patella_hex", CARTILAGE_ON_CARTILAGE + [0, depth, 0])
    return [Body("patellar", patellar), Body("femoral", mesh("cartilage_femur_hex"))]


def _patella_own(depth: float) -> list[Body]:
    return [Body("patella", mesh("bone_patella"), 0.0), Body("cartilage", mesh("cartilage_patella_hex"))]


def _femur_own(depth: float) -> list[Body]:
    return [Body("femur", mesh("bone_femur"), 0.0), Body("cartilage", mesh("cartilage_femur_hex"))]


def _knee(depth: float) -> list[Body]:
    up = (0, 0, 0.3)
    return [
        Body("femur", mesh("bone_femur"), 0.0),
        Body("patella", mesh("bone_patella", KNEE), 0.0),
        Body("tibia", mesh("bone_tibia_fibula"), 0.0),
        Body("femoral", mesh("cartilage_femur_hex")),
        Body("patellar", mesh("cartilage_patella_hex", KNEE)),
        Body("tibial lateral", mesh("cartilage_tibia_tet", up, "CART-TIBIA-LAT")),
        Body("tibial medial", mesh("cartilage_tibia_tet", up, "CART-TIBIA-MED")),
    ]


BODIES = {
    "patella on femur": _patella_femur,
    "tibial on femoral cartilage (tet)": _tibial_femoral,
    "patellar on femoral cartilage (hex)": _patellar_femoral,
    "patella rigid against its cartilage": _patella_own,
    "femur rigid against its cartilage": _femur_own,
    "whole knee": _knee,
}
CASES = [
    Case("patella on femur", 0.01, 1, 0.0001, "patella"),
    Case("patella on femur", 0.1, 1, 0.0001, "patella"),
    Case("patella on femur", 1.0, 1.5, 0.001, "patella"),
    Case("patella on femur", 5.0, 3, 0.045, "patella"),
    Case("tibial on femoral cartilage (tet)", 0.1, 1, 0.002, "tibial"),
    Case("tibial on femoral cartilage (tet)", 1.0, 1, 0.065, "tibial"),
    Case("tibial on femoral cartilage (tet)", 5.0, 6, 0.5, "tibial"),
    Case("patellar on femoral cartilage (hex)", 0.1, 1, 0.0005, "patellar"),
    Case("patellar on femoral cartilage (hex)", 1.0, 1, 0.007, "patellar"),
    Case("patellar on femoral cartilage (hex)", 5.0, 7, 0.11, "patellar"),
    Case("patella rigid against its cartilage", 0.0, 3, 0.116, "cartilage"),
    Case("femur rigid against its cartilage", 0.0, 14, 0.605, "cartilage"),
    Case("whole knee", 0.0, 15, None, ""),
]
"""What the project set out to reach; the femur's cartilage may change by twice its shared volume."""
