# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour maps are what they claim: even to the eye, ordered by lightness, and shown by a screen."""

from __future__ import annotations

import numpy as np
import pytest

from femors_addon import colours, quantities
from femors_addon.mesh import Surface
from femors_addon.shapes import pair

MAPS = [key for key, _, _ in colours.SEQUENTIAL]


def steps(name: str) -> np.ndarray:
    return np.linalg.norm(np.diff(colours.lab(colours.table(name)), axis=0), axis=1)


@pytest.mark.parametrize("name", [*MAPS, colours.DIVERGING])
def test_equal_steps_look_equal(name):
    step = steps(name)
    step = np.delete(step, len(step) // 2) if name == colours.DIVERGING else step
    assert step.std() < 0.03 * step.mean()
    assert abs(step / step.mean() - 1).max() < 0.1


@pytest.mark.parametrize("name", MAPS)
def test_larger_is_lighter(name):
    light = colours.lab(colours.table(name))[:, 0]
    assert (np.diff(light) > 0).all()
    assert light[-1] - light[0] > 60


def test_the_signed_map_is_light_at_zero_and_as_dark_at_both_ends():
    light = colours.lab(colours.table(colours.DIVERGING))
    assert (np.diff(light[:128, 0]) > 0).all() and (np.diff(light[128:, 0]) < 0).all()
    assert abs(light[0, 0] - light[-1, 0]) < 1.0
    assert np.hypot(*light[127, 1:]) < 3 and np.hypot(*light[128, 1:]) < 3
    red, blue = colours.table(colours.DIVERGING)[[0, -1]]
    assert red[0] > 2 * red[2] and blue[2] > 2 * blue[0]


def test_lab_and_back():
    colour = np.random.default_rng(1).random((50, 3))
    np.testing.assert_allclose(colours.srgb(colours.lab(colour)), colour, atol=1e-6)
    np.testing.assert_allclose(colours.lab([[1.0, 1.0, 1.0]]), [[100, 0, 0]], atol=0.02)


def test_painting_clamps_and_takes_a_range_of_no_width():
    name = MAPS[0]
    ends = colours.table(name)[[0, -1]]
    np.testing.assert_array_equal(colours.painted([-5.0, 9.0], 0.0, 1.0, name), ends)
    np.testing.assert_array_equal(colours.painted([3.0, np.nan], 3.0, 3.0, name), ends[[0, 0]])


def test_a_signed_range_has_zero_in_its_middle():
    assert colours.span(np.linspace(-1, 30, 101), True) == pytest.approx((-1, 1))
    assert colours.span(np.linspace(1, 3, 101), True) == pytest.approx((-2, 2))
    assert colours.span(np.linspace(0, 100, 101), False) == pytest.approx((1, 99))
    low, high = colours.span(np.full(9, 2.0), False)
    assert high > low == 2.0
    assert colours.span([], False) == (0.0, 1.0)
    assert colours.span([-1e-9, 1e-9], True, least=0.01) == (-0.01, 0.01)
    assert colours.span([0.0, 1e-9], False, least=0.01)[1] == pytest.approx(0.01)


def test_the_scaled_jacobian_of_triangles():
    high = 3**0.5 / 2
    corners = [[0, 0, 0], [1, 0, 0], [0.5, high, 0], [0, 1, 0], [2, 0, 0]]
    surface = Surface(np.array(corners), np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]))
    expected = [1.0, np.sin(np.pi / 4) * 2 / 3**0.5, 0.0]
    np.testing.assert_allclose(quantities.triangle_jacobians(surface), expected, atol=1e-12)


def test_every_quantity_of_faces_can_be_had():
    surface = pair(400, 400).source
    for key, quantity in quantities.QUANTITIES.items():
        if quantity.of_faces:
            values = quantities.of_shape(key, surface)
            assert values.shape == (len(surface.faces),) and np.isfinite(values).all()


def test_a_polygon_is_as_bad_as_its_worst_triangle():
    group = np.array([0, 0, 2])
    np.testing.assert_array_equal(quantities.worst("aspect", np.array([1.0, 3.0, 2.0]), group, 3), [3, 0, 2])
    values = np.array([0.5, 0.2, 0.9])
    np.testing.assert_array_equal(quantities.worst("scaled_jacobian", values, group, 3), [0.2, 0, 0.9])
