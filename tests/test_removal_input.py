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


def test_a_gap_of_more_than_its_thickness_is_refused_for_a_thin_body():
    with pytest.raises(FemorsError, match=r"is 4\.\d times the thickness of 'plate', which would"):
        remove_overclosure(bodies(), OverclosureSettings(gap=8.0))


@pytest.mark.parametrize(
    ("given", "gap"),
    [(bodies(), 2.5), (bodies(share=0.0), 8.0), (bodies(cells=4), 8.0)],
    ids=["as thick as it", "another moves", "a coarse mesh"],
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
            with pytest.raises(FemorsError, match=r"would lie beside it, were it .* give both in one unit"):
                job(given)


def test_a_small_body_in_the_same_unit_is_left_alone():
    plate, block = (body.mesh for body in bodies())
    for place in ((30.0, 30.0, 30.2), (0.1, 0.1, 30.2), (400.0, 0.0, 0.0)):
        pin = plate.moved(0.004 * plate.vertices + np.array(place))
        check_overclosure([Body("pin", pin), Body("block", block)])
