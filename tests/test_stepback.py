# SPDX-License-Identifier: GPL-3.0-or-later
"""What cannot be laid out on the target steps back from it, and returns as far as it may."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from foldcases import pulled, whole

from femors_addon import stepback
from femors_addon.faults import SQUEEZED, Judge
from femors_addon.folds import Reference
from femors_addon.intersect import self_intersections
from femors_addon.mend import FARTHEST
from femors_addon.morph_settings import MorphSettings
from femors_addon.nearest import SurfaceIndex
from femors_addon.progress import Cancelled
from femors_addon.quality import flipped_faces
from femors_addon.shapes import sphere
from femors_addon.stepback import step_back


@pytest.fixture
def ball():
    return sphere(3)


def _judged(ball, positions):
    """A judge of all of a ball, and what is bad at some positions."""
    judge = Judge(ball, Reference(ball), whole(ball))
    return judge, judge.state(positions, np.arange(len(ball.faces)))


def test_what_cannot_be_laid_out_steps_back_and_returns_as_far_as_it_may(ball):
    positions = ball.vertices + pulled(ball, 1.4)[1]
    judge, state = _judged(ball, positions)
    assert len(state.worst)
    after = step_back(judge, state, SurfaceIndex(ball), MorphSettings())
    assert not len(after.worst)
    assert not len(flipped_faces(ball, after.surface)) and not len(self_intersections(after.surface))
    step = np.linalg.norm(after.positions - positions, axis=1)
    assert 0 < step.max() <= FARTHEST * ball.mean_edge
    # half-way steps, one after the other: what is left is small beside an edge
    assert SurfaceIndex(ball).closest(after.positions).distance.max() < 0.05 * ball.mean_edge


def test_patches_that_would_step_back_too_far_stay(ball):
    judge, state = _judged(ball, ball.vertices + pulled(ball, 6.0)[1])
    after = step_back(judge, state, SurfaceIndex(ball), MorphSettings())
    np.testing.assert_array_equal(after.positions, state.positions)
    np.testing.assert_array_equal(after.bad, state.bad)


def test_a_face_on_its_back_is_turned_over_and_nothing_else_moves(ball):
    """Three neighbours far larger than it: patches evened out or moved back are of no use there."""
    face = 300
    corners = ball.faces[face]
    displacement = np.zeros_like(ball.vertices)
    here = ball.vertices[corners]
    across = np.cross(ball.face_normals[face], here[1] - here[0])
    across /= np.linalg.norm(across)
    middle = here.mean(axis=0)
    displacement[corners] = -1.1 * ((here - middle) @ across)[:, None] * across
    positions = ball.vertices + displacement
    assert list(flipped_faces(ball, ball.moved(positions))) == [face]
    judge, state = _judged(ball, positions)
    after = step_back(judge, state, SurfaceIndex(ball), MorphSettings())
    assert not len(after.worst)
    assert not len(flipped_faces(ball, after.surface))
    step = np.linalg.norm(after.positions - positions, axis=1)
    assert set(np.flatnonzero(step)) <= set(corners) and step.max() < 0.5 * ball.mean_edge


def test_a_squeezed_face_that_is_squeezed_more_is_worse_off(ball):
    """On the way back to the target, that is; `bad` alone does not tell."""
    judge, state = _judged(ball, ball.vertices + pulled(ball, 0.97)[1])
    squeezed = np.flatnonzero(state.bad == SQUEEZED)
    more = judge.after(state, ball.vertices + pulled(ball, 0.98)[1])
    assert len(squeezed)
    np.testing.assert_array_equal(more.bad, state.bad)
    assert set(stepback._worse(state, more)) == set(squeezed)
    assert not len(stepback._worse(more, state)) and not len(stepback._worse(state, state))


def test_places_far_from_each_other_take_ways_of_their_own(ball, monkeypatch):
    """Of two ways each mends one of two places: both places are well in the first round."""
    nodes = np.array([200, int(np.argmin(ball.vertices @ ball.vertices[200]))])
    others = [ball.adjacency[node].indices[0] for node in nodes]
    positions = ball.vertices.copy()
    positions[nodes] += 1.4 * (ball.vertices[others] - ball.vertices[nodes])
    judge, state = _judged(ball, positions)
    asked = []

    def two(judge, state, places, mean):
        for node in nodes:
            asked.append(node)
            trial = state.positions.copy()
            trial[node] = ball.vertices[node]
            yield trial

    monkeypatch.setattr(stepback, "_ways", two)
    monkeypatch.setattr(stepback, "BACK", (1,))
    after = step_back(judge, state, SurfaceIndex(ball), MorphSettings())
    assert len(state.worst) > 2 and not len(after.worst)
    assert asked == list(nodes)


def test_what_did_not_help_is_not_tried_again_where_nothing_has_moved(ball, monkeypatch):
    """One fold is mended, another is too far gone: in the second round nobody looks at it."""
    positions = ball.vertices + pulled(ball, 1.3)[1]
    far = int(np.argmin(ball.vertices @ ball.vertices[200]))
    positions[far] *= -1.0
    judge, state = _judged(ball, positions)
    tried = []
    ways = stepback._ways

    def recorded(judge, state, places, mean):
        tried.append((places.rings, len(places.at)))
        return ways(judge, state, places, mean)

    monkeypatch.setattr(stepback, "_ways", recorded)
    after = step_back(judge, state, SurfaceIndex(ball), MorphSettings())
    assert 0 < len(after.worst) < len(state.worst)
    widths = [rings for rings, _ in tried]
    assert set(widths) == set(stepback.BACK)
    assert widths.count(max(stepback.BACK)) == 1, tried


@pytest.mark.parametrize(("many", "rounds", "widths"), [(0, 1, 2), (10**6, stepback.TIMES, 7)])
def test_where_a_great_many_faces_stay_bad_it_is_given_up(ball, monkeypatch, many, rounds, widths):
    """Narrow patches make one face in a hundred well each time, and wide ones none."""
    rng = np.random.default_rng(3)
    judge, begun = _judged(ball, ball.vertices + 0.2 * rng.normal(size=ball.vertices.shape))
    tried = []

    def little(judge, begun, state, places, mean, progress):
        tried.append(places.rings)
        if places.rings > stepback.BACK[0]:
            return state
        bad = state.bad.copy()
        bad[state.worst[: len(state.worst) // 100 + 1]] = 0.0
        return dataclasses.replace(state, bad=bad)

    monkeypatch.setattr(stepback, "MANY", many)
    monkeypatch.setattr(stepback, "_best", little)
    monkeypatch.setattr(stepback, "_approached", lambda judge, state, *rest: state)
    monkeypatch.setattr(stepback._Places, "around", lambda judge, state, rings, tried: _Stub(state, rings))
    after = step_back(judge, begun, SurfaceIndex(ball), MorphSettings())
    assert len(begun.worst) > 300 and 0 < len(after.worst) < len(begun.worst)
    assert tried.count(stepback.BACK[0]) == rounds
    assert len(tried) == rounds * widths


class _Stub:
    """Places of which only the width is asked."""

    def __init__(self, state, rings):
        self.at, self.rings = state.worst, rings


@pytest.mark.parametrize("word", ["stepping back", "returning"])
def test_stepping_back_may_be_cancelled_between_its_ways(ball, word):
    judge, state = _judged(ball, ball.vertices + pulled(ball, 1.3)[1])
    said: list[str] = []

    def cancelling(_fraction, text):
        said.append(text)
        if text.startswith(word):
            raise Cancelled

    with pytest.raises(Cancelled):
        step_back(judge, state, SurfaceIndex(ball), MorphSettings(), cancelling)
    assert said[-1].startswith(word)
    assert said.count(said[-1]) == 1
