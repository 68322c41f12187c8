# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers along a curve: the same mesh, and neighbours near each other."""

from __future__ import annotations

import numpy as np
import pytest

from femors_addon import shapes
from femors_addon.cleaning import clean
from femors_addon.curve import along_curve, numbered, ordered
from femors_addon.mesh import Surface
from femors_addon.morph import morph
from femors_addon.morph_settings import MorphSettings


def shuffled(surface: Surface, seed: int) -> tuple[Surface, np.ndarray]:
    """The same surface in random order, and which vertex stands where."""
    random = np.random.default_rng(seed)
    order = random.permutation(len(surface.vertices))
    place = np.argsort(order)
    faces = random.permutation(place[surface.faces])
    return Surface(surface.vertices[order], faces), order


def test_the_curve_goes_through_the_octants_one_after_the_other():
    """Of a grid of 8 x 8 x 8 cells each block of 8, 64 or all 512 in turn fills a cube."""
    grid = np.stack(np.meshgrid(*[np.arange(8.0)] * 3), axis=-1).reshape(-1, 3)
    points = grid[along_curve(grid)]
    for side in (2, 4, 8):
        for block in points.reshape(-1, side**3, 3):
            assert np.ptp(block, axis=0).max() == side - 1


@pytest.mark.parametrize("place", [0.0, 1e6, -3e-9])
def test_points_at_one_place_stay_in_their_order(place):
    assert along_curve(np.full((5, 3), place)).tolist() == [0, 1, 2, 3, 4]


def test_it_is_the_same_mesh():
    bone = shapes.bone(2000)
    raw, _ = shuffled(bone, 1)
    loose = np.vstack((raw.vertices, [[0.0, 0.0, 0.0]]))  # belongs to no face
    cleaned = clean(loose, raw.faces, "bone")
    out, before = ordered(cleaned, cleaned.surface.vertices)
    assert np.array_equal(out.surface.vertices, cleaned.surface.vertices[before])
    used = out.vertex_map >= 0
    assert used.tolist() == [True] * len(raw.vertices) + [False]
    assert np.array_equal(out.surface.vertices[out.vertex_map[used]], loose[used])
    triangles = loose[raw.faces[out.face_map]]
    assert np.array_equal(out.surface.vertices[out.surface.faces], triangles)
    assert out.surface.volume == pytest.approx(bone.volume, rel=1e-12)


def test_neighbours_are_near_whatever_the_order_was():
    bone = shapes.bone(4000)
    raw, _ = shuffled(bone, 2)

    def apart(surface: Surface) -> float:
        one, two = surface.edges.T
        return float(np.median(np.abs(one - two)))

    assert apart(raw) > 1000
    assert apart(numbered(raw)) < 50
    assert np.array_equal(numbered(raw).vertices, numbered(bone).vertices)


def test_a_morph_gives_all_in_the_order_that_was_read():
    goal = shapes.sphere(3)
    ball = goal.moved(goal.vertices * [1.2, 1.0, 0.9])
    raw, order = shuffled(ball, 3)
    result = morph(raw, goal, MorphSettings(alignment="rigid"))
    assert np.abs(np.linalg.norm(result.vertices, axis=1) - 1.0).max() < 0.02
    # the field's nodes are the source's, and its faces and residual go with them
    moved = result.field.centres + result.field.displacements
    assert np.allclose(moved, result.vertices, atol=1e-12)
    assert sorted(map(sorted, result.faces.tolist())) == sorted(map(sorted, raw.faces.tolist()))
    plain = morph(ball, goal, MorphSettings(alignment="rigid"))
    away = np.linalg.norm(plain.field.centres[:, None] - result.field.centres[None], axis=2)
    same = away.argmin(axis=1)
    likeness = np.corrcoef(plain.residual, result.residual[same])[0, 1]
    assert likeness > 0.8 and abs(np.corrcoef(plain.residual, result.residual)[0, 1]) < 0.2
    assert np.allclose(np.linalg.norm(result.vertices[np.argsort(order)], axis=1), 1.0, atol=0.02)
