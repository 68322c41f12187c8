# SPDX-License-Identifier: GPL-3.0-or-later
"""Overclosure on the decks of a real knee; skipped where they are not there. Times are for `make bench`."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from knee import CASES, DATA, Case

from femors_addon.bodies import Body, Solid
from femors_addon.booleans import shared_volume
from femors_addon.intersect import crossings
from femors_addon.nearest import SurfaceIndex
from femors_addon.overclosure import OverclosureSettings, remove_overclosure

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"the decks of the knee are not there ({DATA})")
GAP = 0.01


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_real_bodies_come_apart(case: Case):
    bodies = case.bodies()
    result = remove_overclosure(bodies, OverclosureSettings(gap=GAP))
    assert result.certified, result.reasons
    surfaces = [Solid(Body(after.name, after.mesh), 0.5).surface for after in result.bodies]
    for one, two in itertools.combinations(surfaces, 2):
        assert not len(crossings(one, two))
        assert shared_volume(one, two) == pytest.approx(0.0, abs=1e-9)
    for before, after in zip(bodies, result.bodies, strict=True):
        assert not len(after.inverted_new)
        assert after.folded == 0
        if before.share == 0.0:
            assert after.mesh is before.mesh
        if case.kind == "patella on femur" and case.depth <= 1:
            for old, new in (after.aspect, after.dihedral):
                assert new.p99 == pytest.approx(old.p99, rel=1e-3)
    if len(surfaces) == 2:
        one, two = surfaces
        assert SurfaceIndex(two).signed(one.vertices).min() >= GAP - 1e-5
        assert SurfaceIndex(one).signed(two.vertices).min() >= GAP - 1e-5
    if case.xor is not None:
        judged = next(body for body in result.bodies if body.name == case.judged)
        assert judged.xor <= case.xor


def test_far_nodes_stay_on_real_bones():
    bodies = next(case for case in CASES if case.kind == "patella on femur" and case.depth == 1.0).bodies()
    result = remove_overclosure(bodies, OverclosureSettings(gap=GAP))
    patella, femur = result.bodies
    near = SurfaceIndex(bodies[1].mesh.surface()[0]).signed(bodies[0].nodes) < GAP
    place = bodies[0].nodes[near]
    for before, after in zip(bodies, result.bodies, strict=True):
        away = (
            np.linalg.norm(before.nodes[:, None] - place[None], axis=2).min(axis=1) > 3 * result.spread + 1.0
        )
        assert np.array_equal(before.nodes[away], after.nodes[away])
        assert away.mean() > 0.5
    assert patella.settled is not None
    assert patella.settled.median < 0.1
    assert femur.settled is not None
