# SPDX-License-Identifier: GPL-3.0-or-later
"""ICP: it ends where it goes round in circles."""

from __future__ import annotations

import numpy as np

from femors_addon import icp, shapes
from femors_addon.icp import Cloud, Registration

BONE, OTHER = shapes.bone(600), shapes.bone(660)


def registration(seed: int) -> Registration:
    """A bone, and another that is stretched and wavy."""
    size = OTHER.diagonal
    waves = 0.02 * size * np.sin(9 * OTHER.vertices[:, [1, 2, 0]] / size + seed)
    other = OTHER.moved(OTHER.vertices * np.random.default_rng(seed).uniform(0.9, 1.1, 3) + waves)
    return Registration(Cloud.of(BONE, BONE), Cloud.of(other, other), "none", 1e-6 * size)


def test_going_round_in_a_few_poses_ends_it(monkeypatch):
    """One pair in ten went on to the last of a hundred steps so, from pose to pose and back.

    Which do depends on roundings, and so on the processor.
    """
    steps, plain, same, differences = [0], icp.matched, icp.SAME, list[float]()

    def counting(*args):
        steps[-1] += 1
        return plain(*args)

    monkeypatch.setattr(icp, "matched", counting)
    for seed in range(40):
        work, misfits = registration(seed), []
        steps.clear()
        for nearly in (-1.0, same):  # nothing is the same; as it is
            monkeypatch.setattr(icp, "SAME", nearly)
            steps.append(0)
            (fit,) = icp.icp(work, np.eye(4)[None], "affine", 100)
            misfits.append(fit.misfit)
        if steps[0] == 101:
            assert steps[1] < 20, steps
            differences.append(abs(misfits[1] / misfits[0] - 1.0))
        else:
            assert steps[1] <= steps[0]
    assert len(differences) > 1
    # of the poses that it goes round in another may be a little better
    assert max(differences) < 1e-3 and np.median(differences) < 1e-4
