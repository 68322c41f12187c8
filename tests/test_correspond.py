# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement vectors: they point at the target, both ways, and only where the surfaces face alike."""

from __future__ import annotations

import numpy as np
import pytest
from surfaces import cut

from femors_addon import shapes
from femors_addon.correspond import (
    LONGEST,
    Target,
    at_border,
    by_nearest,
    by_surface,
    interpolated_normals,
    shortened,
)
from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex


def target_of(surface: Surface) -> Target:
    return Target.of(SurfaceIndex(surface), surface)


BALL, LARGER = shapes.sphere(3), shapes.sphere(3, radius=1.2)


# --- by surface ---------------------------------------------------------------------------------
def test_vectors_go_both_ways_and_end_on_the_other_surface():
    vectors = by_surface(BALL, target_of(LARGER), "none")
    n = len(BALL.vertices)
    assert len(vectors.centres) == 2 * n
    ends = vectors.centres + vectors.displacements
    assert vectors.centres[:n] == pytest.approx(BALL.vertices)
    assert SurfaceIndex(LARGER).closest(ends[:n]).distance.max() < 1e-12
    # from the target's nodes: the centre lies on the source, the end is the node
    assert SurfaceIndex(BALL).closest(vectors.centres[n:]).distance.max() < 1e-12
    assert ends[n:] == pytest.approx(LARGER.vertices)
    assert vectors.rms == pytest.approx(0.2, rel=0.03)


def test_only_the_partial_mesh_asks():
    n = len(BALL.vertices)
    from_source = by_surface(BALL, target_of(LARGER), "source")
    assert from_source.centres == pytest.approx(BALL.vertices)
    from_target = by_surface(BALL, target_of(LARGER), "target")
    assert (from_target.centres + from_target.displacements) == pytest.approx(LARGER.vertices)
    assert len(from_source.centres) == len(from_target.centres) == n


def test_surfaces_that_face_away_are_no_partners():
    """A shell turned inside out; and the near side of a thin plate is not its far side's partner."""
    inward = Surface(LARGER.vertices, LARGER.faces[:, ::-1])
    assert len(by_surface(BALL, target_of(inward), "none").centres) == 0
    assert by_surface(BALL, target_of(inward), "none").rms == 0.0
    plate = shapes.box((10, 10, 0.2), (20, 20, 1))
    lifted = plate.moved(plate.vertices + (0, 0, 0.15))  # the top of the one is near the bottom of the other
    vectors = by_surface(plate, target_of(lifted), "none")
    inner = (np.abs(vectors.centres[:, :2] - 5.0) < 4.0).all(axis=1)
    assert inner.sum() > 400
    assert vectors.displacements[inner] == pytest.approx(np.tile((0, 0, 0.15), (inner.sum(), 1)), abs=1e-9)


def test_what_lies_beyond_a_border_has_no_partner():
    """A whole ball on half of another: the missing half does not pull the rest to its rim."""
    cap, _ = cut(LARGER, 0.0, np.inf)
    vectors = by_surface(BALL, target_of(cap), "none")
    assert vectors.centres[:, 2].min() > -0.25
    found = SurfaceIndex(cap).closest([[0, 0, -3.0], [0, 0, 3.0], [1.2, 0, -0.5]])
    assert at_border(cap, found.face, found.barycentric).tolist() == [True, False, True]
    closed = SurfaceIndex(LARGER).closest([[0, 0, -3.0]])
    assert not at_border(LARGER, closed.face, closed.barycentric).any()


def test_interpolated_normals_of_a_ball_are_radial():
    found = SurfaceIndex(BALL).closest(np.random.default_rng(0).normal(size=(200, 3)))
    normals = interpolated_normals(BALL, found.face, found.barycentric)
    assert np.einsum("ij,ij->i", normals, found.point).min() > 0.97


# --- by nearest nodes ---------------------------------------------------------------------------
def test_nearest_pairs_are_brute_force_in_six_dimensions():
    """The training set of the paper: target nodes with their vectors, then source nodes with theirs."""
    one, two = shapes.sphere(1), shapes.box((1.5, 1.5, 1.5), 3, low=(-0.7, -0.7, -0.7))
    for weight in (0.0, 0.3, 50.0):
        ours = np.hstack((one.vertices, weight * one.vertex_normals))
        theirs = np.hstack((two.vertices, weight * two.vertex_normals))
        apart = np.linalg.norm(ours[:, None] - theirs[None], axis=2)
        vectors = by_nearest(one, two, weight, "none")
        m = len(two.vertices)
        assert np.array_equal(vectors.centres[:m], two.vertices)
        assert np.array_equal(vectors.centres[m:], one.vertices)
        partner = two.vertices - vectors.displacements[:m]
        chosen = np.linalg.norm(partner[:, None] - one.vertices[None], axis=2).argmin(axis=1)
        assert apart[chosen, np.arange(m)] == pytest.approx(apart.min(axis=0))
        partner = one.vertices + vectors.displacements[m:]
        chosen = np.linalg.norm(partner[:, None] - two.vertices[None], axis=2).argmin(axis=1)
        assert apart[np.arange(len(one.vertices)), chosen] == pytest.approx(apart.min(axis=1))


def test_a_large_normal_weight_pairs_by_direction():
    """Two balls far apart: the top belongs to the top."""
    moved = BALL.moved(BALL.vertices + (5.0, 0, 0))
    vectors = by_nearest(BALL, moved, 100.0, "none")
    assert vectors.displacements == pytest.approx(np.tile((5.0, 0, 0), (2 * len(BALL.vertices), 1)), abs=1e-9)


def test_nearest_pairs_of_a_partial_mesh_come_from_it_alone():
    assert np.array_equal(by_nearest(BALL, LARGER, 0.1, "source").centres, BALL.vertices)
    assert np.array_equal(by_nearest(BALL, LARGER, 0.1, "target").centres, LARGER.vertices)


# --- length -------------------------------------------------------------------------------------
def test_long_vectors_are_shortened_in_their_direction():
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(100, 3)) * 10.0 ** rng.uniform(-6, 6, (100, 1))
    vectors[0] = 0.0
    cut = shortened(vectors, 2.0)
    before, after = np.linalg.norm(vectors, axis=1), np.linalg.norm(cut, axis=1)
    assert after == pytest.approx(np.minimum(before, LONGEST * 2.0))
    assert np.cross(vectors, cut) == pytest.approx(np.zeros((100, 3)), abs=1e-6)
    short = before <= LONGEST * 2.0
    assert np.array_equal(cut[short], vectors[short])
