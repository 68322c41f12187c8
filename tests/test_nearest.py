# SPDX-License-Identifier: GPL-3.0-or-later
"""Closest points against all pairs in long double, and signs against winding numbers."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from surfaces import together

from femors_addon import shapes
from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.orientation import winding_number
from femors_addon.progress import Cancelled

EXACT = 1e-11  # of the size of mesh and points together


# --- brute force --------------------------------------------------------------------------------
def to_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances of points to segments."""
    along = b - a
    squared = (along**2).sum(-1)
    share = np.clip(((p - a) * along).sum(-1) / np.where(squared > 0, squared, 1), 0, 1)
    return np.sqrt(((p - a - share[..., None] * along) ** 2).sum(-1))


def by_all_pairs(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distance of each point to the nearest triangle, in long double."""
    out = []
    a, b, c = np.moveaxis(corners.astype(np.longdouble)[None], 2, 0)
    normal = np.cross(b - a, c - a)
    squared = (normal**2).sum(-1)
    flat = squared > 0
    for start in range(0, len(points), 64):
        p = points[start : start + 64].astype(np.longdouble)[:, None]
        distance = np.minimum(np.minimum(to_segment(p, a, b), to_segment(p, b, c)), to_segment(p, c, a))
        height = ((p - a) * normal).sum(-1) / np.where(flat, squared, 1)
        foot = p - height[..., None] * normal
        inside = np.broadcast_to(flat, distance.shape).copy()
        for u, v in ((a, b), (b, c), (c, a)):
            inside &= (np.cross(v - u, foot - u) * normal).sum(-1) >= 0
        distance = np.where(inside, np.minimum(distance, np.abs(height) * np.sqrt(squared)), distance)
        out.append(distance.min(axis=1))
    return np.concatenate(out).astype(float)


def probes(surface: Surface, seed: int = 0, count: int = 40) -> np.ndarray:
    """Points on faces, edges and vertices, close to them, about and far away from the surface."""
    rng = np.random.default_rng(seed)
    face = rng.integers(0, len(surface.faces), count)
    within = np.einsum("pk,pkc->pc", rng.dirichlet((1, 1, 1), count), surface.corners[face])
    middle = (surface.corners[face, 0] + surface.corners[face, 1]) / 2
    corner = surface.corners[face, 2]
    on = np.concatenate((within, middle, corner))
    noise = rng.normal(size=on.shape) * surface.diagonal
    return np.concatenate([on + share * noise for share in (0.0, 1e-9, 1e-3, 0.05, 1.0, 1e3)])


def assert_closest(surface: Surface, points: np.ndarray) -> None:
    """The distance is that of all pairs, and point, face and weights agree with it."""
    found = SurfaceIndex(surface).closest(points)
    size = surface.diagonal + np.linalg.norm(points - surface.vertices[0], axis=1)
    error = np.abs(found.distance - by_all_pairs(points, surface.corners)) / size
    assert error.max() < EXACT, f"point {np.argmax(error)}"
    assert found.distance == pytest.approx(np.linalg.norm(points - found.point, axis=1), abs=1e-300)
    assert found.barycentric.min() >= -1e-12
    assert found.barycentric.sum(axis=1) == pytest.approx(np.ones(len(points)), abs=1e-12)
    corners = surface.corners[found.face]
    assert found.point == pytest.approx(np.einsum("pk,pkc->pc", found.barycentric, corners))
    assert (found.face.dtype, found.point.shape) == (np.int32, points.shape)


# --- distance -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "surface",
    [
        shapes.bone(700),
        shapes.sphere(2),
        shapes.box((1, 2, 3), (3, 2, 1)),
        Surface([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]),
    ],
    ids=["bone", "ball", "box", "one face"],
)
def test_closest_is_that_of_all_pairs(surface):
    assert_closest(surface, probes(surface))
    # in any order of magnitude, and far from the origin
    for scale, shift in ((1e-6, 0.0), (1e6, 0.0)):
        moved = surface.moved(surface.vertices * scale + shift)
        assert_closest(moved, probes(moved, 1, 10))
    far = surface.moved(surface.vertices + 1e5 * surface.diagonal)
    found = SurfaceIndex(far).closest(probes(surface, 2) + 1e5 * surface.diagonal)
    plain = SurfaceIndex(surface).closest(probes(surface, 2))
    assert found.distance == pytest.approx(plain.distance, abs=1e-9 * surface.diagonal, rel=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.sampled_from([1.0, 0.1, 1e-3]))
def test_closest_in_any_soup(seed, faces, flat):
    """Faces through each other, twins, faces of two equal or three equal corners, flat clouds."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(3 * faces, 3)) * (1, 1, flat)
    surface = Surface(points, rng.integers(0, len(points), (faces, 3)))
    assert_closest(surface, np.concatenate((probes(surface, seed, 4), points)))


def test_faces_without_area_are_their_edges():
    points = np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0], [0, 5, 0], [0, 5, 0], [7, 7, 7]], dtype=float)
    for faces in ([[0, 1, 2]], [[2, 0, 1]], [[1, 2, 0]], [[0, 3, 4]], [[3, 4, 0]], [[4, 0, 3]], [[5, 5, 5]]):
        assert_closest(Surface(points, faces), np.random.default_rng(0).normal(size=(40, 3)) * 6)


@pytest.mark.parametrize("height", [1e-3, 1e-5, 1e-7, 1e-9, 1e-11, 1e-13])
def test_slivers(height):
    """As drawing programs export them; what `clean` keeps must not mislead."""
    rng = np.random.default_rng(0)
    a, along = rng.normal(size=(2, 60, 3))
    c = a + along * rng.uniform(0.2, 0.8, (60, 1)) + rng.normal(size=a.shape) * height
    faces = np.arange(180).reshape(3, 60).T
    for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (1, 0, 2)):
        surface = Surface(np.concatenate((a, a + along, c)), faces[:, order])
        points = probes(surface, 1, 15)
        found = SurfaceIndex(surface).closest(points)
        # a point of a sliver cannot be told better than to its rounded height
        size = surface.diagonal + np.linalg.norm(points, axis=1)
        allowed = np.minimum(1e-14 / height, 2 * height) * size + 1e-12 * size
        assert (np.abs(found.distance - by_all_pairs(points, surface.corners)) <= allowed).all()


def test_sizes_that_differ_a_thousandfold_and_more():
    large = shapes.box((1000, 1000, 1000), 1, low=(-500, -500, -500))
    small = shapes.sphere(2, centre=(499, 480, 3))
    tiny = shapes.sphere(1, radius=0.001, centre=(0, 0, 501))
    both = together(large, small, tiny)
    points = np.concatenate([probes(s, 1, 15) for s in (both, large, small, tiny)])
    assert_closest(both, points)
    # one huge face above a fine mesh
    fine = shapes.sphere(3)
    roof = Surface([[-3e3, -3e3, 1.05], [3e3, -3e3, 1.05], [0, 6e3, 1.05]], [[0, 1, 2]])
    assert_closest(
        together(fine, roof), np.random.default_rng(0).normal(size=(300, 3)) * (1, 1, 0.2) + (0, 0, 1)
    )


def test_points_as_far_from_much_as_from_the_nearest():
    """No neighbour search can be cut short amid a ball; nor above a fan of needles."""
    ball = shapes.sphere(3, radius=50.0)
    assert_closest(ball, np.random.default_rng(0).normal(size=(20, 3)) * 1e-3)
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    rim = np.column_stack((100 * np.cos(angle), 100 * np.sin(angle), 0 * angle))
    fan = Surface(np.concatenate((rim, [[0, 0, 0]])), [(i, (i + 1) % 200, 200) for i in range(200)])
    assert_closest(fan, np.random.default_rng(1).normal(size=(60, 3)) * (40, 40, 3))


def test_loose_vertices_are_no_part_of_the_surface():
    ball = shapes.sphere(1)
    loose = Surface(np.concatenate(([[5.0, 0, 0]], ball.vertices)), ball.faces + 1)
    assert SurfaceIndex(loose).closest([[5.0, 0, 0]]).distance[0] == pytest.approx(4.0, abs=0.2)


def test_no_points_and_many_points():
    index = SurfaceIndex(shapes.sphere(2))
    assert index.closest(np.empty((0, 3))).point.shape == (0, 3)
    assert index.signed([]).shape == (0,)
    points = np.random.default_rng(0).normal(size=(30_000, 3))  # more than one block
    whole = index.closest(points)
    part = index.closest(points[12_345:12_400])
    assert np.array_equal(whole.distance[12_345:12_400], part.distance)
    assert np.array_equal(whole.face[12_345:12_400], part.face)


def test_the_same_bits_every_time():
    bone = shapes.bone(700)
    points = probes(bone)
    one, two = (SurfaceIndex(bone.moved(bone.vertices)).closest(points) for _ in range(2))
    for name in ("distance", "point", "face", "barycentric"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes()


def test_progress_is_told_and_may_cancel():
    told: list[float] = []
    index = SurfaceIndex(shapes.bone(700))
    index.closest(probes(shapes.bone(700)), lambda fraction, text: told.append(fraction))
    assert told
    assert all(0.0 <= fraction <= 1.0 for fraction in told)

    def cancel(fraction, text):
        raise Cancelled

    for ask in (index.closest, index.signed):
        with pytest.raises(Cancelled):
            ask([[0.0, 0.0, 0.0]], cancel)


# --- sign ---------------------------------------------------------------------------------------
def thin_corner() -> Surface:
    """A tetrahedron with angles of a few degrees."""
    points = [[0, 0, 0], [10, 0, 0], [0, 0.3, 0], [1, 0, 0.2]]
    return Surface(points, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def saddle() -> Surface:
    """A box whose top is pressed in to a corner below: convex, concave and saddle-like vertices."""
    block = shapes.box((2, 2, 2), 2)
    points = block.vertices.copy()
    points[np.flatnonzero((points == (1, 1, 2)).all(axis=1))] = (1.0, 0.7, 0.3)
    points[np.flatnonzero((points == (2, 1, 2)).all(axis=1))] = (2.0, 1.0, 1.4)
    return block.moved(points)


def hollow() -> Surface:
    """A box with a box-shaped hole in it, whose surface looks into the hole."""
    inner = shapes.box((1, 1, 1), 1, low=(1, 1, 1))
    return together(shapes.box((3, 3, 3), 2), Surface(inner.vertices, inner.faces[:, ::-1]))


@pytest.mark.parametrize(
    "surface",
    [
        shapes.box((1, 2, 3), 1),
        shapes.box((1, 1, 0.01), (4, 4, 1)),
        shapes.sphere(1),
        shapes.bone(700),
        thin_corner(),
        saddle(),
        hollow(),
    ],
    ids=["box", "slab", "ball", "bone", "thin corner", "saddle", "hollow"],
)
def test_no_sign_is_wrong(surface):
    """Also where the closest feature is an edge or a vertex, where a face's normal misleads."""
    rng = np.random.default_rng(0)
    edges = surface.edges
    near = np.concatenate((surface.vertices, surface.vertices[edges].mean(axis=1)))
    near = near[rng.integers(0, len(near), 400)]
    shares = (1.0, 0.3, 0.05, 1e-3, 1e-6, 1e-9)
    points = np.concatenate([near + rng.normal(size=near.shape) * k * surface.diagonal for k in shares])
    index = SurfaceIndex(surface)
    signed, winding = index.signed(points), winding_number(surface.corners, points)
    assert np.abs(signed) == pytest.approx(index.closest(points).distance, abs=0.0)
    clear = np.abs(signed) > 1e-12 * surface.diagonal
    assert clear.mean() > 0.99
    wrong = ((signed < 0) != (winding > 0.5)) & clear
    assert not wrong.any(), (
        f"{wrong.sum()} wrong, up to {np.abs(signed[wrong]).max() / surface.diagonal:.1e} away"
    )
    # the points that matter here are there
    features = (index.closest(points).barycentric <= 1e-12).sum(axis=1)
    assert ((features == 1).sum() > 50) and ((features == 2).sum() > 50)


def test_the_signed_distance_of_a_box_is_its_formula():
    """Inside: to the nearest wall. Outside: to the nearest face, edge or corner."""
    block = shapes.box((2, 4, 6), (1, 2, 3), low=(-1, -2, -3))
    points = np.random.default_rng(0).uniform(-8, 8, (2000, 3))
    beyond = np.abs(points) - (1, 2, 3)
    truth = np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)
    assert SurfaceIndex(block).signed(points) == pytest.approx(truth, abs=1e-12)


def test_pseudonormals_point_outward_at_every_feature():
    block = shapes.box((1, 1, 1), 1)
    index = SurfaceIndex(block)
    found = index.closest([[2.0, 0.5, 0.4], [2.0, 2.0, 0.4], [2.0, 2.0, 2.0]])
    expected = np.array([[1, 0, 0], np.array([1, 1, 0]) / 2**0.5, np.array([1, 1, 1]) / 3**0.5])
    assert index.pseudonormals(found) == pytest.approx(expected, abs=1e-12)


def test_a_hub_of_many_faces_does_not_fill_the_memory():
    """A cap drawn as a fan: every point near its middle has all its faces to look at."""
    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    rim = np.column_stack((np.cos(angle), np.sin(angle), 0 * angle))
    fan = Surface(np.concatenate((rim, [[0, 0, 0]])), [(i, (i + 1) % 2000, 2000) for i in range(2000)])
    points = np.random.default_rng(0).normal(size=(1500, 3)) * 0.1
    tracemalloc.start()
    try:
        found = SurfaceIndex(fan).closest(points)
        peak = tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()
    assert found.distance == pytest.approx(np.abs(points[:, 2]), abs=1e-5)
    assert peak < 250.0
