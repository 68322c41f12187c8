# SPDX-License-Identifier: GPL-3.0-or-later
"""Who is clear in the end, but went through another on the way, is found out; and nobody else is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from solids import box, hexes, sphere

from femors_addon import passing
from femors_addon.bodies import Body, Solid
from femors_addon.contact import Pair
from femors_addon.crew import crew
from femors_addon.effort import ROOM, Effort
from femors_addon.limits import Limits
from femors_addon.mesh import Surface
from femors_addon.overclosure import OverclosureResult, OverclosureSettings, remove_overclosure
from femors_addon.passing import passed
from femors_addon.progress import Cancelled, silent
from femors_addon.removal import Removal
from femors_addon.removal_loop import _beside


def plate(x: float) -> Surface:
    return hexes((2, 8, 8), (0.4, 8.0, 8.0), centre=(x, 0.0, 0.0)).surface()[0]


def pushed(gap: float, *others: Body, share: float | None = None) -> OverclosureResult:
    """A rigid wall pushes a plate by a gap, beside which stands a second plate."""
    bodies = [Body("wall", plate(0.0), 0.0), Body("first", plate(0.6)), Body("second", plate(1.5), share)]
    settings = OverclosureSettings(gap=0.02, band=0.05)
    return remove_overclosure([*bodies, *others], settings, gaps={("wall", "first"): gap})


def in_order(result: OverclosureResult) -> bool:
    wall, first, second = (float(body.nodes[:, 0].mean()) for body in result.bodies[:3])
    return wall < first < second


@pytest.mark.parametrize("gap", [1.2, 1.6, 2.2])
def test_a_wide_gap_pushes_nobody_through_a_thin_third(gap):
    """No depth, but a gap of three to six thicknesses: the plate went through its neighbour."""
    result = pushed(gap)
    assert result.certified and in_order(result)


def test_a_wide_gap_pushes_nobody_through_a_rigid_third():
    result = pushed(1.2, share=0.0)
    assert in_order(result) and not result.certified
    assert (
        result.reasons[0].startswith("'wall' and 'first' at")
        and "where 1.2 is asked for" in result.reasons[0]
    )


def test_a_pair_waits_for_those_that_it_has_pressed_together():
    """The deeper the others are in each other, the shorter its step; from a quarter of a thickness, none."""
    steps = []
    for squeeze in (0.0, 0.5, 1.0):
        pair = Pair(Solid(Body("wall", plate(0.0)), 0.0), Solid(Body("first", plate(0.6)), 0.5), 1.0)
        effort = Effort(pair, OverclosureSettings(), 0.0)
        field = effort.field(squeeze)
        assert field is not None
        steps.append(float(np.abs(field(pair.two.vertices)[1]).max(initial=0.0)))
    room = ROOM * 0.39  # the thickness of a plate with sides is a little less
    assert steps[0] > 2 * room and steps[1] == pytest.approx(0.5 * room, rel=0.2) and steps[2] == 0.0


def pressed(clear: bool = True, open_side: bool = False) -> Effort:
    """Two plates, the second perhaps without its far side, that come to be an eighth of a thickness deep."""
    far = plate(0.9)
    if open_side:
        far = Surface(far.vertices, far.faces[far.corners[:, :, 0].min(axis=1) < 1.0])
    one, two = Solid(Body("one", plate(0.0)), 0.5), Solid(Body("two", far), 0.5)
    effort = Effort(Pair(one, two, 0.02), OverclosureSettings(continuation=False), 0.0, clear=clear)
    effort.field()
    assert effort.squeeze == 0.0
    two.put(two.points - [0.55, 0.0, 0.0])
    effort.forget()
    assert effort.field() is not None
    return effort


def test_only_who_was_clear_and_is_deep_by_now_is_squeezed():
    assert pressed().squeeze == pytest.approx(0.5, abs=0.1)
    assert pressed(clear=False).squeeze == 0.0
    assert pressed(open_side=True).squeeze == pytest.approx(0.5, abs=0.1)  # the other's thickness counts


def test_who_is_squeezed_more_does_not_wait():
    steps = []
    for squeeze in (0.0, 0.3, 1.0):
        effort = pressed()
        effort.forget()
        field = effort.field(squeeze)
        assert field is not None
        steps.append(float(np.abs(field(effort.pair.one.vertices)[1]).max(initial=0.0)))
    assert steps[0] == steps[1] > 0.02 and steps[2] == 0.0


def test_pairs_of_open_bodies_neither_wait_nor_are_waited_for():
    """Two plates 0.005 apart, each without its far side: how thick they are is not known."""
    low, high = plate(0.0), plate(0.405)
    low = Surface(low.vertices, low.faces[low.corners[:, :, 0].max(axis=1) > -0.1])
    high = Surface(high.vertices, high.faces[high.corners[:, :, 0].min(axis=1) < 0.5])
    one, two = Solid(Body("one", low), 0.5), Solid(Body("two", high), 0.5)
    fields = [
        Effort(Pair(one, two, 0.02), OverclosureSettings(), 0.0).field(squeeze) for squeeze in (0.0, 1.0)
    ]
    assert fields[0] is not None and fields[1] is not None
    assert fields[0].vectors.any() and np.array_equal(fields[0].vectors, fields[1].vectors)


def test_beside_a_pair_are_those_with_a_body_in_common_that_moves():
    rigid = Solid(Body("wall", plate(0.0)), 0.0)
    a, b, c = (Solid(Body(name, plate(0.5 + n)), 0.5) for n, name in enumerate("abc"))
    efforts = [
        Effort(Pair(*two, 0.02), OverclosureSettings(), 0.0)
        for two in ((rigid, a), (rigid, b), (a, b), (b, c), (rigid, c))
    ]
    numbers = [sorted(efforts.index(other) for other in others) for others in _beside(efforts)]
    assert numbers == [[2], [2, 3], [0, 1, 3], [1, 2, 4], [3]]


def test_who_overlapped_from_the_start_is_not_squeezed():
    """By edges alone, too: two beams cross with their ridges, and no node is inside."""
    unit = box(1, 2.0)
    low = Rotation.from_euler("x", 45.0, degrees=True).apply(unit.vertices * [5.0, 1.0, 1.0])
    high = Rotation.from_euler("z", 90.0, degrees=True).apply(low) + [0.0, 0.0, 8**0.5 - 0.3]
    beams = [Body(name, Surface(v, unit.faces)) for name, v in (("low", low), ("high", high))]
    over = hexes((8, 8, 2), (8.0, 8.0, 0.4), centre=(0.0, 0.0, 4.2)).surface()[0]  # 0.05 above
    removal = Removal([*beams, Body("over", over)], OverclosureSettings(gap=0.02, band=0.3), (), {}, None)
    removal.run(silent)
    assert removal.before[0].names == ("low", "high") and removal.before[0].depth == 0.0
    for effort in removal.efforts:
        effort.missing = 1.0  # as if it were deep by now
    squeezed = {effort.pair.names: effort.squeeze for effort in removal.efforts}
    assert squeezed["low", "high"] == 0.0 and squeezed["high", "over"] == 1.0


def test_who_overlapped_from_the_start_waits_too():
    for squeeze, still in ((0.0, False), (1.0, True)):
        effort = pressed(clear=False)
        effort.forget()
        field = effort.field(squeeze)
        assert field is not None
        assert (not field(effort.pair.one.vertices)[1].any()) == still


def test_what_is_deep_elsewhere_makes_no_step_longer():
    far = [Body(f"far{n}", sphere(2, 40.0, (0.0, 300.0 + 35.0 * n, 0.0))) for n in range(2)]
    result = pushed(1.2, *far)
    assert result.certified and in_order(result)


@pytest.mark.parametrize(("gap", "share"), [(1.2, 0.0), (2.0, None), (2.2, None)])
def test_who_went_through_another_is_told_and_not_certified(gap, share, monkeypatch):
    """A rigid plate in the way, or a gap of five thicknesses, where no pair waits for another."""
    monkeypatch.setattr(Effort, "squeeze", 0.0)
    result = pushed(gap, share=share)
    assert not in_order(result), "else the case shows nothing"
    assert all(finding.clear for finding in result.after) and not result.certified
    assert (
        "'first' and 'second' at" in result.reasons[0] and "one went through the other" in result.reasons[0]
    )


@pytest.fixture
def two():
    """A ball above a plate that is thin beside it."""
    thin = hexes((16, 16, 2), (30.0, 30.0, 1.0)).surface()[0]
    return [Solid(Body("ball", sphere(3, 5.0, (0.0, 0.0, 6.0))), 0.5), Solid(Body("plate", thin), 0.5)]


@pytest.mark.parametrize(
    ("by", "through"),
    [
        ((0, 0, -12), True),
        ((3, 2, -11.5), True),
        ((9, 0, 0), False),
        ((9, 4, 0.3), False),
        ((0, 0, 7), False),
    ],
)
def test_the_way_between_two_clear_ends_tells(two, by, through):
    two[0].put(two[0].points + np.array(by))
    found = passed(two, [(0, 1)], silent)
    assert [(finding.one, finding.two) for finding in found] == ([("ball", "plate")] if through else [])
    two[0].put(two[0].points - np.array(by))  # it is the same whose way it was
    two[1].put(two[1].points - np.array(by))
    assert len(passed(two, [(0, 1)], silent)) == through


def test_a_pair_that_has_hardly_moved_is_not_looked_at(two, monkeypatch):
    """Less than half the plate's thickness, though into it."""
    ball = Solid(Body("ball", sphere(3, 5.0, (0.0, 0.0, 5.7))), 0.5)
    monkeypatch.setattr(passing, "distances", lambda *_, **__: pytest.fail("it was looked at"))
    assert passed([ball, two[1]], [(0, 1)], silent) == []
    ball.put(ball.points - [0.0, 0.0, 0.4])
    assert passed([ball, two[1]], [(0, 1)], silent) == []
    ball.put(ball.points - [0.0, 0.0, 0.2])
    with pytest.raises(pytest.fail.Exception):
        passed([ball, two[1]], [(0, 1)], silent)


@pytest.mark.parametrize(("depth", "through"), [(0.05, False), (0.2, True)])
def test_who_has_grazed_another_on_the_straight_way_did_not_go_through(two, depth, through):
    """From one side of the plate to the other, over it: the way really taken may have been higher."""
    ball = Solid(Body("ball", sphere(3, 5.0, (-22.0, 0.0, 5.5 - depth))), 0.5)
    ball.put(ball.points + [44.0, 0.0, 0.0])
    found = passed([ball, two[1]], [(0, 1)], silent)
    assert len(found) == through


def test_of_open_bodies_nothing_is_told(two):
    ball = sphere(3, 5.0, (0.0, 0.0, 6.0))
    cup = Surface(ball.vertices, ball.faces[(ball.corners[:, :, 2] < 9.0).all(axis=1)])
    solids = [Solid(Body("cup", cup), 0.5), two[1]]
    solids[0].put(solids[0].points - [0.0, 0.0, 12.0])
    assert passed(solids, [(0, 1)], silent) == []


def test_the_look_at_the_way_can_be_cancelled(two):
    def cancel(fraction, text):
        raise Cancelled

    two[0].put(two[0].points - [0.0, 0.0, 12.0])
    with pytest.raises(Cancelled):
        passed(two, [(0, 1)], cancel)


def test_the_look_at_the_way_is_the_same_in_threads(two):
    two[0].put(two[0].points - [0.0, 0.0, 12.0])
    before, found = Limits.threads, []
    try:
        for threads in (1, 2):
            Limits.threads, told = threads, []
            with crew():
                found.append(passed(two, [(0, 1)], lambda fraction, _text, told=told: told.append(fraction)))
            assert told == sorted(told) and 0.0 < told[0] < 0.1 and 0.9 < told[-1] <= 1.0
    finally:
        Limits.threads = before
    assert found[0] == found[1] and len(found[0]) == 1


def test_the_bodies_stay_where_they_are(two):
    two[0].put(two[0].points - [0.0, 0.0, 12.0])
    before = [solid.points.copy() for solid in two]
    assert passed(two, [(0, 1)], silent)
    assert all(np.array_equal(solid.points, points) for solid, points in zip(two, before, strict=True))
