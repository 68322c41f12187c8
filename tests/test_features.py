# SPDX-License-Identifier: GPL-3.0-or-later
"""Feature lines: nodes on a sharp rim go to the target's rim, and of two rims to the right one."""

import numpy as np
import pytest

from femors_addon import shapes
from femors_addon.features import FeatureLines

THICK = 0.3  # of a plate with edges of 0.5 along it


@pytest.mark.parametrize("shift", [0.0, 0.6 * THICK, -0.6 * THICK])
def test_the_two_rims_of_a_thin_plate_stay_apart(shift):
    plate = shapes.box((8.0, 8.0, THICK), (16, 16, 1))
    target = plate.moved(plate.vertices + (0.0, 0.0, shift))
    nodes, points = FeatureLines.between(plate, target).onto(plate)
    here = plate.vertices[nodes]
    rim = np.isin(here[:, :2], (0.0, 8.0)).sum(axis=1) == 1  # without the corners: lines of their own
    assert rim.sum() == 2 * 4 * 15
    # shifted so far, the closest line is the other one
    np.testing.assert_allclose(points[rim], here[rim] + (0.0, 0.0, shift), atol=1e-12)


def test_no_line_is_as_good_as_one_that_faces_the_other_way():
    plate = shapes.box((8.0, 8.0, THICK), (16, 16, 1))
    deep = shapes.box((8.0, 8.0, 6.0), (16, 16, 12), low=(0.0, 0.0, 0.0))  # its upper rim is far off
    nodes, points = FeatureLines.between(plate, deep).onto(plate)
    here = plate.vertices[nodes]
    upper = (here[:, 2] > 0.5 * THICK) & (np.isin(here[:, :2], (0.0, 8.0)).sum(axis=1) == 1)
    assert not upper.any()
    assert (points[:, 2] <= THICK).all()
