# SPDX-License-Identifier: GPL-3.0-or-later
"""Crossings of surfaces, against exact integer arithmetic, brute force and the topology of curves."""

from __future__ import annotations

import numpy as np
import pytest

from femors_addon import balls
from femors_addon.intersect import crossings, crossings_of, piercings, self_intersections
from femors_addon.mesh import Surface
from femors_addon.progress import Cancelled
from femors_addon.shapes import bone, box, sphere


def soup(rng: np.random.Generator, sizes: np.ndarray, sliver: float = 1.0, room: float = 1.0) -> Surface:
    """Random triangles (one for each size) that share no vertices."""
    corners = rng.normal(size=(len(sizes), 3, 3))
    corners[:, 2] = corners[:, 0] + 0.4 * (corners[:, 1] - corners[:, 0]) + corners[:, 2] / sliver
    corners = corners * sizes[:, None, None] + rng.uniform(-room, room, (len(sizes), 1, 3))
    return Surface(corners.reshape(-1, 3), np.arange(3 * len(sizes)).reshape(-1, 3))


def signed_volume(a, b, c, d):
    """Six times the volume of tetrahedra; exact where the coordinates are small integers."""
    u, v, w = b - a, c - a, d - a
    return (
        u[..., 0] * (v[..., 1] * w[..., 2] - v[..., 2] * w[..., 1])
        - u[..., 1] * (v[..., 0] * w[..., 2] - v[..., 2] * w[..., 0])
        + u[..., 2] * (v[..., 0] * w[..., 1] - v[..., 1] * w[..., 0])
    )


def exact(a: Surface, b: Surface) -> tuple[set[tuple[int, int]], set[tuple[int, int]]]:
    """All (edge of a, face of b), (face of a, face of b): the definition, word for word, in integers."""
    va, vb = a.vertices.astype(np.int64), b.vertices.astype(np.int64)
    ca, cb = va[a.faces][:, None], vb[b.faces][None]
    over = np.stack([signed_volume(cb[:, :, 0], cb[:, :, 1], cb[:, :, 2], ca[:, :, k]) for k in range(3)])
    back = np.stack([signed_volume(ca[:, :, 0], ca[:, :, 1], ca[:, :, 2], cb[:, :, k]) for k in range(3)])
    both = np.logical_and.reduce([(h < 0).any(axis=0) & (h > 0).any(axis=0) for h in (over, back)])
    number = {tuple(edge): i for i, edge in enumerate(a.edges.tolist())}
    edges, faces = set(), set()
    for k in range(3):
        u, v = ca[:, :, k], ca[:, :, (k + 1) % 3]
        sides = np.stack([signed_volume(u, v, cb[:, :, i], cb[:, :, (i + 1) % 3]) for i in range(3)])
        through = both & (over[k] * over[(k + 1) % 3] < 0)
        through &= (sides >= 0).all(axis=0) | (sides <= 0).all(axis=0)
        ends = a.faces[:, [k, (k + 1) % 3]]
        if a is b:
            through &= ~(ends[:, None, :, None] == b.faces[None, :, None, :]).any(axis=(2, 3))
        for f, g in np.argwhere(through).tolist():
            edges.add((number[tuple(sorted(ends[f].tolist()))], g))
            faces.add((f, g))
    return edges, faces


def solved_pairs(a: Surface, b: Surface) -> set[tuple[int, int]]:
    """All (face of a, face of b) of which an edge meets the other, by solving linear equations."""
    pairs = set()
    for one, two, swap in ((a, b, False), (b, a, True)):
        for i, corners in enumerate(one.corners):
            for k in range(3):
                u, v = corners[k], corners[(k + 1) % 3]
                p, q, r = np.moveaxis(two.corners, 1, 0)
                system = np.stack((q - p, r - p, np.broadcast_to(u - v, p.shape)), axis=2)
                good = np.abs(np.linalg.det(system)) > 0
                x = np.full((len(p), 3), -1.0)
                x[good] = np.linalg.solve(system[good], (u - p)[good, :, None])[:, :, 0]
                hit = (x >= 0).all(axis=1) & (x[:, 0] + x[:, 1] <= 1) & (x[:, 2] <= 1)
                if one is two:
                    hit &= ~np.isin(two.faces, one.faces[i][[k, (k + 1) % 3]]).any(axis=1)
                pairs |= {(j, i) if swap else (i, j) for j in np.flatnonzero(hit).tolist()}
    return pairs


def as_set(pairs) -> set[tuple[int, int]]:
    return set(map(tuple, pairs.tolist()))


def found(a: Surface, b: Surface) -> set[tuple[int, int]]:
    result = piercings(a, b)
    return as_set(np.column_stack((result.edge, result.face)))


@pytest.mark.parametrize("seed", range(12))
def test_piercings_are_exact_where_everything_touches_everything(seed):
    # small integers: coplanar, degenerate, coincident and touching faces abound, and sums are exact
    rng = np.random.default_rng(seed)
    a, b = (Surface(rng.integers(0, 3 + seed, (40, 3)), rng.integers(0, 40, (70, 3))) for _ in range(2))
    edges, faces = exact(a, b)
    assert edges
    assert found(a, b) == edges
    assert as_set(crossings(a, b)) == faces | {(f, g) for g, f in exact(b, a)[1]}
    edges, faces = exact(a, a)
    assert found(a, a) == edges
    assert as_set(self_intersections(a)) == {tuple(sorted(pair)) for pair in faces}


@pytest.mark.parametrize("seed", range(4))
def test_crossings_of_random_triangles_of_all_sizes_match_brute_force(seed):
    rng = np.random.default_rng(seed)
    a = soup(rng, 10 ** rng.uniform(-3.0, 0.0, 150), sliver=(1.0, 300.0)[seed % 2])
    b = soup(rng, np.where(rng.random(120) < 0.3, 2.0, 0.05), sliver=(1.0, 50.0)[seed % 2])
    for one, two in ((a, b), (b, a)):
        assert as_set(crossings(one, two)) == solved_pairs(one, two)
    own = solved_pairs(b, b)
    assert own
    assert as_set(self_intersections(b)) == {tuple(sorted(pair)) for pair in own}


def test_a_sphere_pushed_through_itself_matches_brute_force():
    ball = sphere(2)
    # a little out of true, so that nothing meets exactly at a corner
    low = ball.vertices + np.random.default_rng(0).normal(0.0, 0.003, ball.vertices.shape)
    top = low[:, 2] > 0.6
    low[top, 2] -= 4.0 * (low[top, 2] - 0.6) ** 0.5  # the cap passes through the bottom
    folded = ball.moved(low)
    pairs = self_intersections(folded)
    assert len(pairs) > 10
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert as_set(pairs) == {tuple(sorted(pair)) for pair in solved_pairs(folded, folded)}


def test_one_common_corner_crosses_by_the_opposite_edge_only():
    points = np.array([[0, 0, 0], [2, -1, 0], [2, 1, 0], [1, 0, -1], [1, 0, 1], [2, 3, -1], [2, 3, 1]], float)
    through, beside = [0, 3, 4], [0, 5, 6]
    assert self_intersections(Surface(points, [[0, 1, 2], through])).tolist() == [[0, 1]]
    assert len(self_intersections(Surface(points, [[0, 1, 2], beside]))) == 0


def test_a_common_edge_is_no_crossing_even_folded_flat():
    points = [[0, 0, 0], [1, 0, 0], [0.3, 1, 0], [0.4, 0.8, 0], [0.5, 0.1, 1e-9]]
    assert len(self_intersections(Surface(points, [[0, 1, 2], [1, 0, 3], [1, 0, 4]]))) == 0


def test_crossing_curves_are_closed():
    # each crossing pair is a segment of the curve; each piercing joins the two segments of an edge's faces
    a, b = sphere(3), sphere(3, radius=0.9, centre=(0.5, 0.2, -0.3))
    one, two = piercings(a, b), piercings(b, a)
    pairs = crossings(a, b)
    assert len(pairs) == len(one.edge) + len(two.edge) > 50
    assert as_set(pairs) == as_set(crossings(b, a)[:, ::-1])


def test_piercings_lie_on_the_circle_where_two_spheres_meet():
    gap, radius = 1.2, 1.0
    a, b = sphere(4), sphere(4, centre=(gap, 0.01, 0.02))
    for one, two in ((a, b), (b, a)):
        result = piercings(one, two)
        at = result.points(one)
        assert ((result.t > 0) & (result.t < 1)).all()
        assert (np.diff(result.edge) >= 0).all()
        assert np.allclose(at[:, 0], gap / 2, atol=0.02)
        assert np.allclose(np.hypot(at[:, 1], at[:, 2]), np.sqrt(radius - gap**2 / 4), atol=0.02)
        # and exactly in the plane of the face
        face = two.corners[result.face]
        height = np.einsum("ij,ij->i", at - face[:, 0], two.face_normals[result.face])
        assert np.abs(height).max() < 1e-14


@pytest.mark.parametrize(
    "other",
    [
        sphere(2, radius=0.5),  # inside
        sphere(2, centre=(2.1, 0.0, 0.0)),  # outside
        sphere(2),  # the very same place
        Surface([[1, 0, 0], [2, 0, 0], [2, 1, 0]], [[0, 1, 2]]),  # touching with a corner
    ],
)
def test_apart_inside_and_touching_are_no_crossings(other):
    poles = sphere(2)
    assert len(crossings(poles, other)) == len(crossings(other, poles)) == 0


def test_bodies_in_contact_do_not_cross_but_pressed_in_they_do():
    base = box((4, 4, 1), 4)
    for shift, crossed in ((0.0, False), (1e-6, True)):
        upper = box((2, 2, 2), (3, 3, 2), low=(1.03, 1.01, 1.0 - shift))
        assert (len(crossings(base, upper)) > 0) == crossed


def test_contact_survives_rounding_of_the_coordinates():
    rng = np.random.default_rng(0)
    for _ in range(20):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        a, b = box((4, 4, 1), 4), box((2, 2, 2), (3, 3, 2), low=(1.03, 1.01, 1.0))
        shift = rng.normal(size=3) * 1000.0
        a, b = (body.moved(body.vertices @ turn + shift) for body in (a, b))
        assert len(crossings(a, b)) == 0


def test_an_edge_through_the_seam_of_two_faces_is_never_lost():
    rng = np.random.default_rng(1)
    for _ in range(300):
        a, b, c, d = rng.normal(size=(4, 3))
        share = rng.random()
        middle = share * a + (1 - share) * b  # on the common edge, up to rounding
        along = rng.normal(size=3)
        needle = Surface([middle - along, middle + along, middle + along + 1e-3], [[0, 1, 2]])
        sides = np.cross(b - a, c - a) @ along, np.cross(b - a, d - a) @ along
        seam = Surface([a, b, c, d], [[0, 1, 2], [1, 0, 3]])
        if sides[0] * sides[1] < 0:  # the two faces as seen along the needle, side by side
            assert (piercings(needle, seam).edge == 0).any()


def test_an_unmerged_soup_does_not_cross_itself():
    shape = bone(1000)
    loose = Surface(shape.corners.reshape(-1, 3), np.arange(3 * len(shape.faces)).reshape(-1, 3))
    assert len(self_intersections(shape)) == len(self_intersections(loose)) == 0


def test_the_order_of_faces_and_vertices_does_not_matter():
    rng = np.random.default_rng(2)
    a = soup(rng, np.full(100, 0.2))
    faces, vertices = rng.permutation(len(a.faces)), rng.permutation(len(a.vertices))
    place = np.argsort(vertices)
    shuffled = Surface(a.vertices[vertices], np.roll(place[a.faces[faces]], 1, axis=1)[:, ::-1])
    again = faces[self_intersections(shuffled)]
    assert as_set(np.sort(again, axis=1)) == as_set(self_intersections(a))


@pytest.mark.parametrize("seed", range(4))
def test_crossings_of_some_faces_are_those_of_all(seed):
    rng = np.random.default_rng(seed)
    a = soup(rng, np.where(rng.random(300) < 0.1, 1.0, 0.1), room=0.5)
    some = np.unique(rng.integers(0, 300, 25))
    whole = self_intersections(a)
    expected = whole[np.isin(whole, some).any(axis=1)]
    assert len(expected) > 20
    around = balls.size_classes(a, np.arange(300))
    np.testing.assert_array_equal(crossings_of(a, some, around), expected)
    # where the chosen ones were before does not matter
    corners = a.corners + np.isin(np.arange(300), some)[:, None, None] * rng.normal(size=(300, 1, 3))
    moved = Surface(corners.reshape(-1, 3), a.faces)
    whole = self_intersections(moved)
    np.testing.assert_array_equal(crossings_of(moved, some, around), whole[np.isin(whole, some).any(axis=1)])
    assert len(crossings_of(a, some[:0], around)) == len(crossings_of(sphere(1), np.arange(3), [])) == 0


def test_small_blocks_and_cut_up_faces_find_the_same(monkeypatch):
    rng = np.random.default_rng(3)
    a = soup(rng, np.where(rng.random(300) < 0.1, 1.0, 0.03), sliver=50.0)
    whole, pierced = self_intersections(a), piercings(a, a)
    monkeypatch.setattr(balls, "BLOCK_PAIRS", 200)
    assert np.array_equal(self_intersections(a), whole)
    assert np.array_equal(piercings(a, a).edge, pierced.edge)
    assert len(balls._pieces(a.corners, np.arange(300))[0]) > 600


def test_the_pieces_of_a_face_cover_it():
    rng = np.random.default_rng(4)
    a = soup(rng, np.where(rng.random(60) < 0.1, 5.0, 0.02), sliver=100.0)
    centre, radius, owner = balls._pieces(a.corners, np.arange(60))
    weights = rng.dirichlet(np.ones(3), 40)
    for face in range(60):
        at = weights @ a.corners[face]
        mine = owner == face
        apart = np.linalg.norm(at[:, None] - centre[mine], axis=2)
        assert (apart <= radius[mine] * (1 + 1e-12)).any(axis=1).all()


def candidates(a: Surface, b: Surface) -> int:
    return sum(len(f) for search in balls.searches(a, b) for f, _ in search.candidates())


def test_few_pairs_are_looked_at_whatever_the_grading():
    ball = sphere(5)
    m = len(ball.faces)
    assert candidates(ball, ball) < 12 * m
    # blown up about one pole by inversion: edges differ a thousandfold
    x, y, z = ball.vertices.T * 0.9999
    plane = np.column_stack((x, y)) / (1.0 - z)[:, None] * 0.03
    square = np.sum(plane**2, axis=1)
    graded = ball.moved(np.column_stack((2 * plane, square - 1)) / (1 + square)[:, None])
    length = np.linalg.norm(np.diff(graded.vertices[graded.edges], axis=1)[:, 0], axis=1)
    assert length.max() / length.min() > 800
    assert candidates(graded, graded) < 60 * m
    assert len(self_intersections(graded)) == 0
    # and only where two bodies may meet
    assert candidates(ball, sphere(5, centre=(1.9, 0, 0))) < m
    assert candidates(ball, sphere(5, centre=(2.1, 0, 0))) == 0


@pytest.mark.parametrize(
    "surface",
    [
        Surface(np.empty((0, 3)), np.empty((0, 3))),
        Surface(np.zeros((3, 3)), np.empty((0, 3))),
        Surface(np.zeros((3, 3)), [[0, 1, 2], [0, 1, 1]]),
        Surface([[0, 0, 0], [1, 0, 0], [3, 0, 0]], [[0, 1, 2], [0, 0, 2]]),
    ],
)
def test_nothing_and_the_degenerate_cross_nothing(surface):
    ball = sphere(1)
    for pairs in (self_intersections(surface), crossings(surface, surface)):
        assert pairs.shape == (0, 2)
        assert pairs.dtype == np.int32
    result = piercings(ball, surface)
    assert result.edge.shape == result.face.shape == result.t.shape == (0,)
    assert result.points(ball).shape == (0, 3)
    assert len(crossings(surface, ball)) == len(crossings(ball, surface)) == 0


def test_a_search_for_crossings_may_be_cancelled():
    def cancelling(_fraction, _text):
        raise Cancelled

    with pytest.raises(Cancelled):
        self_intersections(sphere(3), cancelling)
