# SPDX-License-Identifier: GPL-3.0-or-later
"""Alignment: left and right, metres and millimetres, and what is said of them."""

from __future__ import annotations

import re

import numpy as np
import pytest
from aligncases import mirrored, off, placed, pose, subjects
from scipy.spatial.transform import Rotation
from surfaces import cut

from femors_addon import shapes
from femors_addon.align import align
from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.progress import FemorsError
from femors_addon.transforms import homogeneous, transformed
from femors_addon.units import size_ratio, unit_factor


@pytest.fixture(scope="module")
def pair():
    """Two subjects."""
    return subjects()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_mirrored_source_is_told_and_mirrored_where_wished(pair, seed):
    other_side = placed(pose(seed), mirrored(pair.source))
    told = align(other_side, pair.target, "affine")
    assert np.linalg.det(told.matrix[:3, :3]) > 0
    assert len(told.warnings) == 1
    assert "mirror image fits the target better" in told.warnings[0]
    assert "tick Mirror" in told.warnings[0]
    done = align(other_side, pair.target, "affine", fix_mirror=True)
    assert np.linalg.det(done.matrix[:3, :3]) < 0
    assert "it was mirrored" in done.warnings[0]
    assert off(done.matrix, other_side.vertices, pair.truth, pair.target.diagonal) < 0.012
    assert done.residual < 0.5 * told.residual


def pebble(seed: int, swelling: float) -> Surface:
    """An ellipsoid, swollen beside all of its planes of symmetry, by other nodes with each seed."""
    ball = shapes.sphere(4)
    unit = Rotation.random(random_state=seed).apply(
        ball.vertices / np.linalg.norm(ball.vertices, axis=1)[:, None]
    )
    away = unit - np.array([1.0, 0.8, 0.7]) / np.linalg.norm([1.0, 0.8, 0.7])
    height = 1.0 + swelling * np.exp(-np.sum(away**2, axis=1) / 0.3)
    return Surface(unit * [10.0, 7.0, 5.0] * height[:, None], ball.faces)


@pytest.mark.parametrize("swelling", [0.1, 0.12])
def test_what_is_nearly_its_own_mirror_image_is_told_apart_by_its_surface(swelling):
    """Samples are farther from the nearest node than the surfaces are from each other, by either hand."""
    source, target = pebble(1, swelling), pebble(2, swelling)
    assert align(placed(pose(3), source), target, "affine", fix_mirror=True).warnings == ()
    other_side = placed(pose(3), mirrored(source))
    (told,) = align(other_side, target, "affine").warnings
    assert "mirror image fits the target better by" in told
    done = align(other_side, target, "affine", fix_mirror=True)
    assert np.linalg.det(done.matrix[:3, :3]) < 0
    moved = Surface(transformed(done.matrix, other_side.vertices), mirrored(other_side).faces)
    assert (
        SurfaceIndex(target).closest(moved.vertices).distance.max() < 0.05
    )  # of 20, and 0.2 by the other hand


def test_no_mirror_is_seen_where_there_is_none(pair):
    for source in (pair.source, shapes.sphere(3), shapes.box((1, 2, 3), 4)):
        target = pair.target if source is pair.source else source
        result = align(source, target, "affine", fix_mirror=True)
        assert result.warnings == ()
        assert np.linalg.det(result.matrix[:3, :3]) > 0


@pytest.mark.parametrize("factor", [10.0, 25.4, 100.0, 304.8, 1000.0])
@pytest.mark.parametrize("up", [True, False])
def test_another_unit_is_told_and_applied_where_wished(pair, factor, up):
    factor = factor if up else 1.0 / factor
    foreign = placed(homogeneous(np.eye(3) / factor, np.zeros(3)), pair.source)
    assert unit_factor(foreign, pair.target) == pytest.approx(factor)
    told = align(foreign, pair.target, "none")
    assert np.array_equal(told.matrix, np.eye(4))
    assert f"{factor:g} times its size" in told.warnings[0]
    assert "tick Convert units" in told.warnings[0]
    converted = align(foreign, pair.target, "none", fix_units=True)
    assert converted.matrix == pytest.approx(np.diag([factor, factor, factor, 1.0]))
    assert "was applied" in converted.warnings[0]


@pytest.mark.parametrize("kind", ["rigid", "affine"])
def test_millimetres_and_metres_end_at_one_place(pair, kind):
    plain = align(pair.source, pair.target, kind)
    size = pair.target.diagonal
    metres = placed(homogeneous(np.eye(3) / 1000, np.zeros(3)), pair.source)
    result = align(metres, pair.target, kind, fix_units=True)
    there = transformed(plain.matrix, pair.source.vertices)
    assert off(result.matrix, metres.vertices, there, size) < 1e-6
    # a rigid alignment that is not told to convert keeps the lengths that it is given
    if kind == "rigid":
        unchanged = align(metres, pair.target, kind).matrix[:3, :3]
        assert np.linalg.det(unchanged) == pytest.approx(1.0)


def test_sizes_as_people_have_them_are_no_other_unit(pair):
    for factor in (0.5, 0.8, 1.0, 1.5, 2.0):
        assert (
            unit_factor(placed(homogeneous(np.eye(3) * factor, np.zeros(3)), pair.source), pair.target)
            is None
        )


@pytest.mark.parametrize("ratio", [5.0, 6.0, 17.0, 1 / 5.5])
def test_merely_different_sizes_are_told_as_such(pair, ratio):
    other = placed(homogeneous(np.eye(3) / ratio, np.zeros(3)), pair.source)
    assert unit_factor(other, pair.target) is None
    for kind in ("none", "affine"):
        (said,) = align(other, pair.target, kind).warnings
        times = size_ratio(other, pair.target)
        words = f"{times:.4g} times larger" if ratio > 1 else f"{1 / times:.4g} times smaller"
        assert said == f"the target is {words} than the source"


@pytest.mark.parametrize("up", [True, False])
@pytest.mark.parametrize(
    ("ratio", "factor"),
    [(600.0, 1000.0), (450.0, 1000.0), (50.0, 100.0), (1.1e6, 1e6), (0.9e9, 1e9), (7.5, 10.0)],
)
def test_sizes_that_no_anatomy_has_are_another_unit(pair, ratio, factor, up):
    """An adult's bone in metres beside a child's in millimetres, of 0.6 and of 0.45 of its size."""
    if not up:
        ratio, factor = 1.0 / ratio, 1.0 / factor
    own = size_ratio(pair.source, pair.target)
    other = placed(homogeneous(np.eye(3) * own / ratio, np.zeros(3)), pair.source)
    assert unit_factor(other, pair.target) == pytest.approx(factor)


@pytest.mark.parametrize("ratio", [33.0, 1 / 33.0, 1e12])
def test_sizes_that_no_two_units_have_are_refused_with_their_ratio(pair, ratio):
    own = size_ratio(pair.source, pair.target)
    other = placed(homogeneous(np.eye(3) * own / ratio, np.zeros(3)), pair.source)
    words = "1e+12 times larger" if ratio > 1e3 else "33 times larger" if ratio > 1 else "33 times smaller"
    for fix in (False, True):
        with pytest.raises(FemorsError, match=re.escape(f"the target is {words}") + ".*: scale one of them"):
            align(other, pair.target, "none", fix_units=fix)


@pytest.mark.parametrize("times", [1e3, 1e6, 1e9])
def test_a_part_in_another_unit_is_told(pair, times):
    piece, _ = cut(pair.source, -99, 150)
    other = placed(homogeneous(np.eye(3) / times, np.zeros(3)), piece)
    assert unit_factor(other, pair.target, "source") == times
    assert unit_factor(pair.target, other, "target") == 1.0 / times
