# SPDX-License-Identifier: GPL-3.0-or-later
"""Folded, crossing and squeezed faces: their nodes are spread out anew, on the target, and no others."""

import numpy as np
import pytest
from foldcases import pulled, whole

from femors_addon import faults, mend, relax, stepback
from femors_addon import morph as morphing
from femors_addon.faults import Judge
from femors_addon.folds import Reference, bad_faces
from femors_addon.intersect import self_intersections
from femors_addon.mend import FARTHEST, REACH, mended
from femors_addon.mesh import Surface
from femors_addon.morph_settings import MorphSettings
from femors_addon.nearest import SurfaceIndex
from femors_addon.patches import Part, faces_at
from femors_addon.progress import Cancelled
from femors_addon.quality import aspect_ratio, flipped_faces
from femors_addon.shapes import sphere
from femors_addon.stepback import step_back


@pytest.fixture
def ball():
    return sphere(3)


def test_nothing_is_done_where_nothing_is_bad(ball):
    displacement = 0.1 * ball.vertices
    after, left = mended(ball, Reference(ball), displacement, SurfaceIndex(ball), None, MorphSettings())
    assert after is displacement and left == 0


def test_a_folded_face_is_laid_out_on_the_target(ball):
    node, displacement = pulled(ball)
    assert len(flipped_faces(ball, ball.moved(ball.vertices + displacement)))
    after, left = mended(ball, Reference(ball), displacement, SurfaceIndex(ball), None, MorphSettings())
    moved = ball.moved(ball.vertices + after)
    assert left == 0
    assert not len(flipped_faces(ball, moved)) and not len(self_intersections(moved))
    touched = np.flatnonzero(np.abs(after - displacement).max(axis=1) > 0)
    away = np.linalg.norm(ball.vertices[touched] - ball.vertices[node], axis=1)
    assert len(touched) and away.max() < 6 * ball.mean_edge
    assert SurfaceIndex(ball).closest(moved.vertices[touched]).distance.max() < 1e-9


def test_a_squeezed_face_gets_its_room_back(ball):
    _, displacement = pulled(ball, 0.98)
    assert not len(flipped_faces(ball, ball.moved(ball.vertices + displacement)))
    after, left = mended(ball, Reference(ball), displacement, SurfaceIndex(ball), None, MorphSettings())
    assert left == 0
    assert aspect_ratio(ball.moved(ball.vertices + displacement)).max() > 20
    assert aspect_ratio(ball.moved(ball.vertices + after)).max() < 10


def test_where_nodes_are_not_to_lie_on_the_target_nothing_is_laid_on_it(ball):
    _, displacement = pulled(ball)
    off = MorphSettings(projection=0.0)
    after, left = mended(ball, Reference(ball), displacement, SurfaceIndex(ball), None, off, left=range(5))
    assert after is displacement and left == 5


def test_mending_can_be_cancelled(ball):
    _, displacement = pulled(ball)

    def cancel(fraction, text):
        raise Cancelled

    with pytest.raises(Cancelled):
        mended(ball, Reference(ball), displacement, SurfaceIndex(ball), None, MorphSettings(), cancel)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_told_around_moved_nodes_is_what_is_told_of_all(seed):
    rng = np.random.default_rng(seed)
    fine = sphere(4)
    rough = fine.vertices + 0.4 * fine.mean_edge * rng.normal(size=fine.vertices.shape)
    judge = Judge(fine, Reference(fine), whole(fine))
    before = judge.state(rough, np.arange(len(fine.faces)))
    after = rough.copy()
    nodes = rng.integers(0, len(rough), 30)
    after[nodes] += 3.0 * fine.mean_edge * rng.normal(size=(30, 3))
    got, all_of_it = judge.after(before, after), judge.state(after, np.arange(len(fine.faces)))
    assert len(all_of_it.pairs) > len(before.pairs) / 2
    assert {*map(tuple, got.pairs)} == {*map(tuple, all_of_it.pairs)}
    assert len(got.pairs) == len(all_of_it.pairs)
    assert {0.0, faults.SQUEEZED, 1.0} == {*all_of_it.bad}
    np.testing.assert_array_equal(got.own, all_of_it.own)
    np.testing.assert_array_equal(got.bad, all_of_it.bad)
    back = judge.after(got, rough)  # and it is as well known as what was told of all
    np.testing.assert_array_equal(back.bad, before.bad)


def test_a_component_that_is_turned_inside_out_is_told_though_few_nodes_move():
    one, two = sphere(1), sphere(1, centre=(3.0, 0.0, 0.0))
    both = Surface(np.concatenate((one.vertices, two.vertices)), np.concatenate((one.faces, two.faces + 42)))
    judge = Judge(both, Reference(both), whole(both))
    turned = both.vertices.copy()
    turned[42:, 2] *= -1
    before = judge.state(both.vertices, [])
    assert not before.bad.any()
    got = judge.after(before, turned)
    assert set(np.flatnonzero(got.bad)) == set(range(80, 160))
    np.testing.assert_array_equal(judge.state(turned, []).bad, got.bad)
    assert not judge.after(got, both.vertices).bad.any()


def test_faces_at_nodes_are_those_of_a_search(ball):
    nodes = np.array([[5, 7], [5, 300]])
    expected = np.flatnonzero(np.isin(ball.faces, nodes).any(axis=1))
    np.testing.assert_array_equal(faces_at(ball, nodes), expected)
    assert not len(faces_at(ball, nodes[:0]))


def _looked_at(monkeypatch, ball):
    """How many faces are judged, and pairs of them tested, where a fold is mended by stepping back."""
    _, displacement = pulled(ball, 1.4)
    judge = Judge(ball, Reference(ball), whole(ball))
    state = judge.state(ball.vertices + displacement, np.arange(len(ball.faces)))
    assert len(state.worst)
    count = {"faces": 0, "crossing": 0}
    own, crossing = Judge._own, faults.crossings_of

    def counted_own(self, moved, rows):
        count["faces"] += len(moved.faces)
        return own(self, moved, rows)

    def counted_crossing(surface, some, balls):
        count["crossing"] += len(some)
        return crossing(surface, some, balls)

    monkeypatch.setattr(Judge, "_own", counted_own)
    monkeypatch.setattr(faults, "crossings_of", counted_crossing)
    after = step_back(judge, state, SurfaceIndex(ball), MorphSettings())
    monkeypatch.undo()
    assert not len(after.worst)
    return count


def test_faces_looked_at_grow_with_what_is_bad_and_not_with_the_part(monkeypatch):
    small, large = (_looked_at(monkeypatch, sphere(halvings)) for halvings in (4, 5))
    for what, count in large.items():
        assert 0 < count < 1.3 * small[what], (what, small, large)  # of four times the faces


def test_a_part_of_a_large_mesh_is_mended_as_the_whole_is(monkeypatch):
    """Folds told, and crossings looked for, near by only; a sheet close behind belongs to it."""
    outer, inner = sphere(5), sphere(5, radius=0.98)
    both = Surface(
        np.concatenate((outer.vertices, inner.vertices)),
        np.concatenate((outer.faces, inner.faces[:, ::-1] + len(outer.vertices))),
    )
    node = 1000
    displacement = np.zeros_like(both.vertices)
    aside = np.cross(both.vertices[node], [0.3, 0.2, 0.9])
    displacement[node] = 2.0 * both.mean_edge * aside / np.linalg.norm(aside)
    displacement[node] -= 0.04 * both.vertices[node]  # aside, and through the inner sheet
    moved = both.moved(both.vertices + displacement)
    bad = bad_faces(Reference(both), moved)
    assert len(bad) > 5 and bad.max() >= len(outer.faces)
    part = Part.around(bad, moved, np.ones(len(both.vertices), bool), REACH, FARTHEST * moved.mean_edge)
    assert len(part.faces) < 0.4 * len(both.faces)
    assert (part.faces >= len(outer.faces)).any()
    target = SurfaceIndex(both)
    near = mended(both, Reference(both), displacement, target, None, MorphSettings(), left=bad)
    monkeypatch.setattr("femors_addon.mend.REACH", 10 * REACH)
    far = mended(both, Reference(both), displacement, target, None, MorphSettings(), left=bad)
    np.testing.assert_array_equal(near[0], far[0])
    assert near[1] == far[1]


def test_nodes_that_may_not_move_stay(ball):
    node, displacement = pulled(ball, 1.3)
    free = np.zeros(len(ball.vertices))
    free[node] = 1.0
    after, left = mended(ball, Reference(ball), displacement, SurfaceIndex(ball), free, MorphSettings())
    assert left == 0
    assert set(np.flatnonzero(np.abs(after - displacement).max(axis=1) > 0)) == {node}
    after, left = mended(
        ball,
        Reference(ball),
        displacement,
        SurfaceIndex(ball),
        np.zeros(len(ball.vertices)),
        MorphSettings(),
        left=[0],
    )
    np.testing.assert_array_equal(after, displacement)
    assert left > 0  # and it is said that they are bad


def test_as_the_last_resort_nodes_go_farther(ball, monkeypatch):
    _, displacement = pulled(ball, 5.0)

    def left():
        after, bad = mended(ball, Reference(ball), displacement, SurfaceIndex(ball), None, MorphSettings())
        moved = ball.moved(ball.vertices + after)
        assert (bad > 0) == (len(bad_faces(Reference(ball), moved)) > 0)
        return bad

    assert left() > 0  # five edges are much of so coarse a ball
    monkeypatch.setattr("femors_addon.mend.LOSS", 0.3)
    assert left() == 0


def blade(halvings, thickness, turn, bend):
    """A thin plate with a lobed outline, bent, with a ridge on one side, as a shoulder blade has."""
    ball = sphere(halvings)
    x, y, z = ball.vertices.T
    lobes = 1 + 0.25 * np.cos(3 * np.arctan2(y, x) + turn) * (1 - z**2)
    x, y, z = x * lobes, 0.7 * y * lobes, thickness * z
    z = z + bend * x**2 + 0.3 * bend * np.sin(3 * y)
    ridge = (z > bend * x**2) & (np.abs(y) < 0.5)
    return Surface(np.column_stack((x, y, z + 0.2 * np.exp(-((x - 0.3) ** 2) / 0.02) * ridge)), ball.faces)


def test_thin_plates_of_other_shape_fold_far_less(monkeypatch):
    source, target = blade(3, 0.03, 0.0, 0.5), blade(3, 0.03, 2.0, -0.5)

    def bad():
        after = morphing.morph(source, target).after
        return after.flipped + after.self_intersecting

    with_it = bad()
    monkeypatch.setattr(morphing, "mended", lambda rest, aligned, displacement, *_: (displacement, 1))
    without = bad()
    assert with_it < 0.5 * without, (with_it, without)  # 8 against 135


def test_thin_plates_that_cannot_be_laid_out_anew_step_back(monkeypatch):
    source, target = blade(3, 0.03, 0.0, 0.5), blade(3, 0.03, 2.0, -0.5)

    def bad():
        after = morphing.morph(source, target).after
        return after.flipped + after.self_intersecting

    with_it = bad()
    monkeypatch.setattr(mend, "step_back", lambda judge, state, *_: state)
    without = bad()
    assert with_it < 0.3 * without, (with_it, without)  # 8 against 119


def test_plates_that_are_laid_down_without_pleats_have_less_to_mend(monkeypatch):
    """Crossing faces begin as pleats, which each step may keep from coming up at all."""
    source, target = blade(3, 0.025, 2.0, 0.3), blade(3, 0.04, 1.0, 0.1)
    monkeypatch.setattr(morphing, "mended", lambda rest, aligned, displacement, *_: (displacement, 1))

    def bad():
        after = morphing.morph(source, target).after
        return after.flipped + after.self_intersecting

    with_it = bad()
    monkeypatch.setattr(relax, "BEND", -2.0)
    without = bad()
    assert with_it < 0.1 * without, (with_it, without)  # 0 against 72


@pytest.mark.parametrize("many", [0, 10**6])
def test_where_spreading_out_helps_hardly_any_the_last_resort_alone_is_tried(ball, monkeypatch, many):
    """Meshes that cross themselves all over are mended by it as well, and sooner."""
    rng = np.random.default_rng(3)
    displacement = 0.2 * rng.normal(size=ball.vertices.shape)
    limits: list[float] = []

    def spread(judge, state, *_):
        limits.append(0.0)
        return state

    def back(judge, state, *_):
        limits.append(judge.part.far)
        return state

    monkeypatch.setattr(mend, "spread_out", spread)
    monkeypatch.setattr(mend, "step_back", back)
    monkeypatch.setattr(mend, "LOSS", 10.0)
    monkeypatch.setattr(stepback, "MANY", many)
    mended(ball, Reference(ball), displacement, SurfaceIndex(ball), None, MorphSettings())
    edge = ball.moved(ball.vertices + displacement).mean_edge
    far, farther = FARTHEST * edge, mend.FARTHER * edge
    assert limits == pytest.approx([0.0, farther] if many == 0 else [0.0, 0.0, far, farther])
