# SPDX-License-Identifier: GPL-3.0-or-later
"""Alignment by landmarks."""

from __future__ import annotations

import numpy as np
import pytest
from aligncases import SHEAR, off, placed, pose, subjects
from scipy.spatial.transform import Rotation

from femors_addon import shapes
from femors_addon.align import align
from femors_addon.progress import FemorsError
from femors_addon.transforms import homogeneous, landmark_transform, transformed


@pytest.fixture(scope="module")
def pair():
    """Two subjects."""
    return subjects()


@pytest.mark.parametrize("kind", ["rigid", "similarity", "affine"])
def test_landmarks_give_the_known_transform(kind):
    rng = np.random.default_rng(0)
    points = rng.normal(size=(6, 3)) * 50
    linear = {"rigid": np.eye(3), "similarity": 2.5 * np.eye(3), "affine": SHEAR}[kind]
    known = pose(4) @ homogeneous(linear, (1.0, 2.0, 3.0))
    assert landmark_transform(points, transformed(known, points), kind) == pytest.approx(known, abs=1e-9)


def test_landmarks_are_fitted_by_least_squares():
    """No nearby rigid transform or similarity does better; a mirrored set is not mirrored back."""
    rng = np.random.default_rng(1)
    points, goals = rng.normal(size=(2, 7, 3))
    for kind in ("rigid", "similarity"):
        for goal in (goals, points * (-1, 1, 1)):
            found = landmark_transform(points, goal, kind)
            assert np.linalg.det(found[:3, :3]) > 0
            least = np.sum((transformed(found, points) - goal) ** 2)
            for _ in range(50):
                growth = 1.0 + (kind == "similarity") * rng.normal() * 1e-2
                nudge = homogeneous(
                    growth * Rotation.from_rotvec(rng.normal(size=3) * 1e-2).as_matrix(),
                    rng.normal(size=3) * 1e-2,
                )
                assert np.sum((transformed(nudge @ found, points) - goal) ** 2) >= least


def test_three_landmarks_do_and_four_in_a_plane_are_no_affine_map():
    rng = np.random.default_rng(2)
    for points in (rng.normal(size=(3, 3)), rng.normal(size=(6, 3)) * (1, 1, 0)):
        known = homogeneous(1.5 * pose(5)[:3, :3], (1.0, 1.0, 1.0))
        for kind in ("similarity", "affine"):
            found = landmark_transform(points, transformed(known, points), kind)
            assert transformed(found, points) == pytest.approx(transformed(known, points), abs=1e-9)
            assert np.linalg.det(found[:3, :3]) == pytest.approx(1.5**3)


@pytest.mark.parametrize(
    ("source", "target", "words"),
    [
        (np.eye(3)[:2], np.eye(3)[:2], "at least 3 .* not 2"),
        (np.empty((0, 3)), np.empty((0, 3)), "at least 3"),
        (np.eye(3), np.ones((4, 3)), "source has 3, target has 4"),
        (np.outer(np.arange(5), (1.0, 2.0, 3.0)), np.ones((5, 3)), "on one line"),
        (np.ones((3, 3)), np.eye(3), "source's landmarks lie on one line"),
        (np.eye(3), np.outer(np.arange(3), (1.0, 2.0, 3.0)), "on one line"),
        (np.eye(3), np.ones((3, 3)), "target's landmarks lie on one line"),
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], np.eye(3), "not finite"),
        (np.eye(3), [[0, 0, 0], [1, 0, 0], [0, np.inf, 0]], "not finite"),
    ],
)
def test_landmarks_that_fix_nothing_are_told(source, target, words):
    with pytest.raises(FemorsError, match=words) as error:
        landmark_transform(source, target)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("partial", ["none", "source", "target"])
def test_landmarks_start_the_alignment(pair, partial):
    """Roughly placed, they lead to where the search over poses ends; no mirror is looked for."""
    at = [10, 200, 400, 600, 800]
    rough = pair.truth[at] + np.random.default_rng(0).normal(size=(5, 3)) * 3.0
    start = pose(3)
    marks = (transformed(start, pair.source.vertices[at]), rough)
    result = align(placed(start, pair.source), pair.target, "affine", partial=partial, landmarks=marks)
    assert off(result.matrix @ start, pair.source.vertices, pair.truth, pair.target.diagonal) < 0.02
    if partial == "none":
        plain = align(pair.source, pair.target, "affine")
        there = transformed(plain.matrix, pair.source.vertices)
        assert off(result.matrix @ start, pair.source.vertices, there, pair.target.diagonal) < 1e-3


def test_landmarks_outrule_the_search():
    """A ball has no pose of its own: the landmarks decide it."""
    ball = shapes.sphere(3)
    turn = pose(6)
    marks = (ball.vertices[:5], transformed(turn, ball.vertices[:5]))
    result = align(ball, placed(turn, ball), "rigid", landmarks=marks)
    assert result.matrix == pytest.approx(turn, abs=1e-6)
