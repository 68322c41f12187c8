# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies in the mouth of an open one: what is inside cannot be told, and nobody else is to suffer from it."""

from __future__ import annotations

import numpy as np
import pytest
from solids import hexes, moved, sphere
from spheres import GAP

from femors_addon import removal
from femors_addon.bodies import Body
from femors_addon.mesh import Surface
from femors_addon.overclosure import OverclosureSettings, remove_overclosure


@pytest.mark.parametrize("rigid", ["ball", "cup", ""])
def test_a_body_in_the_mouth_of_an_open_one_is_left_alone_and_the_others_are_parted(rigid):
    """The normals of a bone without its end say that its neighbour is inside: it was pushed out."""
    ball, whole = sphere(3, 6.0, (0.0, 0.0, 4.0)), sphere()
    cup = Surface(whole.vertices, whole.faces[(whole.corners[:, :, 2] < 3.0).all(axis=1)])
    named = {"ball": ball, "cup": cup, "upper": moved(sphere(3, 6.0), (0.0, 1.0, 15.5))}
    bodies = [Body(name, mesh, 0.0 if name == rigid else None) for name, mesh in named.items()]
    result = remove_overclosure(bodies)
    assert not result.certified
    (reason,) = result.reasons
    assert "'cup' is open and its normals say" in reason and "close its holes" in reason
    states = {finding.names: finding.state for finding in result.after}
    assert states["ball", "upper"] == "clear" and states["ball", "cup"] == "overlap"
    assert not result.bodies[1].moved and np.abs(result.bodies[0].movement.maximum) < 1.0
    apart = remove_overclosure(bodies, exclude=[("ball", "cup")])
    assert apart.certified and np.array_equal(apart.bodies[2].nodes, result.bodies[2].nodes)
    (spared,) = apart.excluded  # nor is a depth told that nobody can tell
    assert (
        spared.depth_before == spared.depth_after == 0.0 and "may overlap, and does not" in apart.certificate
    )


def test_a_pair_that_is_left_alone_keeps_no_other_from_being_shaken(monkeypatch):
    plain = removal.METHODS["grnn"]

    def stuck_unless_shaken(efforts, solids, *args):
        shaken = any((solid.points != solid.rest).any() for solid in solids)
        return plain(efforts, solids, *args) if shaken else "no headway"

    monkeypatch.setitem(removal.METHODS, "grnn", stuck_unless_shaken)
    ball, whole = sphere(3, 10.0), sphere(3, 10.0, (0.0, 0.0, 80.0))
    cup = Surface(whole.vertices, whole.faces[(whole.corners[:, :, 2] < 83.0).all(axis=1)])
    near = moved(ball, (20.0 - 0.002 * ball.mean_edge, 0.0, 0.0))
    mouth = sphere(3, 6.0, (0.0, 0.0, 84.0))
    bodies = {"one": ball, "two": near, "cup": cup, "mouth": mouth}
    result = remove_overclosure(
        [Body(name, mesh) for name, mesh in bodies.items()], OverclosureSettings(gap=GAP)
    )
    assert {finding.names: finding.clear for finding in result.after} == {
        ("one", "two"): True,
        ("cup", "mouth"): False,
    }
    (reason,) = result.reasons
    assert "'cup' is open and its normals say" in reason


def test_a_contained_body_that_others_push_into_crossing_is_still_told_as_contained():
    plate = hexes((2, 6, 6), (0.6, 2.0, 2.0), centre=(9.5, 0.0, 0.0)).surface()[0]
    shell, pusher = sphere(3, 10.0), sphere(3, 1.5, (8.25, 0.0, 0.0))
    bodies = [Body("shell", shell, 0.0), Body("kernel", plate, 1.0), Body("pusher", pusher, 0.0)]
    result = remove_overclosure(bodies, exclude=[("shell", "pusher")])
    (finding,) = [finding for finding in result.after if not finding.clear]
    assert finding.state == "overlap" and finding.crossings
    assert len(result.reasons) == 1 and "a piece of 'kernel' lies inside the other" in result.reasons[0]
