# SPDX-License-Identifier: GPL-3.0-or-later
"""Signed distances of one body to another against brute force; rows of three against NumPy's reductions."""

from __future__ import annotations

import numpy as np
import pytest

from femors_addon import triples
from femors_addon.bodies import Body, Solid
from femors_addon.distances import DEEPER, Target, distances
from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.shapes import box, sphere


def lumpy(random: np.random.Generator, halvings: int, radius: float, centre) -> Surface:
    ball = sphere(halvings)
    wave = 1.0 + 0.25 * np.sin(ball.vertices @ random.normal(size=3) * 2.0)
    return ball.moved(ball.vertices * wave[:, None] * radius * random.uniform(0.5, 1.5, 3) + centre)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("exact", [False, True])
def test_distances_equal_brute_force_where_they_matter(seed, exact):
    random = np.random.default_rng(seed)
    one = lumpy(random, random.integers(2, 4), random.uniform(1, 8), random.normal(size=3) * 4.0)
    other = Solid(Body("other", lumpy(random, random.integers(2, 5), 10.0, 0.0)), 0.5)
    reach = random.choice([0.1, 0.5, 2.0])
    true = SurfaceIndex(other.surface).signed(one.vertices)
    found = distances(one, Target(other), reach, exact)
    assert (found.bound <= true + 1e-9).all()
    assert (found.apart <= np.abs(true) + 1e-9).all()
    here = true[found.rows]
    assert (np.delete(true, found.rows) > reach).all()
    np.testing.assert_array_equal(found.signed < 0, here < 0)
    near = np.abs(here) < reach
    assert found.signed[near] == pytest.approx(here[near], abs=1e-9)
    assert (found.signed[here >= reach] >= reach).all()
    deepest = -here.min(initial=0.0)
    assert deepest * (1.0 - DEEPER) - 1e-9 <= -found.signed.min(initial=0.0) <= deepest + 1e-9
    if exact:
        assert found.signed[here < 0] == pytest.approx(here[here < 0], abs=1e-9)


def test_a_body_at_the_centre_of_a_ball_is_measured_at_few_nodes(monkeypatch):
    asked, closest = [], SurfaceIndex.closest
    monkeypatch.setattr(
        SurfaceIndex,
        "closest",
        lambda self, points, *a: asked.append(len(points)) or closest(self, points, *a),
    )
    small, ball = (
        box((1.0, 1.0, 1.0), 10, low=(-0.5, -0.5, -0.5)),
        Solid(Body("ball", sphere(4, radius=30.0)), 0.5),
    )
    found = distances(small, Target(ball), 0.5)
    assert len(found.rows) == len(small.vertices)
    assert (found.signed < 0).all()
    assert found.signed.min() == pytest.approx(-29.5, rel=2e-3)
    assert sum(asked) < 0.5 * len(small.vertices)


def test_rows_of_three_have_the_bits_of_numpys_reductions():
    random = np.random.default_rng(0)
    points, mask = random.normal(size=(500, 3)), random.random((500, 3)) < 0.5
    corners = random.normal(size=(200, 3, 3))
    np.testing.assert_array_equal(triples.every(mask), mask.all(axis=1))
    np.testing.assert_array_equal(triples.some(mask), mask.any(axis=1))
    np.testing.assert_array_equal(triples.least(corners), corners.min(axis=1))
    np.testing.assert_array_equal(triples.greatest(corners), corners.max(axis=1))
    np.testing.assert_array_equal(triples.length(points), np.linalg.norm(points, axis=1))
    np.testing.assert_array_equal(triples.box(points), (points.min(axis=0), points.max(axis=0)))
    sides = [((corners[:, i] - corners[:, i - 1]) ** 2).sum(axis=1) for i in range(3)]
    np.testing.assert_array_equal(triples.longest_squared(corners), np.max(sides, axis=0))
    faces = random.integers(0, 90, (40, 3))
    which, local = triples.renumbered(faces, 100)
    unique, inverse = np.unique(faces, return_inverse=True)
    np.testing.assert_array_equal(which, unique)
    np.testing.assert_array_equal(local, inverse.reshape(-1, 3))


def test_rows_are_told_to_be_unique():
    rng = np.random.default_rng(3)
    rows = rng.integers(0, 200, (20_000, 3))
    rows = rows[triples.unique_rows(rows)[0]]
    assert triples.are_unique(rows)
    assert triples.are_unique(rows[:, ::-1] * 1e-3)
    assert triples.are_unique(rows[:1])
    assert triples.are_unique(rows[:0])
    for i, j in ((0, 1), (5, 17_000), (17_000, 3)):
        twice = rows.copy()
        twice[i] = twice[j]
        assert not triples.are_unique(twice)
    assert not triples.are_unique(np.array([[0.0, 1.0, 2.0], [-0.0, 1.0, 2.0]]))  # one place
