# SPDX-License-Identifier: GPL-3.0-or-later
"""Made-up bones: sound meshes, smooth one-to-one warps, and a correspondence that is true."""

from __future__ import annotations

import numpy as np
import pytest

from femors_addon import isosurface, shapes
from femors_addon.cleaning import clean
from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.quality import aspect_ratio, dihedral_angles, flipped_faces, self_intersections
from femors_addon.shapes import LENGTH, bone, box, differences, pair, sphere, warp

KINDS = ("stretch", "grow", "bend", "twist", "bump", "turn", "shift")


def assert_sound(surface: Surface, handles: int = 0) -> None:
    """Closed, each edge between two faces that run along it oppositely, outward, in one piece."""
    half = surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    forth = set(map(tuple, half.tolist()))
    assert len(forth) == len(half)
    assert forth == set(map(tuple, half[:, ::-1].tolist()))
    assert len(surface.vertices) - len(surface.edges) + len(surface.faces) == 2 - 2 * handles
    assert surface.volume > 0
    cleaned = clean(surface.vertices, surface.faces)
    assert cleaned.notes == ()
    assert len(np.unique(surface.faces)) == len(surface.vertices)


def area(surface: Surface) -> float:
    return float(surface.face_areas.sum())


# --- bones --------------------------------------------------------------------------------------
@pytest.mark.parametrize(("nodes", "seed", "lattice"), [(800, 0, 0), (1500, 1, 5), (5000, 2, 1)])
def test_a_bone_is_a_sound_mesh_of_good_triangles(nodes, seed, lattice):
    surface = bone(nodes, seed=seed, lattice=lattice)
    assert_sound(surface)
    assert len(surface.vertices) == pytest.approx(nodes, rel=0.06)
    assert np.percentile(aspect_ratio(surface), 99) < 2.0
    assert aspect_ratio(surface).max() < 4.0
    assert len(self_intersections(surface)) == 0
    assert np.ptp(surface.vertices, axis=0)[2] == pytest.approx(LENGTH, rel=0.02)
    assert dihedral_angles(surface).max() < 70.0


def test_a_dense_bone_is_as_sound(monkeypatch):
    monkeypatch.setattr(isosurface, "DENSEST", 500)
    surface = bone(7000, lattice=3)  # halved twice
    assert_sound(surface)
    assert len(surface.vertices) == pytest.approx(7000, rel=0.1)
    assert np.percentile(aspect_ratio(surface), 99) < 2.0
    assert dihedral_angles(surface).max() < 70.0
    coarse = bone(440, lattice=3)
    assert SurfaceIndex(surface).closest(coarse.vertices).distance.max() < 0.5


def section(surface: Surface, low: float, high: float) -> np.ndarray:
    """Extent (x, y) of the vertices between two heights, in shares of the length."""
    z = surface.vertices[:, 2] / LENGTH
    return np.ptp(surface.vertices[(z > low) & (z < high)][:, :2], axis=0)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_a_bone_looks_like_one(seed):
    surface = bone(2000, seed=seed)
    shaft, knee = section(surface, 0.45, 0.55), section(surface, 0.0, 0.1)
    assert 22.0 < shaft[0] < 34.0
    assert 22.0 < shaft[1] < 36.0
    assert knee[0] > 2.2 * shaft[0]  # two condyles side by side
    assert section(surface, 0.8, 1.0)[0] > 2.5 * shaft[0]  # the head stands off to one side
    top = surface.vertices[surface.vertices[:, 2] > 0.96 * LENGTH]
    centre = np.linalg.lstsq(
        np.column_stack((2 * top, np.ones(len(top)))), np.sum(top**2, axis=1), rcond=None
    )[0]
    spread = np.linalg.norm(top - centre[:3], axis=1)
    assert spread.mean() == pytest.approx(22.5, rel=0.1)  # the head is a ball
    assert spread.std() < 0.02 * spread.mean()


def test_the_same_bone_again_is_the_same_and_another_seed_another():
    one = bone(1000, seed=4)
    again, other = bone(1000, seed=4), bone(1000, seed=5)
    assert np.array_equal(one.vertices, again.vertices)
    assert np.array_equal(one.faces, again.faces)
    assert np.abs(one.bounds[0] - other.bounds[0]).max() > 0.5


def test_another_lattice_is_another_mesh_of_the_same_surface():
    one, other = bone(2000), bone(3000, lattice=1)
    back = SurfaceIndex(other).closest(one.vertices).distance
    # the chord of an edge h long across a radius r lies h^2 / 8 r below it
    assert np.median(back) < one.mean_edge**2 / (8 * 13.0)
    assert back.max() < 1.5
    nearest = np.linalg.norm(one.vertices[:200, None] - other.vertices, axis=2).min(axis=1)
    assert np.median(nearest) > 0.2 * other.mean_edge


def test_length_is_in_the_unit_wanted():
    metres, mm = bone(1000, length=0.4), bone(1000)
    assert metres.vertices == pytest.approx(mm.vertices / 1000.0)


# --- meshing ------------------------------------------------------------------------------------
def test_vertices_lie_on_the_implicit_surface():
    def torus(p):
        return np.hypot(np.hypot(p[:, 0], p[:, 1]) - 2.0, p[:, 2]) - 0.7

    surface = isosurface.meshed(torus, np.full(3, -3.0), np.full(3, 3.0), 1500)
    assert_sound(surface, handles=1)
    assert np.abs(torus(surface.vertices)).max() < 1e-9
    assert surface.volume == pytest.approx(2 * np.pi**2 * 2.0 * 0.7**2, rel=0.02)
    with pytest.raises(ValueError, match="within the box"):
        isosurface.meshed(torus, np.full(3, -1.0), np.full(3, 1.0), 500)


def test_an_implicit_need_not_be_a_distance():
    def egg(p):
        return np.sum((p / (1.0, 1.5, 2.0)) ** 2, axis=1) - 1.0

    surface = isosurface.meshed(egg, np.full(3, -2.2), np.full(3, 2.2), 400)
    assert_sound(surface)
    assert np.abs(egg(surface.vertices)).max() < 1e-9


@pytest.mark.parametrize("seed", range(8))
def test_any_values_give_a_closed_net(seed):
    # noise: every pattern of signs there is
    values = np.random.default_rng(seed).normal(size=(9, 8, 7))
    values[[0, -1]] = values[:, [0, -1]] = values[:, :, [0, -1]] = 1.0
    points, quads = isosurface._net(isosurface._untangled(values))
    edges = np.sort(quads[:, [[0, 1], [1, 2], [2, 3], [3, 0]]].reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count == 2).all()
    assert len(np.unique(quads)) == len(points)
    faces = isosurface._cut(points, quads)
    half = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    assert set(map(tuple, half.tolist())) == set(map(tuple, half[:, ::-1].tolist()))


def test_halving_keeps_the_surface():
    block = box((1, 2, 3), 2)
    fine = isosurface.halved(block)
    assert_sound(fine)
    assert len(fine.faces) == 4 * len(block.faces)
    assert fine.volume == pytest.approx(6.0)
    assert area(fine) == pytest.approx(22.0)


# --- warps --------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def small() -> Surface:
    return bone(1000)


def jacobian(points: np.ndarray, *steps) -> np.ndarray:
    """Determinant of the warp's derivative at each point, by central differences."""
    h = 1e-3
    columns = [(warp(points + h * e, *steps) - warp(points - h * e, *steps)) / (2 * h) for e in np.eye(3)]
    return np.linalg.det(np.stack(columns, axis=2))


@pytest.mark.parametrize("kind", KINDS)
def test_no_strength_is_no_change_and_some_is_some(kind, small):
    assert np.allclose(warp(small.vertices, (kind, 0.0)), small.vertices, rtol=0, atol=1e-12)
    change = np.linalg.norm(warp(small.vertices, (kind, 0.1)) - small.vertices, axis=1)
    assert change.max() > 2.0
    # continuous through zero
    slight = warp(small.vertices, (kind, 1e-9)) - warp(small.vertices, (kind, -1e-9))
    assert np.abs(slight).max() < 1e-5


@pytest.mark.parametrize("kind", ["turn", "shift"])
def test_rigid_warps_keep_distances(kind, small):
    moved = warp(small.vertices, (kind, 0.7))
    assert np.linalg.norm(moved[1:] - moved[0], axis=1) == pytest.approx(
        np.linalg.norm(small.vertices[1:] - small.vertices[0], axis=1)
    )
    assert small.moved(moved).volume == pytest.approx(small.volume)


@pytest.mark.parametrize("strength", [-0.4, 0.3, 1.0])
def test_volumes_follow_theory(strength, small):
    points = small.vertices[::10]
    assert jacobian(points, ("stretch", strength)) == pytest.approx(np.ones(len(points)))
    assert jacobian(points, ("twist", strength)) == pytest.approx(np.ones(len(points)))
    assert jacobian(points, ("grow", strength)) == pytest.approx(np.full(len(points), (1 + strength) ** 3))
    # bending: cross-sections turn about an axis at y = -length / strength
    expected = 1.0 + strength * points[:, 1] / LENGTH
    assert jacobian(points, ("bend", strength)) == pytest.approx(expected)


def test_bending_makes_an_arc_of_the_middle_line():
    z = np.linspace(0.0, LENGTH, 200)
    line = np.column_stack((0 * z, 0 * z, z))
    bent = warp(line, ("bend", 0.5))
    assert np.linalg.norm(np.diff(bent, axis=0), axis=1).sum() == pytest.approx(LENGTH, rel=1e-5)
    assert np.linalg.norm(bent - (0.0, -LENGTH / 0.5, LENGTH / 2), axis=1) == pytest.approx(
        np.full(200, LENGTH / 0.5)
    )


def test_warps_compose_in_order_and_scale_with_the_length(small):
    one, two = ("bend", 0.3), ("twist", 0.8)
    assert warp(small.vertices, one, two) == pytest.approx(warp(warp(small.vertices, one), two))
    assert np.abs(warp(small.vertices, one, two) - warp(small.vertices, two, one)).max() > 1.0
    steps = [(kind, 0.1) for kind in KINDS]
    metres = warp(small.vertices / 1000.0, *steps, length=LENGTH / 1000.0)
    assert metres == pytest.approx(warp(small.vertices, *steps) / 1000.0, abs=1e-12)
    assert warp(small.vertices) == pytest.approx(small.vertices)


def test_an_unknown_warp_is_named():
    with pytest.raises(ValueError, match=r"'wring' is not one of stretch, .*shift"):
        warp(np.zeros((1, 3)), ("wring", 1.0))


@pytest.mark.parametrize("kind", KINDS)
def test_warps_are_one_to_one_to_the_strength_that_they_say(kind, small):
    for strength in (-0.15, 0.15) if kind == "bump" else (-0.9, 1.0):
        assert jacobian(small.vertices, (kind, strength)).min() > 0


# --- pairs --------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(3))
def test_the_truth_of_a_pair_lies_on_its_target(seed):
    source, target, truth = pair(1500, 3000, seed)
    assert truth.shape == source.vertices.shape
    assert_sound(target)
    assert len(self_intersections(target)) == 0
    assert np.percentile(aspect_ratio(target), 99) < 2.5
    off = SurfaceIndex(target).closest(truth).distance
    assert np.median(off) < target.mean_edge**2 / (8 * 13.0)
    assert off.max() < 0.2 * target.mean_edge
    # the source at its true places is a sound mesh too, though not where it was
    assert len(flipped_faces(source, source.moved(truth))) == 0
    assert np.median(np.linalg.norm(truth - source.vertices, axis=1)) > 2.0


def test_a_pair_without_difference_or_in_another_pose():
    source, _, truth = pair(800, 800, strength=0.0)
    assert np.allclose(truth, source.vertices, atol=1e-10)
    _, plain, here = pair(800, 1000, 2)
    _, posed, there = pair(800, 1000, 2, posed=True)
    assert np.ptp(np.linalg.norm(there - there[0], axis=1) - np.linalg.norm(here - here[0], axis=1)) < 1e-9
    assert posed.volume == pytest.approx(plain.volume)
    assert np.linalg.norm(there - here, axis=1).min() > 20.0


def test_differences_between_people_are_one_to_one_even_doubled(small):
    seen = [differences(seed) for seed in range(20)]
    assert len(set(seen)) == 20
    for seed in range(20):
        assert jacobian(small.vertices[::5], *differences(seed, 2.0)).min() > 0.2


# --- plain solids -------------------------------------------------------------------------------
def test_a_sphere_converges_on_the_sphere():
    errors = []
    for halvings in (1, 2, 3):
        ball = sphere(halvings, radius=2.0, centre=(1.0, 2.0, 3.0))
        assert_sound(ball)
        assert len(ball.vertices) == 10 * 4**halvings + 2
        assert np.linalg.norm(ball.vertices - (1.0, 2.0, 3.0), axis=1) == pytest.approx(
            np.full(len(ball.vertices), 2.0)
        )
        errors.append(4 / 3 * np.pi * 8.0 - ball.volume)
    assert np.array(errors[:-1]) / errors[1:] == pytest.approx((4.0, 4.0), rel=0.1)


@pytest.mark.parametrize("cells", [1, 3, (2, 3, 4)])
def test_a_box_is_exact(cells):
    block = box((1, 2, 3), cells, low=(-1, 5, 0))
    assert_sound(block)
    assert block.volume == pytest.approx(6.0)
    assert area(block) == pytest.approx(22.0)
    assert block.bounds[0].tolist() == [-1, 5, 0]
    assert block.bounds[1].tolist() == [0, 7, 3]
    a, b, c = np.broadcast_to(cells, 3)
    assert len(block.faces) == 4 * (a * b + b * c + c * a)


def test_the_kinds_tested_are_all_there_are():
    assert set(KINDS) == set(shapes._WARPS)
