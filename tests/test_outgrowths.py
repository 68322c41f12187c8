# SPDX-License-Identifier: GPL-3.0-or-later
"""Ends of processes: a source that falls short of them is drawn out, and nothing else is touched."""

import numpy as np
import pytest

from femors_addon import morph as morphing
from femors_addon.isosurface import meshed
from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.outgrowths import MISSED, drawn_out
from femors_addon.relax import averaging
from femors_addon.shapes import sphere


def horned(length: float, nodes: int = 2500, lattice: int = 0) -> Surface:
    """A body of radius 10 with two horns, meshed evenly."""

    def depth(points):
        body = np.linalg.norm(points * (1.0, 1.2, 1.0), axis=1) - 10.0
        along = np.clip(np.abs(points[:, 0]) - 8.0, 0.0, length)
        axis = np.column_stack((np.sign(points[:, 0]) * (8.0 + along), 0.3 * along, 0.0 * along))
        horn = np.linalg.norm(points - axis, axis=1) - 1.8
        return np.minimum(body, horn)

    reach = np.array([12.0 + length, 12.0, 12.0])
    return meshed(depth, -reach, reach, nodes, lattice=lattice)


@pytest.fixture(scope="module")
def pair():
    return horned(3.0), horned(12.0, lattice=5)


def test_horns_that_grow_are_reached_to_their_ends(pair, monkeypatch):
    source, target = pair
    edge = max(source.mean_edge, target.mean_edge)

    def missed():
        result = morphing.morph(source, target)
        assert result.after.flipped == result.after.self_intersecting == 0
        return result.after.target_to_surface

    with_it = missed()
    monkeypatch.setattr(morphing, "reached", lambda reference, settled, *_: settled)
    without = missed()
    assert without.maximum > 1.3 * edge  # or nothing is shown
    assert with_it.maximum < 0.7 * without.maximum and with_it.p99 <= without.p99


def _cut_short(ball: Surface) -> np.ndarray:
    """A displacement of a ball with a spike onto itself, but for the spike."""
    return np.where(ball.vertices[:, [2]] > 0.9, (0.0, 0.0, -0.02), (0.0, 0.0, 0.0))


def test_where_nothing_is_missed_nothing_moves():
    ball = sphere(3)
    displacement = _cut_short(ball)
    after = drawn_out(ball, displacement, SurfaceIndex(ball), None, averaging(ball), 10)
    assert after is displacement


def test_one_node_alone_is_noise_and_nodes_that_may_not_move_stay():
    ball = sphere(3)
    zero = np.zeros_like(ball.vertices)
    spiked = ball.vertices.copy()
    top = int(spiked[:, 2].argmax())
    spiked[top] *= 1.0 + 2.0 * ball.mean_edge
    mean = averaging(ball)
    assert drawn_out(ball, zero, SurfaceIndex(ball.moved(spiked)), None, mean, 10) is zero
    around = ball.vertices[:, 2] > 0.9
    bump = ball.moved(ball.vertices * np.where(around, 1.0 + 3.0 * ball.mean_edge, 1.0)[:, None])
    index = SurfaceIndex(bump)
    after = drawn_out(ball, zero, index, None, mean, 10)
    back = SurfaceIndex(ball.moved(ball.vertices + after)).closest(bump.vertices).distance
    assert back.max() < MISSED * bump.mean_edge < SurfaceIndex(ball).closest(bump.vertices).distance.max()
    assert (after[ball.vertices[:, 2] < -0.5] == 0).all()
    held = drawn_out(ball, zero, index, (ball.vertices[:, 0] > 0).astype(float), mean, 10)
    assert (held[ball.vertices[:, 0] <= 0] == 0).all() and held.any()
