# SPDX-License-Identifier: GPL-3.0-or-later
"""Quality measures, against hand-made cases, brute force and the authors' stored figures."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from anatomy import PAIR, femur_pair, needs_pair

from femors_addon import quality
from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.quality import Stat, aspect_ratio, compare, dihedral_angles, flipped_faces, skewness
from femors_addon.shapes import bone, box, sphere


def triangle(*corners) -> Surface:
    return Surface(np.array(corners, dtype=float), [[0, 1, 2]])


def sheet(n: int = 6) -> Surface:
    """A flat square sheet of n x n cells, facing up."""
    x, y = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0), indexing="ij")
    at = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (corner.ravel() for corner in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    faces = np.concatenate((np.column_stack((a, b, c)), np.column_stack((a, c, d))))
    return Surface(np.column_stack((x.ravel(), y.ravel(), 0 * x.ravel())), faces)


def rotation(seed: int) -> np.ndarray:
    q = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


# --- the authors' own figures -------------------------------------------------------------------
@needs_pair
def test_the_authors_figures_are_reproduced():
    source, target = femur_pair()
    with np.load(PAIR / "meshes.npz") as data:
        morphed = source.moved(data["authors_morphed_vertices"])
    stored = json.loads((PAIR / "authors_metrics.json").read_text())
    result = compare(source, morphed, target).as_dict()
    # their surface distance is itself an approximation
    for ours, theirs, tolerance in (
        ("surface_to_target", "surf_distances", 2.5e-3),
        ("hausdorff", "haus_distance", 1e-3),
        ("dihedral", "edge_angles", 1e-3),
        ("aspect", "aspects", 1e-3),
        ("skewness", "skewness", 1e-3),
    ):
        figures = {"maximum" if name == "max" else name: value for name, value in stored[theirs].items()}
        assert result[ours] == pytest.approx(figures, abs=tolerance), ours
    assert result["target_to_surface"]["median"] == pytest.approx(0.128, abs=1e-3)
    assert result["flipped"] == result["self_intersecting"] == 0


# --- Stat ---------------------------------------------------------------------------------------
def test_a_stat_is_median_percentiles_and_maximum():
    stat = Stat.of(np.random.default_rng(0).permutation(np.arange(1001.0)).reshape(7, -1))
    assert stat == Stat(500.0, 10.0, 990.0, 1000.0)
    assert stat.as_dict() == {"median": 500.0, "p01": 10.0, "p99": 990.0, "maximum": 1000.0}
    assert Stat.of([]) == Stat(0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("maximum", "text"),
    [
        (2.6204, "0.130 [0.002, 0.870] max 2.62"),
        (58.18, "0.130 [0.002, 0.870] max 58.2"),
        (12345.6, "0.130 [0.002, 0.870] max 12346"),
        (0.0, "0.130 [0.002, 0.870] max 0.00"),
        (1.234e-9, "0.130 [0.002, 0.870] max 0.000"),
    ],
)
def test_a_stat_in_words(maximum, text):
    assert str(Stat(0.13, 0.002, 0.87, maximum)) == text


@pytest.mark.parametrize(
    ("factor", "text"),
    [
        (1.0, "0.130 [0.002, 0.870] max 2.62"),
        (1e-3, "0.00013 [2e-06, 0.00087] max 0.00262"),
        (1e-1, "0.013 [0.0002, 0.087] max 0.262"),
        (1e-12, "0.000 [0.000, 0.000] max 0.000"),
        (0.0, "0.000 [0.000, 0.000] max 0.00"),
    ],
)
def test_small_stats_keep_their_digits(factor, text):
    assert str(Stat(*(factor * np.array((0.13, 0.002, 0.87, 2.6204))))) == text


def test_rounding_beside_small_figures_is_zero():
    assert str(Stat(1e-14, 0.0, 0.002, 0.03)) == "0 [0, 0.002] max 0.03"


# --- the shape of faces -------------------------------------------------------------------------
def test_aspect_ratio_is_longest_over_shortest_side():
    assert aspect_ratio(triangle((0, 0, 0), (3, 0, 0), (0, 4, 0))) == pytest.approx([5 / 3])
    assert aspect_ratio(sphere(0)) == pytest.approx(np.ones(20))
    shape = bone(1000)
    moved = shape.moved(7.0 * shape.vertices @ rotation(1) + 100.0)
    assert aspect_ratio(moved) == pytest.approx(aspect_ratio(shape))


def test_skewness_is_the_equiangular_one():
    assert skewness(sphere(0)) == pytest.approx(np.zeros(20), abs=1e-12)
    assert skewness(triangle((0, 0, 0), (1, 0, 0), (0, 1, 0))) == pytest.approx([0.25])
    shape = bone(1000)
    angles = []
    for i in range(3):
        one, two = (shape.corners[:, i - k] - shape.corners[:, i] for k in (1, 2))
        lengths = np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1)
        angles.append(np.degrees(np.arccos(np.sum(one * two, axis=1) / lengths)))
    both = np.maximum((np.max(angles, axis=0) - 60) / 120, (60 - np.min(angles, axis=0)) / 60)
    assert skewness(shape) == pytest.approx(both, abs=1e-9)


def test_dihedral_angles_of_solids():
    assert dihedral_angles(sphere(0)) == pytest.approx(np.full(60, 41.810315))  # icosahedron: 180 - 138.19
    block = box((1, 2, 3), 3)
    angles = dihedral_angles(block)
    assert len(angles) == 2 * len(block.edges)
    assert np.sort(angles) == pytest.approx(np.repeat((0.0, 90.0), (len(angles) - 72, 72)), abs=1e-6)


def test_dihedral_angles_keep_their_digits_near_flat_and_folded():
    for angle in (1e-9, 1e-4, 100.0, 179.999):
        turn = np.radians(angle)
        points = [[0, 0, 0], [0, 1, 0], [1, 0.5, 0], [-np.cos(turn), 0.5, np.sin(turn)]]
        assert dihedral_angles(Surface(points, [[0, 2, 1], [0, 1, 3]])) == pytest.approx(
            [angle] * 2, rel=1e-6
        )


def test_open_edges_and_faces_without_area_have_no_dihedral():
    flat = sheet(3)
    assert len(dihedral_angles(flat)) == 2 * (len(flat.edges) - 12)
    points = flat.vertices.copy()
    points[5] = points[6]
    assert (dihedral_angles(flat.moved(points)) == 0.0).all()


# --- folded faces -------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "change",
    [
        rotation(2),
        -np.eye(3),  # mirrored, all three axes
        np.diag([1.0, 1.0, -1.0]) @ rotation(3),
        np.diag([1.6, 0.7, 1.0]),
    ],
)
def test_no_face_is_flipped_by_a_movement_of_the_whole(change):
    for shape in (bone(1000), box((1, 1, 1), 3), sheet()):
        assert len(flipped_faces(shape, shape.moved(shape.vertices @ change + 5.0))) == 0


def test_a_component_that_is_turned_inside_out_is_flipped():
    one, two = sphere(2), bone(1000)
    n, m = len(one.vertices), len(one.faces)
    both = Surface(np.concatenate((one.vertices, two.vertices)), np.concatenate((one.faces, two.faces + n)))
    for start, at in (((slice(0, n)), range(m)), (slice(n, None), range(m, len(both.faces)))):
        points = both.vertices.copy()
        points[start] = 200.0 - points[start]
        assert flipped_faces(both, both.moved(points)).tolist() == list(at)
        assert len(flipped_faces(both.moved(points), both.moved(points))) == 0
    points = -both.vertices  # all of it: a mirror image
    assert len(flipped_faces(both, both.moved(points @ rotation(5)))) == 0
    # an open piece has no inside: bent the other way it is not flipped, and it says nothing of the rest
    dish = sheet(4)
    bend = np.sum((dish.vertices[:, :2] - 2.0) ** 2, axis=1) / 20.0
    dish = dish.moved(dish.vertices + bend[:, None] * (0.0, 0.0, 1.0))
    pieces = Surface(
        np.concatenate((one.vertices, dish.vertices)), np.concatenate((one.faces, dish.faces + n))
    )
    points = pieces.vertices.copy()
    points[n:, 2] *= -1.0
    assert len(flipped_faces(pieces, pieces.moved(points))) == 0


@pytest.mark.parametrize("lift", [0.0, 0.01])
def test_the_faces_that_a_vertex_is_pushed_across_are_flipped(lift):
    flat = sheet()
    points = flat.vertices.copy()
    middle = 3 * 7 + 3
    points[middle] += (1.3, 0.45, lift)  # beyond its ring: faces there turn over
    pushed = flat.moved(points)
    over = np.flatnonzero(pushed.face_cross[:, 2] < 0)
    assert 0 < len(over) < 6
    assert flipped_faces(flat, pushed).tolist() == over.tolist()
    # already so before: no news
    assert len(flipped_faces(pushed, pushed)) == 0
    # and seen from below, all wound the other way
    below = Surface(flat.vertices, flat.faces[:, ::-1])
    assert flipped_faces(below, below.moved(points)).tolist() == over.tolist()


def test_faces_flattened_to_nothing_count_once_they_are():
    flat = sheet()
    points = flat.vertices.copy()
    points[24] = points[25]
    flattened = flat.moved(points)
    gone = np.flatnonzero((flat.faces == 24).any(axis=1) & (flat.faces == 25).any(axis=1))
    assert len(gone) == 2
    assert set(gone) <= set(flipped_faces(flat, flattened).tolist())
    assert len(flipped_faces(flattened, flattened)) == 0
    nothing = flat.moved(np.zeros_like(points))
    assert flipped_faces(flat, nothing).tolist() == list(range(len(flat.faces)))


def test_flipped_faces_wants_one_mesh():
    with pytest.raises(ValueError, match="one mesh"):
        flipped_faces(sphere(0), sphere(1))


# --- distances ----------------------------------------------------------------------------------
def closest_by_sampling(points: np.ndarray, surface: Surface, n: int = 24) -> np.ndarray:
    """Distance from points to a surface, from above: all faces, a lattice of barycentric weights."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1))
    weights = np.column_stack((i[i + j <= n], j[i + j <= n], (n - i - j)[i + j <= n])) / n
    samples = (weights @ surface.corners).reshape(-1, 3)
    return np.min(np.linalg.norm(points[:, None] - samples, axis=2), axis=1)


def test_nearest_vertex_distance_is_brute_force():
    rng = np.random.default_rng(0)
    points, target = rng.normal(size=(50, 3)), rng.normal(size=(80, 3))
    brute = np.linalg.norm(points[:, None] - target, axis=2).min(axis=1)
    assert quality.nearest_vertex_distance(points, target) == pytest.approx(brute)
    assert quality.nearest_vertex_distance(points, np.empty((0, 3))).tolist() == [0.0] * 50
    assert quality.nearest_vertex_distance(np.empty((0, 3)), target).shape == (0,)


def test_surface_distances_go_both_ways():
    morphed, target = sphere(1), sphere(1, radius=1.3, centre=(0.1, 0.0, 0.0))
    result = compare(morphed, morphed, target)
    for stat, points, surface in (
        (result.surface_to_target, morphed.vertices, target),
        (result.target_to_surface, target.vertices, morphed),
    ):
        sampled = Stat.of(closest_by_sampling(points, surface))
        assert sampled.median - 0.002 <= stat.median <= sampled.median
        assert sampled.maximum - 0.002 <= stat.maximum <= sampled.maximum


def test_what_is_not_covered_shows_from_the_target_only():
    whole = sphere(3)
    half = Surface(whole.vertices, whole.faces[(whole.corners[:, :, 2] > -1e-9).all(axis=1)])
    result = compare(half, half, whole)
    assert result.surface_to_target.maximum == pytest.approx(0.0, abs=1e-12)
    assert result.target_to_surface.maximum == pytest.approx(np.sqrt(2.0), abs=0.05)


DISTANCES = ("surface_to_target", "target_to_surface", "hausdorff")


# --- all together -------------------------------------------------------------------------------
def test_a_mesh_against_itself_is_perfect():
    shape = bone(1000)
    result = compare(shape, shape, shape)
    nothing = Stat(0.0, 0.0, 0.0, 0.0)
    assert result.movement == result.hausdorff == nothing
    assert result.surface_to_target.maximum < 1e-12
    assert result.target_to_surface.maximum < 1e-12
    assert result.flipped == result.self_intersecting == 0
    assert result.aspect == Stat.of(aspect_ratio(shape))


def test_what_compare_counts():
    shape = sphere(3)
    points = shape.vertices.copy()
    top = points[:, 2] > 0.6
    points[top, 2] -= 4.0 * np.sqrt(points[top, 2] - 0.6)  # through the bottom
    folded = shape.moved(points)
    index = SurfaceIndex(shape)
    result = compare(shape, folded, shape, target_index=index)
    assert result == compare(shape, folded, shape)
    assert result.self_intersecting == len(np.unique(quality.self_intersections(folded))) > 0
    assert result.flipped == len(flipped_faces(shape, folded))
    shifted = shape.moved(shape.vertices + (0.0, 3.0, 4.0))
    assert tuple(compare(shape, shifted, shape).movement.as_dict().values()) == pytest.approx((5.0,) * 4)


def test_a_sample_stands_for_the_distances():
    shape = sphere(5)
    away = shape.moved((1.1 + 0.1 * shape.vertices[:, :1]) * shape.vertices)
    whole, some = compare(shape, away, shape), compare(shape, away, shape, sample=1000)
    for name in DISTANCES:
        one, two = getattr(whole, name), getattr(some, name)
        assert two.median == pytest.approx(one.median, rel=0.05)
        assert two.maximum <= one.maximum
        assert two != one
    assert dataclasses.replace(some, **{name: getattr(whole, name) for name in DISTANCES}) == whole
    assert compare(shape, away, shape, sample=len(shape.vertices)) == whole
    assert [some.sample, whole.sample, compare(shape, away, shape, sample=10**6).sample] == [1000, 0, 0]


def test_loose_vertices_are_no_part_of_the_surface():
    shape = sphere(2)
    stray = np.concatenate((shape.vertices, [[100.0, 0.0, 0.0]]))
    loose = Surface(stray, shape.faces)
    result = compare(loose, loose, loose)
    assert max(result.surface_to_target.maximum, result.target_to_surface.maximum) < 1e-12
    assert compare(shape, shape, loose).hausdorff.maximum == 0.0


@pytest.mark.parametrize(
    "surface",
    [
        Surface(np.empty((0, 3)), np.empty((0, 3))),
        Surface(np.zeros((4, 3)), np.empty((0, 3))),
        Surface(np.zeros((4, 3)), [[0, 1, 2], [1, 3, 2]]),
        Surface([[0, 0, 0], [1, 0, 0], [3, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, 3], [3, 3, 3]]),
        Surface(1e-60 * sphere(0).vertices, sphere(0).faces),
        Surface(1e60 * sphere(0).vertices, sphere(0).faces),
    ],
)
@pytest.mark.parametrize("other", [sphere(1), Surface(np.empty((0, 3)), np.empty((0, 3)))])
def test_nothing_is_ever_nan(surface, other):
    for one, two in ((surface, other), (other, surface)):
        text = json.dumps(compare(one, one, two).as_dict(), allow_nan=False)
        assert json.loads(text)["flipped"] == 0
    for values in (aspect_ratio(surface), skewness(surface), dihedral_angles(surface)):
        assert np.isfinite(values).all()
    assert len(aspect_ratio(surface)) == len(skewness(surface)) == len(surface.faces)
    assert np.isfinite(surface.volume)
