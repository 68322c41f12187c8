# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes of many bodies: which pairs are looked at, and that those left out are found when they come near."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from solids import hexes, moved, sphere

from femors_addon import overclosure_check, removal
from femors_addon.bodies import Body, Solid
from femors_addon.boxes import Boxes
from femors_addon.contact import Pair
from femors_addon.effort import Effort
from femors_addon.findings import NEAR
from femors_addon.mesh import Surface
from femors_addon.overclosure import OverclosureSettings, check_overclosure, remove_overclosure


def test_boxes_are_no_farther_apart_than_any_two_points():
    random = np.random.default_rng(2)
    surfaces = [moved(sphere(1, random.uniform(1, 3)), random.uniform(-6, 6, 3)) for _ in range(12)]
    pairs = [(i, j) for j in range(12) for i in range(j)]
    apart = Boxes(surfaces).apart(pairs)
    assert (apart > 0).any() and (apart < 0).any()
    for (i, j), far in zip(pairs, apart, strict=True):
        one, two = (surfaces[n].vertices for n in (i, j))
        assert far <= np.linalg.norm(one[:, None] - two[None], axis=2).min()
        overlap = (one.min(axis=0) <= two.max(axis=0)) & (two.min(axis=0) <= one.max(axis=0))
        assert (far <= 0) == overlap.all()


def test_boxes_of_no_pairs_and_of_no_faces():
    empty = Surface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
    assert Boxes([empty, sphere(1)]).apart([]).shape == (0,)
    assert Boxes([empty, sphere(1)]).apart([(0, 1)]).shape == (1,)


def row(*places: float) -> list[Body]:
    """Balls along the x axis."""
    return [Body(f"ball{number}", sphere(3, 5.0, (x, 0.0, 0.0))) for number, x in enumerate(places)]


def test_only_pairs_whose_boxes_are_near_are_measured(monkeypatch):
    asked, measure = [], overclosure_check.measure

    def counted(one, two, *rest):
        asked.append((one.solid.name, two.solid.name))
        return measure(one, two, *rest)

    monkeypatch.setattr(overclosure_check, "measure", counted)
    found = check_overclosure(row(0.0, 9.5, 30.0, 39.5, 90.0))
    pairs = [("ball0", "ball1"), ("ball2", "ball3")]
    assert asked == pairs and {finding.names for finding in found} == set(pairs)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_a_pair_that_comes_near_on_the_way_is_parted_too(order, monkeypatch):
    """A ball bends a plate into the one below, which stood out of sight."""
    bodies = [
        Body("ball", sphere(3, 5.0, (0.0, 0.0, 4.75)), 0.0),
        Body("plate", hexes((20, 20, 2), (20.0, 20.0, 0.5))),
        Body("below", hexes((20, 20, 2), (20.0, 20.0, 0.5), centre=(0.0, 0.0, -0.7))),
    ]
    bodies = [bodies[number] for number in order]
    settings = OverclosureSettings(gap=0.01, band=0.05)
    begun, effort = [], removal.Effort
    monkeypatch.setattr(removal, "Effort", lambda *of: begun.append(set(of[0].names)) or effort(*of))
    assert remove_overclosure(bodies, settings).certified and len(begun) == 3
    begun.clear()
    monkeypatch.setattr(removal, "SIGHT", 0.0)
    result = remove_overclosure(bodies, settings)
    assert begun == [{"ball", "plate"}, {"plate", "below"}], "the second when it had come near"
    assert result.certified and all(finding.least >= 0.01 for finding in result.after)


def test_a_chain_of_bodies_out_of_sight_is_followed_to_its_end(monkeypatch):
    """Each comes near only when the one before it has moved: more rounds than certificates may fail."""

    def box(x: float) -> Surface:
        return hexes((3, 4, 4), (1.0, 4.0, 4.0), centre=(x, 0.0, 0.0)).surface()[0]

    monkeypatch.setattr(removal, "SIGHT", 0.0)
    begun, effort = [], removal.Effort
    monkeypatch.setattr(removal, "Effort", lambda *of: begun.append(of[0].names) or effort(*of))
    bodies = [Body(f"box{number}", box(1.04 * number), 10.0 ** (number - 6)) for number in range(7)]
    bodies[0] = Body("box0", box(0.44), 0.0)
    told: list[float] = []
    settings = OverclosureSettings(gap=0.01, band=0.02)
    result = remove_overclosure(bodies, settings, lambda fraction, _: told.append(fraction))
    assert result.certified
    assert begun == [(f"box{number}", f"box{number + 1}") for number in range(6)]
    assert told == sorted(told), "a bar never falls"
    assert [step.number for step in result.history] == list(range(1, len(result.history) + 1))


def test_a_certificate_that_fails_makes_the_loop_look_again(monkeypatch):
    """Where nothing moved since, the loop went by what it remembered, and could not but fail again."""
    looked, look = [], removal.Pair.look
    monkeypatch.setattr(removal.Pair, "look", lambda *of: looked.append(of[0].names) or look(*of))
    found, certificates = overclosure_check.find, []

    def doubted(*args, **kwargs):
        findings = found(*args, **kwargs)
        if looked:
            certificates.append(len(looked))
            if len(certificates) == 1:
                return [dataclasses.replace(f, state=NEAR) for f in findings]
        return findings

    monkeypatch.setattr(removal, "find", doubted)
    result = remove_overclosure(row(0.0, 9.5), OverclosureSettings(gap=0.01, band=0.1))
    assert result.certified and len(certificates) == 2 and certificates[1] > certificates[0]


def test_a_certificate_that_fails_again_and_again_ends_the_loop(monkeypatch):
    found, loop, rounds = overclosure_check.find, removal.METHODS["grnn"], []
    monkeypatch.setattr(removal.Removal, "_again", lambda *_: None)
    monkeypatch.setitem(removal.METHODS, "grnn", lambda *of: rounds.append(0) or loop(*of))
    monkeypatch.setattr(
        removal, "find", lambda *of, **by: [dataclasses.replace(f, state=NEAR) for f in found(*of, **by)]
    )
    result = remove_overclosure(row(0.0, 9.5), OverclosureSettings(gap=0.01, band=0.1))
    assert not result.certified
    assert f"the certificate failed {removal.TRIES} times" in result.reasons[0]
    assert len(rounds) == removal.TRIES


def test_what_is_forgotten_is_measured_anew():
    one, two = (Solid(body, 0.5) for body in row(0.0, 10.2))
    effort = Effort(Pair(one, two, 0.01), OverclosureSettings(gap=0.01), 0.0)
    assert effort.field() is None and effort.done
    assert all(np.isfinite(side.bound).any() for side in effort.pair.sides)
    effort.forget()
    assert all(np.isneginf(side.bound).all() for side in effort.pair.sides)
