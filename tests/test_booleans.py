# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes that two shapes share, and in which they differ: by another library, and by hand."""

from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest

from femors_addon import booleans, common
from femors_addon.bodies import Body
from femors_addon.crew import crew
from femors_addon.limits import Limits
from femors_addon.mesh import Surface
from femors_addon.overclosure import remove_overclosure
from femors_addon.shapes import sphere

BALL = sphere(4, radius=10.0)
POLES = {"one": [(0, 0, 1)], "two": [(0, 0, 1), (0, 0, -1)], "near": [(0, 0, 1), (0.1, 0.3, 0.9)]}


def dented(
    ball: Surface, *poles: tuple[float, float, float], depth: float = 0.5, wide: float = 3.0
) -> Surface:
    """Push a ball in at some places, and out in the middle of each dent."""
    vertices = ball.vertices.copy()
    for pole in poles:
        far = np.linalg.norm(ball.vertices - np.array(pole) * 10.0, axis=1) / wide
        step = np.where(far < 1.0, (1.0 - far**2) ** 2 * (6.0 * far**2 - 1.0), 0.0)
        vertices -= depth * step[:, None] * ball.vertices / 10.0
    return ball.moved(vertices)


def box(*size: float, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Surface:
    """A box with two triangles a side and its lowest corner somewhere."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))]
    return Surface(corners * size + at, np.array(faces))


def both(*surfaces: Surface) -> Surface:
    """Several surfaces as one."""
    start = np.cumsum([0] + [len(s.vertices) for s in surfaces])
    return Surface(
        np.concatenate([s.vertices for s in surfaces]),
        np.concatenate([s.faces + n for s, n in zip(surfaces, start, strict=False)]),
    )


def turned(surface: Surface) -> Surface:
    """Inside out."""
    return Surface(surface.vertices, surface.faces[:, ::-1])


def holed(surface: Surface, first: int = 0, count: int = 5) -> Surface:
    """Some faces taken out."""
    return Surface(surface.vertices, np.delete(surface.faces, np.arange(first, first + count), axis=0))


def by_library(one: Surface, two: Surface) -> float:
    """The volume shared, by manifold3d."""
    library = pytest.importorskip("manifold3d")
    a, b = (
        library.Manifold(library.Mesh64(np.array(s.vertices), s.faces.astype(np.uint64))) for s in (one, two)
    )
    return float((a ^ b).volume())


def xor_by_library(one: Surface, two: Surface) -> float:
    """The volume in one of the two only."""
    return one.volume + two.volume - 2.0 * by_library(one, two)


# --- as the library has it ------------------------------------------------------------------------------
@pytest.mark.parametrize("poles", POLES.values(), ids=POLES)
def test_a_patch_differs_as_the_whole_does(poles):
    new = dented(BALL, *poles)
    assert booleans.xor_volume(BALL, new) == pytest.approx(xor_by_library(BALL, new), rel=1e-9)
    assert booleans.xor_volume(BALL, BALL.moved(BALL.vertices)) == 0.0


@pytest.mark.parametrize("by", [(0.3, 0.0, 0.0), (7.0, 1.0, -2.0), (1e-6, 2e-6, 1e-6)])
def test_a_whole_body_that_moves_differs_as_by_the_library(by):
    new = BALL.moved(BALL.vertices + by)
    assert booleans.xor_volume(BALL, new) == pytest.approx(xor_by_library(BALL, new), rel=1e-8)
    assert booleans.shared_volume(BALL, new) == pytest.approx(by_library(BALL, new), rel=1e-11)


@pytest.mark.parametrize("seed", range(5))
def test_noise_all_over_differs_as_by_the_library(seed):
    """Thousands of small dents in and out, and nodes in line with faces that stay."""
    random = np.random.default_rng(seed)
    chosen = random.random(len(BALL.vertices)) < 0.4
    new = BALL.moved(BALL.vertices + chosen[:, None] * random.normal(0.0, 0.02, BALL.vertices.shape))
    assert booleans.xor_volume(BALL, new) == pytest.approx(xor_by_library(BALL, new), rel=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_turned_bodies_share_as_by_the_library(seed):
    random = np.random.default_rng(seed)
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    long = BALL.moved(BALL.vertices * [1.0, 0.5, 0.3])
    other = long.moved(long.vertices @ turn.T + random.uniform(-3.0, 3.0, 3))
    assert booleans.shared_volume(long, other) == pytest.approx(by_library(long, other), rel=1e-11)


def test_large_faces_against_small_ones_share_as_by_the_library():
    """Large faces are cut in pieces for the search, and so meet others several times."""
    beam = box(100.0, 3.0, 0.4, at=(-40.0, -1.3, -0.1))
    assert booleans.shared_volume(beam, BALL) == pytest.approx(by_library(beam, BALL), rel=1e-9)
    many = both(beam, sphere(3, radius=1.0, centre=(0.0, 0.0, 9.5)))  # mostly small: a large one is in pieces
    assert booleans.shared_volume(BALL, many) == pytest.approx(by_library(BALL, many), rel=1e-9)


def test_a_dent_that_comes_out_behind_differs_as_by_the_library():
    plate = sphere(4).moved(sphere(4).vertices * [10.0, 10.0, 0.1])
    near = np.exp(-(np.linalg.norm(plate.vertices[:, :2], axis=1) ** 2) / 4.0)
    near[(near < 0.01) | (plate.vertices[:, 2] < 0)] = 0.0
    new = plate.moved(plate.vertices - np.outer(near, [0.0, 0.0, 0.15]))
    assert booleans.xor_volume(plate, new) == pytest.approx(xor_by_library(plate, new), rel=1e-9)


# --- by hand --------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("at", "shared"),
    [
        ((1.0, 1.0, 1.0), 1.0),  # a corner, edges in faces
        ((0.0, 0.0, 0.0), 8.0),  # the very same
        ((0.0, 0.0, 1.0), 4.0),  # sides in one plane
        ((2.0, 0.0, 0.0), 0.0),  # a side on a side
        ((2.0, 2.0, 0.0), 0.0),  # an edge on an edge
        ((2.0, 2.0, 2.0), 0.0),  # a corner on a corner
        ((5.0, 0.0, 0.0), 0.0),
    ],
)
def test_boxes_that_touch(at, shared):
    one, two = box(2.0, 2.0, 2.0), box(2.0, 2.0, 2.0, at=at)
    found = booleans.shared_volume(one, two)
    assert found == pytest.approx(shared, abs=1e-11)
    assert shared or found == 0.0
    assert booleans.xor_volume(one, two) == pytest.approx(16.0 - 2.0 * shared, abs=1e-11)


def test_one_inside_the_other_and_a_cavity():
    outer, inner = box(4.0, 4.0, 4.0), box(1.0, 1.0, 1.0, at=(1.3, 1.4, 1.2))
    hollow = both(outer, turned(box(2.0, 2.0, 2.0, at=(1.0, 1.0, 1.0))))
    assert booleans.shared_volume(outer, inner) == pytest.approx(1.0, rel=1e-11)
    assert booleans.shared_volume(hollow, inner) == pytest.approx(0.0, abs=1e-11)
    assert booleans.shared_volume(hollow, outer) == pytest.approx(56.0, rel=1e-11)
    several = both(inner, box(1.0, 1.0, 1.0, at=(3.5, 0.0, 0.0)), box(1.0, 1.0, 1.0, at=(9.0, 0.0, 0.0)))
    assert booleans.shared_volume(outer, several) == pytest.approx(1.5, rel=1e-11)


@pytest.mark.parametrize("far", [1.0, 1e3])
def test_a_corner_of_a_box_that_is_drawn_out(far):
    one = box(2.0, 2.0, 2.0, at=(far, 0.0, 0.0))
    for corner, by in ((7, 1.0), (0, -0.5), (0, 0.5)):
        vertices = one.vertices.copy()
        vertices[corner] += by * np.ones(3)
        new = one.moved(vertices)
        assert booleans.xor_volume(one, new) == pytest.approx(abs(new.volume - one.volume), rel=1e-9 * far)


def test_what_lies_behind_a_thin_body_is_not_shared():
    """The part that reaches into the box is taken for what it is."""
    fine = sphere(5)
    plate = fine.moved(fine.vertices * [10.0, 10.0, 0.1])
    above = sphere(4, radius=0.4, centre=(0.3, 0.2, 0.45))
    two = both(above, sphere(2, radius=0.05, centre=(0.3, 0.2, -0.3)))
    whole = booleans.shared_volume(plate, two)
    assert whole == pytest.approx(booleans.shared_volume(plate, above), rel=1e-9)
    assert booleans.shared_volume(plate, two, above.bounds) == pytest.approx(whole, rel=1e-9)
    assert whole == pytest.approx(by_library(plate, two), rel=1e-9)


# --- what is known of others ----------------------------------------------------------------------------
def test_bodies_inside_out_or_open_have_none():
    two = BALL.moved(BALL.vertices + [3.0, 0.0, 0.0])
    assert booleans.shared_volume(turned(BALL), two) is None
    assert booleans.shared_volume(BALL, turned(two)) is None
    across = int(np.argmax(BALL.vertices[BALL.faces].mean(axis=1)[:, 0]))  # in the other
    assert booleans.shared_volume(holed(BALL, across), two) is None
    for one, other in ((turned(BALL), two), (BALL, turned(two)), (turned(BALL), turned(two))):
        assert booleans.xor_volume(one, other) is None
    assert booleans.xor_volume(holed(BALL), two) is None
    assert booleans.xor_volume(turned(BALL), turned(dented(BALL, (0, 0, 1)))) is None
    mirrored = BALL.moved(BALL.vertices * [-1.0, 1.0, 1.0] + [3.0, 0.0, 0.0])
    assert booleans.xor_volume(BALL, mirrored) is None


def test_a_hole_that_stays_is_no_difference():
    new = dented(BALL, (0, 0, 1))
    assert np.abs(BALL.vertices[BALL.faces[:5]] - [0, 0, 10]).max() > 3.0
    closed = booleans.xor_volume(BALL, new)
    one = holed(BALL)
    assert booleans.xor_volume(one, one.moved(new.vertices)) == pytest.approx(closed, rel=1e-9)


# --- the work -------------------------------------------------------------------------------------------
def test_only_what_is_near_is_looked_at(monkeypatch):
    """Faces that are cut out, and pairs of them whose sides are tested: they do not grow with the body."""
    seen, pairs = [], []
    of, segments = common._Part.of.__func__, common._segments
    monkeypatch.setattr(
        common._Part,
        "of",
        classmethod(lambda cls, s, chosen, *rest: seen.append(chosen.sum()) or of(cls, s, chosen, *rest)),
    )
    monkeypatch.setattr(common, "_segments", lambda *given: pairs.append(len(given[1])) or segments(*given))
    booleans.xor_volume(BALL, dented(BALL, (0, 0, 1)))
    assert 0 < sum(pairs) < 0.1 * len(BALL.faces)
    assert 0 < max(seen) < 0.1 * len(BALL.faces)
    seen.clear()
    small = sphere(3, centre=(0.0, 0.0, 10.5))
    assert booleans.shared_volume(BALL, small, small.bounds) > 0.0
    assert 0 < min(seen) < 0.05 * len(BALL.faces)


def test_a_removal_asks_no_library(monkeypatch):
    """The window waits while manifold3d works, so it is for tests only."""
    monkeypatch.setitem(sys.modules, "manifold3d", None)
    with pytest.raises(ImportError):
        importlib.import_module("manifold3d")
    bodies = [Body("one", sphere(2)), Body("two", sphere(2, centre=(1.8, 0.0, 0.0)))]
    result = remove_overclosure(bodies)
    assert result.before[0].shared is not None and result.before[0].shared > 0
    assert all(body.xor is not None and body.xor > 0 for body in result.bodies)


def test_the_bits_do_not_depend_on_threads(monkeypatch):
    new = BALL.moved(BALL.vertices + [0.01, 0.02, 0.03])
    once = booleans.xor_volume(BALL, new), booleans.shared_volume(BALL, new)
    monkeypatch.setattr(Limits, "threads", 3)
    with crew():
        assert (booleans.xor_volume(BALL, new), booleans.shared_volume(BALL, new)) == once
    assert (booleans.xor_volume(BALL, new), booleans.shared_volume(BALL, new)) == once


def test_signs_are_exact_where_rounding_decides():
    """A point in a plane, moved by the last bit of a coordinate."""
    corners = np.array([[[12.0, 12.0, 12.0], [24.0, 24.0, 24.0], [0.5, 0.5, 7.0]]])
    for step, sign in ((-1, -1), (0, 0), (1, 1)):
        y = 0.5 + step * 2.0**-53 if step < 0 else 0.5 + step * 2.0**-53 * 2
        found = common._over(corners, np.array([[0.5, y, 0.5]]))
        turn = common._over(corners, np.array([[0.5, 1.5, 0.5]]))
        assert np.sign(found[0]) == sign * np.sign(turn[0])
