# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaps and bodies that are refused, for they are in another unit than the rest."""

from __future__ import annotations

import numpy as np
import pytest

from femors_addon.bodies import Body
from femors_addon.overclosure import check_overclosure, remove_overclosure
from femors_addon.overclosure_settings import OverclosureSettings
from femors_addon.progress import FemorsError
from femors_addon.shapes import box


def bodies(cells: int = 40, share: float = 1.0) -> list[Body]:
    """A plate of 2 mm, as thick as a cartilage, half a millimetre deep in a block."""
    plate, block = box((40.0, 40.0, 2.0), (cells, cells, 1)), box((60.0, 60.0, 30.0), 12)
    low = plate.moved(plate.vertices + (10.0, 10.0, 29.5))
    return [Body("plate", low, share), Body("block", block, 1.0 - share)]


def rod() -> list[Body]:
    """A thin but long body above a block: its thickness says nothing of the unit."""
    thin, block = box((200.0, 2.0, 2.0), (200, 2, 2)), box((60.0, 60.0, 30.0), 12)
    return [Body("rod", thin.moved(thin.vertices + (-70.0, 30.0, 29.5)), 1.0), Body("block", block, 0.0)]


def test_a_gap_of_more_than_its_thickness_is_refused_for_a_thin_body():
    with pytest.raises(FemorsError, match=r"is 4\.\d times the thickness of 'plate', which would"):
        remove_overclosure(bodies(), OverclosureSettings(gap=8.0))


@pytest.mark.parametrize(
    ("given", "gap"),
    [(bodies(), 2.5), (bodies(share=0.0), 8.0), (bodies(cells=4), 8.0), (rod(), 4.0)],
    ids=["as thick as it", "another moves", "a coarse mesh", "a thin but large body"],
)
def test_other_gaps_are_taken(given, gap):
    remove_overclosure(given, OverclosureSettings(gap=gap, iterations=1))


@pytest.mark.parametrize("factor", [1e-3, 1e3, 1e-2])
def test_bodies_in_two_units_are_refused(factor):
    """Nothing would be found of them; also where the origin is far from both."""
    for shift in (0.0, 300.0):
        plate, block = (body.mesh.moved(body.mesh.vertices + shift) for body in bodies())
        given = [Body("plate", plate.moved(factor * plate.vertices)), Body("block", block)]
        for job in (check_overclosure, remove_overclosure):
            times = rf"would lie beside it, were it {max(factor, 1 / factor):g} times larger"
            with pytest.raises(FemorsError, match=times):
                job(given)


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (30.0, 30.0, 200.0), (30.0, 30.0, 0.0)])
def test_a_small_body_in_the_same_unit_is_left_alone(origin):
    """A bead or a pin, wherever the coordinates begin: at a corner, in the middle, at an end."""
    bone = box((60.0, 60.0, 400.0), (12, 12, 40))
    bone = bone.moved(bone.vertices - np.array(origin))
    rng = np.random.default_rng(0)
    places = [*rng.uniform(-6.0, 6.0, (12, 3)), *rng.uniform(*bone.bounds, (8, 3)), (500.0, 0.0, 0.0)]
    for place in places:
        bead = box((1.0, 1.0, 1.0), 4)
        check_overclosure([Body("bead", bead.moved(bead.vertices + place)), Body("bone", bone)])
