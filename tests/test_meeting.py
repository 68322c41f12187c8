# SPDX-License-Identifier: GPL-3.0-or-later
"""Edges that pierce are those of a search built anew, however bodies have moved; rays meet what is there."""

from __future__ import annotations

import numpy as np
import pytest

from femors_addon import meeting
from femors_addon.bodies import Body, Solid
from femors_addon.cutouts import normals_at
from femors_addon.intersect import piercings
from femors_addon.meeting import Meeting
from femors_addon.mesh import Surface
from femors_addon.rays import first_hits
from femors_addon.shapes import sphere


def balls(depth: float, levels: tuple[int, int] = (3, 3)) -> tuple[Solid, Solid]:
    one = sphere(levels[0], radius=10.0)
    two = sphere(levels[1], radius=8.0, centre=((18.0 - depth) * 0.6, (18.0 - depth) * 0.8, 0.3))
    return Solid(Body("one", one), 0.5), Solid(Body("two", two), 0.5)


def lower_bound(body: Solid, other: Solid) -> np.ndarray:
    """No vertex is nearer to the other ball than this."""
    middle = other.vertices.mean(axis=0)
    return (
        np.linalg.norm(body.vertices - middle, axis=1) - np.linalg.norm(other.vertices - middle, axis=1).max()
    )


def expected(one: Surface, two: Surface) -> tuple[np.ndarray, np.ndarray]:
    found = piercings(one, two)
    return one.edges[found.edge], found.t


@pytest.mark.parametrize(("depth", "levels"), [(0.6, (3, 3)), (0.3, (4, 2)), (-3.0, (3, 3))])
def test_edges_that_pierce_are_those_of_a_new_search(depth, levels, monkeypatch):
    one, two = balls(depth, levels)
    met = Meeting(one, two)
    searches = []
    search = meeting.Meeting._search
    monkeypatch.setattr(meeting.Meeting, "_search", lambda *a: searches.append(1) or search(*a))
    random = np.random.default_rng(3)
    for number in range(12):
        shift = np.array([0.01 * number, 0.0, 0.0])
        found = met.pierced((shift, np.zeros(3)), (lower_bound(one, two), lower_bound(two, one)))
        surfaces = one.surface.moved(one.vertices + shift), two.surface
        for got, (a, b) in zip(found, (surfaces, surfaces[::-1]), strict=True):
            ends, t = expected(a, b)
            np.testing.assert_array_equal(got.ends, ends)
            np.testing.assert_array_equal(got.t, t)
        assert len(found[0].t) > 0 or depth < 0
        for solid, size in ((one, 0.02), (two, 0.01)):
            step = size * random.normal(size=solid.points.shape)
            solid.move(np.arange(len(solid.points)), step)
    assert 1 <= len(searches) < 8  # remembered for a while, and not for ever
    met.forget()
    met.pierced((np.zeros(3), np.zeros(3)), (lower_bound(one, two), lower_bound(two, one)))
    assert len(searches) >= 2


def test_rays_meet_the_first_face_on_their_way():
    ball = sphere(4, radius=10.0)
    start = np.array([[0.0, 0.0, 0.0], [0.1, 0.2, 0.0], [20.0, 1.0, 0.0], [20.0, 0.0, 0.0], [0.0, 0.0, 40.0]])
    way = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    far = first_hits(start, way, 25.0, ball)
    assert far[:2] == pytest.approx([10.0, np.sqrt(100 - 0.04) - 0.1], rel=0.003)
    assert far[2] == pytest.approx(20.0 - np.sqrt(99.0), rel=0.003)  # not the far side
    assert np.isinf(far[3:]).all()  # the one leads away, the other is too short


def test_rays_through_corners_and_edges_slip_through_nowhere():
    ball = sphere(2, radius=10.0)
    middles = 0.5 * (ball.vertices[ball.edges[:, 0]] + ball.vertices[ball.edges[:, 1]])
    goals = np.concatenate((ball.vertices, middles))
    length = np.linalg.norm(goals, axis=1)
    far = first_hits(np.zeros_like(goals), goals / length[:, None], 20.0, ball)
    assert far == pytest.approx(length, rel=1e-9)


def test_normals_at_some_vertices_are_those_of_the_whole():
    ball = sphere(3, radius=10.0, centre=(1.0, 2.0, 3.0))
    rows = np.array([5, 17, 600, 3])
    np.testing.assert_array_equal(normals_at(ball, np.sort(rows)), ball.vertex_normals[np.sort(rows)])
    np.testing.assert_array_equal(normals_at(ball, rows), ball.vertex_normals[rows])


def test_bodies_that_were_apart_are_searched_again():
    one = Solid(Body("one", sphere(3)), 0.5)
    two = Solid(Body("two", sphere(3, centre=(2.6, 0.0, 0.0))), 0.5)
    met, still = Meeting(one, two), (np.zeros(3), np.zeros(3))

    def pierced() -> list[int]:
        found = met.pierced(still, (lower_bound(one, two), lower_bound(two, one)))
        return [len(edges.t) for edges in found]

    assert pierced() == [0, 0]
    two.put(two.points - [0.9, 0.0, 0.0])
    counts = pierced()
    assert counts == [
        len(expected(*pair)[1]) for pair in ((one.surface, two.surface), (two.surface, one.surface))
    ]
    assert min(counts) > 10
