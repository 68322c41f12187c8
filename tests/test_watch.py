# SPDX-License-Identifier: GPL-3.0-or-later
"""What an onlooker is shown of a morph, and that looking on changes nothing."""

from __future__ import annotations

import numpy as np
import pytest

from femors_addon.mesh import Surface
from femors_addon.morph import morph
from femors_addon.progress import Cancelled
from femors_addon.shapes import pair


@pytest.fixture(scope="module")
def bones():
    made = pair(1500, 1500, posed=True)
    # a loose vertex and one that stands twice: an onlooker sees the mesh as given
    vertices = np.concatenate((made.source.vertices, [[9.0, 9.0, 9.0]], made.source.vertices[:1]))
    faces = np.where(made.source.faces == 0, len(vertices) - 1, made.source.faces)
    faces[::2] = made.source.faces[::2]
    return Surface(vertices, faces), made.target


def test_an_onlooker_sees_the_source_come_to_the_result(bones):
    source, target = bones
    seen = []
    watched = morph(source, target, preview=seen.append)
    assert len(seen) > 5
    assert all(one.shape == source.vertices.shape and np.isfinite(one).all() for one in seen)
    used = np.unique(source.faces)
    aligned = source.vertices @ watched.transform[:3, :3].T + watched.transform[:3, 3]
    np.testing.assert_allclose(seen[0], aligned, atol=1e-9)
    off = [np.linalg.norm(one - watched.vertices, axis=1)[used].mean() for one in seen]
    assert off[-1] < 0.02 * off[0]
    assert off[len(off) // 2] < 0.5 * off[0]


def test_looking_on_changes_nothing(bones):
    alone, watched = morph(*bones), morph(*bones, preview=lambda vertices: vertices.fill(0.0))
    np.testing.assert_array_equal(alone.vertices, watched.vertices)


def test_an_onlooker_may_end_it(bones):
    def enough(vertices):
        raise Cancelled

    with pytest.raises(Cancelled):
        morph(*bones, preview=enough)
