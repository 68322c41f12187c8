# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether landmarks are in the unit of the field that carries them."""

from __future__ import annotations

import numpy as np
import pytest
from fieldcases import BONE, CARRIER, TARGET

from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.progress import FemorsError
from femors_addon.transfer import Transfer
from femors_addon.transfer_settings import TransferSettings
from femors_addon.transfer_units import UNITS, FieldUnit

ON_IT = BONE.moved(BONE.vertices - BONE.vertices[10])  # the origin lies on it, so all in metres does too
FACTORS = [one for unit in UNITS for one in (unit, 1.0 / unit)]


@pytest.fixture(scope="module")
def unit() -> FieldUnit:
    return FieldUnit(SurfaceIndex(ON_IT), "source of the field 'f'")


def drawn(rng: np.random.Generator, count: int) -> np.ndarray:
    return ON_IT.vertices[rng.choice(len(ON_IT.vertices), count, replace=False)]


@pytest.mark.parametrize("factor", FACTORS)
def test_landmarks_in_another_unit_are_told_with_it(unit, factor):
    rng = np.random.default_rng(1)
    for count in (5, 8, 20):
        marks = drawn(rng, count) + rng.normal(size=(count, 3)) * 1e-3 * ON_IT.diagonal
        (fault,) = unit.of_landmarks(factor * marks)
        by = f"{round(max(factor, 1.0 / factor), 6):g} times {'smaller' if factor > 1 else 'larger'}"
        assert f"the source of the field 'f', were they {by}" in fault


def test_nothing_is_said_of_landmarks_in_its_unit_wherever_they_are(unit):
    """On the bone, beside it, inside it (centres of joints), in a corner of it, on a line, far away."""
    rng = np.random.default_rng(2)
    low, high = ON_IT.bounds
    for _ in range(100):
        for count in (1, 2, 3, 5, 12):
            assert unit.of_landmarks(drawn(rng, count)) == []
            assert unit.of_landmarks(rng.uniform(low, high, (count, 3))) == []
            near = drawn(rng, 1) + rng.normal(size=(count, 3)) * 0.02 * ON_IT.diagonal
            assert unit.of_landmarks(near) == []
            line = drawn(rng, 1) + np.linspace(0.0, 1.0, count)[:, None] * (drawn(rng, 1) - low)
            assert unit.of_landmarks(line) == []
            assert unit.of_landmarks(near + 10.0 * (high - low)) == []


@pytest.mark.parametrize("factor", [1.0, 1000.0, 0.1])
def test_landmarks_in_other_axes_are_told(unit, factor):
    """Four and more: three might lie on the bone by chance, turned as they are."""
    turn = factor * np.array((-1.0, -1.0, 1.0))
    marks = drawn(np.random.default_rng(3), 6)
    (fault,) = unit.of_landmarks(turn * marks)
    also = "" if factor == 1.0 else f" and they {1.0 / factor:g} times as large"
    assert f"x and y of the other sign{also}: probably in other axes (LPS, RAS)" in fault
    if factor == 1.0:
        assert len(unit.of_landmarks(turn * marks[:4])) == 1 and not unit.of_landmarks(turn * marks[:3])


@pytest.mark.parametrize("factor", [0.001, 1000.0])
def test_a_surface_to_project_onto_is_in_the_unit_of_the_field(factor):
    with pytest.raises(FemorsError, match=r"the surface to project onto is 1000 times .*in another unit"):
        Transfer(CARRIER, TransferSettings(), TARGET.moved(factor * TARGET.vertices))
    part = TARGET.faces[(TARGET.vertices[TARGET.faces][:, :, 2] > np.median(TARGET.vertices[:, 2])).all(1)]
    Transfer(CARRIER, TransferSettings(), Surface(TARGET.vertices, part))
    far = TARGET.moved(TARGET.vertices + 60.0 * TARGET.diagonal)  # a bone of a whole skeleton
    both = np.vstack((TARGET.vertices, far.vertices))
    faces = np.vstack((TARGET.faces, TARGET.faces + len(TARGET.vertices)))
    Transfer(CARRIER, TransferSettings(), Surface(both, faces))


def test_three_landmarks_tell_their_unit_and_two_do_not(unit):
    marks = 0.001 * ON_IT.vertices[[10, 400, 900]]
    assert len(unit.of_landmarks(marks)) == len(unit.small(marks + 0.3 * ON_IT.diagonal)) == 1
    assert unit.of_landmarks(marks[1:]) == unit.small(marks[1:] + 0.3 * ON_IT.diagonal) == []


def test_nothing_is_said_without_a_surface_or_a_span(unit):
    assert FieldUnit(None, "source").of_landmarks(0.001 * ON_IT.vertices[:9]) == []
    assert unit.of_landmarks(np.tile(ON_IT.vertices[0] + 3.0 * ON_IT.diagonal, (5, 1))) == []
    assert unit.of_landmarks(np.empty((0, 3))) == []
