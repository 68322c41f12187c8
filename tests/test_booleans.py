# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes that two shapes share, and in which they differ."""

from __future__ import annotations

import numpy as np
import pytest

from femors_addon import booleans
from femors_addon.mesh import Surface
from femors_addon.shapes import sphere

pytestmark = pytest.mark.skipif(not booleans.available(), reason="manifold3d is not installed")
BALL = sphere(4, radius=10.0)


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


@pytest.mark.parametrize("poles", [[(0, 0, 1)], [(0, 0, 1), (0, 0, -1)], [(0, 0, 1), (0.1, 0.3, 0.9)]])
def test_a_patch_differs_as_the_whole_does(poles, monkeypatch):
    new = dented(BALL, *poles)
    patch = booleans.xor_volume(BALL, new)
    monkeypatch.setattr(booleans, "PATCH", 0.0)
    assert patch == pytest.approx(booleans.xor_volume(BALL, new), rel=1e-9)
    assert booleans.xor_volume(BALL, BALL.moved(BALL.vertices)) == 0.0


def test_only_the_patch_is_handed_on(monkeypatch):
    seen = []
    whole = booleans._manifold
    monkeypatch.setattr(
        booleans, "_manifold", lambda surface: seen.append(len(surface.faces)) or whole(surface)
    )
    booleans.xor_volume(BALL, dented(BALL, (0, 0, 1)))
    assert max(seen) < 0.1 * len(BALL.faces)


def test_where_no_cone_closes_the_patch_the_whole_is_compared(monkeypatch):
    new = dented(BALL, (0, 0, 1))
    expected = booleans.xor_volume(BALL, new)
    monkeypatch.setattr(booleans, "DEEP", -1.0)  # a tip above the patch
    assert booleans.xor_volume(BALL, new) == pytest.approx(expected, rel=1e-9)


def test_what_lies_behind_a_thin_body_is_not_shared():
    """The cone that closes a patch is no part of the body."""
    fine = sphere(5)
    plate = fine.moved(fine.vertices * [10.0, 10.0, 0.1])
    above = sphere(4, radius=0.4, centre=(0.3, 0.2, 0.45))
    behind = sphere(2, radius=0.05, centre=(0.3, 0.2, -0.3))
    two = Surface(
        np.concatenate((above.vertices, behind.vertices)),
        np.concatenate((above.faces, behind.faces + len(above.vertices))),
    )
    whole = booleans._shared(plate, two)
    assert whole == pytest.approx(booleans._shared(plate, above), rel=1e-9)
    assert booleans.shared_volume(plate, two, above.bounds) == pytest.approx(whole, rel=1e-9)
