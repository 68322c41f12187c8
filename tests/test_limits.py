# SPDX-License-Identifier: GPL-3.0-or-later
"""Limits that hold, and that change no result."""

from __future__ import annotations

import os

import numpy as np
import pytest

from femors_addon import limits
from femors_addon.bodies import Body
from femors_addon.morph import morph
from femors_addon.nearest import SurfaceIndex
from femors_addon.overclosure import remove_overclosure
from femors_addon.progress import FemorsError
from femors_addon.shapes import pair, sphere


@pytest.fixture(autouse=True)
def restored():
    before = limits.Limits.threads, limits.Limits.memory
    yield
    limits.Limits.threads, limits.Limits.memory = before


def test_threads_change_no_result():
    bones = pair(2000, 2000)
    index = SurfaceIndex(bones.source)
    limits.allow(1, 0)
    one = index.closest(bones.target.vertices)
    limits.allow(3, 0)
    three = index.closest(bones.target.vertices)
    np.testing.assert_array_equal(one.point, three.point)
    limits.allow(0, 0)
    assert limits.Limits.threads == os.cpu_count()


def test_threads_change_no_bit_of_a_removal():
    bodies = [
        Body("one", sphere(3, radius=10.0)),
        Body("two", sphere(3, radius=8.0, centre=(14.0, 9.0, 4.0))),
    ]
    limits.allow(1, 0)
    one = remove_overclosure(bodies)
    limits.allow(3, 0)
    three = remove_overclosure(bodies)
    assert one.certified and not one.untouched
    for before, after in zip(one.bodies, three.bodies, strict=True):
        np.testing.assert_array_equal(before.nodes, after.nodes)
    assert [f.as_dict() for f in one.before] == [f.as_dict() for f in three.before]
    assert [f.as_dict() for f in one.after] == [f.as_dict() for f in three.after]


def test_a_morph_that_needs_too_much_memory_is_refused_before_it_starts():
    bones = pair(500, 500)
    said = []
    limits.allow(1, 20)
    with pytest.raises(FemorsError, match=r"needs about 32 MB of memory, and the limit .* is 20 MB"):
        morph(bones.source, bones.target, progress=lambda fraction, text: said.append(text))
    assert not said
    limits.allow(1, 0)
    limits.require_memory(1e15, "anything")
