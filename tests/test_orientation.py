# SPDX-License-Identifier: GPL-3.0-or-later
"""Which side of a surface is outside."""

from __future__ import annotations

import numpy as np
import pytest
from cleancases import assert_closed_and_alike, cleaned, inverted
from surfaces import together

from femors_addon.cleaning import clean
from femors_addon.mesh import Surface
from femors_addon.orientation import oriented, winding_number
from femors_addon.shapes import box, sphere


def volumes(surface: Surface, *counts: int) -> list[float]:
    """Signed volumes of consecutive runs of faces."""
    runs = np.split(surface.faces, np.cumsum(counts)[:-1])
    return [Surface(surface.vertices, run).volume for run in runs]


@pytest.mark.parametrize("share", [0.01, 0.3, 0.5, 0.99, 1.0])
def test_mixed_and_inverted_winding_is_mended(share):
    ball = sphere(2)
    wrong = np.random.default_rng(5).permutation(len(ball.faces))[: int(share * len(ball.faces))]
    result = cleaned(inverted(ball, wrong))
    assert_closed_and_alike(result.surface)
    assert result.surface.volume == pytest.approx(ball.volume)
    assert result.notes == (
        f"mesh: {len(wrong)} of {len(ball.faces)} faces were wound inward and turned for the maths",
    )


def test_each_component_is_wound_for_itself():
    parts = [sphere(1), inverted(box(low=(5, 0, 0))), inverted(sphere(1, centre=(0, 9, 0)), slice(0, 30))]
    result = cleaned(together(*parts))
    assert_closed_and_alike(result.surface)
    got = volumes(result.surface, *(len(p.faces) for p in parts))
    assert got == pytest.approx([parts[0].volume, 1.0, parts[0].volume])


@pytest.mark.parametrize("turned", range(8))
def test_nested_shells_alternate(turned):
    shells = [sphere(2, radius=3.0), sphere(2, radius=2.0), sphere(1, radius=1.0)]
    given_ = [inverted(s) if turned >> i & 1 else s for i, s in enumerate(shells)]
    beside = sphere(1, centre=(9.0, 0, 0))
    raw = together(given_[2], beside, given_[0], given_[1])  # not in the order of nesting
    result = cleaned(raw)
    got = volumes(result.surface, 80, 80, 320, 320)
    assert got == pytest.approx([shells[2].volume, beside.volume, shells[0].volume, -shells[1].volume])
    bone_only = result.surface.volume
    assert bone_only == pytest.approx(shells[2].volume + beside.volume + shells[0].volume - shells[1].volume)


def test_shells_that_touch_at_one_vertex_are_wound_apart():
    one, two = sphere(1), sphere(1)
    two = inverted(two.moved(two.vertices - two.vertices[0] + one.vertices[0] * 1.0 + 0.0))
    two = two.moved(2 * one.vertices[0] - two.vertices)  # the point reflection beyond the common vertex
    result = cleaned(together(one, two))
    assert len(result.surface.vertices) == 2 * len(one.vertices) - 1
    assert volumes(result.surface, 80, 80) == pytest.approx([one.volume, one.volume])


@pytest.mark.parametrize("turn", [False, True])
def test_an_open_shell_bulges_outward(turn):
    ball = sphere(3)
    cap = Surface(ball.vertices, ball.faces[(ball.corners[:, :, 2] > 0.3).all(axis=1)])
    shape = cleaned(inverted(cap) if turn else cap).surface
    assert np.einsum("ij,ij->i", shape.vertex_normals, shape.vertices).min() > 0.9


def test_winding_is_mended_across_a_moebius_band_without_end():
    n = 30
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    rows = []
    for side in (-0.3, 0.3):
        r = 1 + side * np.cos(angle / 2)
        rows.append(np.column_stack((r * np.cos(angle), r * np.sin(angle), side * np.sin(angle / 2))))
    low, high = np.arange(n), np.arange(n) + n
    low2, high2 = np.append(low[1:], high[0]), np.append(high[1:], low[0])
    faces = np.concatenate((np.column_stack((low, low2, high)), np.column_stack((high, low2, high2))))
    result = clean(np.concatenate(rows), faces)
    assert len(result.surface.faces) == 2 * n  # no side is the right one, but nothing is lost


def test_a_twin_face_does_not_upset_its_neighbours():
    # a pillow: two faces with all three edges in common, wound as a closed surface should be
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [6, 0, 0], [5, 1, 0], [5, 0, 1]]
    tetrahedron = [[3, 5, 4], [3, 4, 6], [4, 5, 6], [5, 6, 3]]  # the last one the wrong way round
    surface, turned = oriented(Surface(points, [[0, 1, 2], [2, 1, 0], *tetrahedron]))
    assert turned == 1
    assert surface.faces[:2].tolist() == [[0, 1, 2], [2, 1, 0]]


def test_oriented_counts_what_it_turned():
    ball = sphere(1)
    same, none = oriented(ball)
    assert same is ball
    assert none == 0
    back, count = oriented(inverted(ball, slice(0, 7)))
    assert count == 7
    assert back.face_normals == pytest.approx(ball.face_normals, abs=1e-12)


def test_many_components_of_mixed_winding_are_mended():
    cubes = [box(low=(2 * i, 2 * j, 0), cells=1) for i in range(50) for j in range(50)]
    raw = together(*cubes)
    wrong = np.random.default_rng(0).random(len(raw.faces)) < 0.1
    result = cleaned(inverted(raw, wrong))
    assert_closed_and_alike(result.surface)
    assert result.surface.volume == pytest.approx(2500.0)


@pytest.mark.parametrize(("turn", "inside"), [(False, 1.0), (True, -1.0)])
def test_winding_number_counts_shells(turn, inside):
    ball = sphere(2)
    corners = (inverted(ball) if turn else ball).corners
    points = np.array([[0, 0, 0], [0.5, 0.5, 0.5], [0.99, 0, 0], [1.01, 0, 0], [30, 1, 2]])
    assert winding_number(corners, points) == pytest.approx([inside] * 2 + [inside, 0, 0], abs=1e-9)
    # one side of a cube, seen from its middle, is a sixth of all there is to see
    block = box(low=(-0.5, -0.5, -0.5), cells=2)
    top = block.corners[(block.corners[:, :, 2] > 0.4).all(axis=1)]
    assert winding_number(top, np.zeros((1, 3))) == pytest.approx([1 / 6])
