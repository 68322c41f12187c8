# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes by columns against volumes that are known."""

from __future__ import annotations

import numpy as np
import pytest

from femors_addon import shapes
from femors_addon.mesh import Surface
from femors_addon.overlap import overlap
from femors_addon.progress import FemorsError
from femors_addon.raster import fragments
from femors_addon.shapes import pair


def box(low, high) -> Surface:
    return shapes.box(np.subtract(high, low), 1, low=low)


def test_boxes():
    found = overlap(box((0, 0, 0), (2, 2, 2)), box((1, 1, 0), (3, 3, 2)))
    assert found.first == pytest.approx(8, rel=0.01) and found.second == pytest.approx(8, rel=0.01)
    assert found.common == pytest.approx(2, rel=0.02)
    assert found.xor == pytest.approx(12, rel=0.01)
    assert found.dice == pytest.approx(0.25, rel=0.02)


def test_one_in_the_other_and_apart():
    large, small = box((0, 0, 0), (3, 3, 3)), box((1, 1, 1), (2, 2, 2))
    assert overlap(large, small).common == pytest.approx(1, rel=0.03)
    apart = overlap(small, box((5, 5, 5), (6, 6, 6)))
    assert apart.common == 0 and apart.xor == pytest.approx(2, rel=0.03)


def test_bones_have_the_volume_that_the_divergence_theorem_gives():
    bone = pair(3000, 3000).source
    moved = bone.moved(bone.vertices + [1e6, 0, 0])
    assert overlap(bone, bone).xor < 1e-9 * bone.volume
    assert overlap(bone, bone).first == pytest.approx(bone.volume, rel=2e-3)
    far = overlap(moved, moved)  # far from the origin is no different
    assert far.first == pytest.approx(bone.volume, rel=2e-3)


def test_what_is_open_is_refused():
    whole = box((0, 0, 0), (1, 1, 1))
    with pytest.raises(FemorsError, match="second mesh is open"):
        overlap(whole, Surface(whole.vertices, whole.faces[1:]))


def test_every_grid_point_is_in_one_triangle_of_a_triangulated_square():
    corners = np.array([[[0, 0], [40, 0], [40, 30]], [[0, 0], [40, 30], [0, 30]]], dtype=float)
    seen = np.zeros(40 * 30, dtype=int)
    for cell, face, share in fragments(corners + [0.01, 0.0], 40, 30):
        seen[cell] += 1
        point = np.einsum("kc,kcd->kd", share, corners[face] + [0.01, 0.0])
        np.testing.assert_allclose(point, np.column_stack((cell % 40, cell // 40)) + 0.5, atol=1e-9)
    assert (seen == 1).all()
    assert sum(len(cell) for cell, _, _ in fragments(corners + 100.0, 40, 30)) == 0
