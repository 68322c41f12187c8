# SPDX-License-Identifier: GPL-3.0-or-later
"""ICP: it ends where it goes round in circles."""

from __future__ import annotations

import numpy as np
import pytest

from femors_addon import icp, shapes
from femors_addon.icp import Cloud, Registration


@pytest.mark.parametrize("seed", [12, 23, 27])
def test_going_round_in_a_few_poses_ends_it(monkeypatch, seed):
    """One pair in ten went on to the last of a hundred steps so, from pose to pose and back."""
    random = np.random.default_rng(seed)
    bone, other = shapes.bone(600), shapes.bone(660)
    size = other.diagonal
    waves = 0.02 * size * np.sin(9 * other.vertices[:, [1, 2, 0]] / size + seed)
    other = other.moved(other.vertices * random.uniform(0.9, 1.1, 3) + waves)
    work = Registration(Cloud.of(bone, bone), Cloud.of(other, other), "none", 1e-6 * size)
    steps: list[int] = []
    plain = icp.matched

    def counting(*args):
        steps[-1] += 1
        return plain(*args)

    monkeypatch.setattr(icp, "matched", counting)
    misfits = []
    for same in (-1.0, icp.SAME):  # nothing is the same; as it is
        monkeypatch.setattr(icp, "SAME", same)
        steps.append(0)
        (fit,) = icp.icp(work, np.eye(4)[None], "affine", 100)
        misfits.append(fit.misfit)
    assert steps[0] == 101 and steps[1] < 20, steps
    assert misfits[1] == pytest.approx(misfits[0], rel=1e-4)
