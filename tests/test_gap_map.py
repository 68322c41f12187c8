# SPDX-License-Identifier: GPL-3.0-or-later
"""The signed gap of every node to the other bodies, and elements of mirrored meshes."""

from __future__ import annotations

import numpy as np
import pytest

from femors_addon.elements import KINDS
from femors_addon.mesh import Surface
from femors_addon.overclosure import Body
from femors_addon.overclosure_check import gap_map
from femors_addon.volume import VolumeMesh
from femors_addon.volume_faces import Block
from femors_addon.volume_quality import scaled_jacobians

BOX = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1.0]])


def box(low, high) -> Surface:
    faces = [triangle for a, b, c, d in BOX for triangle in ((a, b, c), (a, c, d))]
    return Surface(np.asarray(low) + CORNERS * (np.asarray(high) - low), np.array(faces))


def test_gaps_are_signed_and_end_at_the_reach():
    floor = box((-10, -10, -5), (10, 10, 0))
    dice = box((0, 0, -0.25), (1, 1, 0.75))
    loose = np.concatenate((dice.vertices, [[0.5, 0.5, 0.1]]))  # a vertex of no face
    gaps = gap_map([Body("floor", floor), Body("dice", Surface(loose, dice.faces))], 0.5)
    np.testing.assert_allclose(gaps["dice"], [-0.25] * 4 + [0.5] * 5)
    np.testing.assert_allclose(gaps["floor"], 0.5)
    far = gap_map([Body("floor", floor), Body("dice", dice)], 2.0)
    np.testing.assert_allclose(far["dice"], [-0.25] * 4 + [0.75] * 4)


def test_the_nearest_body_counts_and_an_excluded_pair_does_not():
    bodies = [
        Body("a", box((0, 0, 0), (1, 1, 1))),
        Body("b", box((-3, -3, 1.2), (3, 3, 2))),
        Body("c", box((-3, -3, -2), (3, 3, -0.1))),
    ]
    top, bottom = CORNERS[:, 2] == 1, CORNERS[:, 2] == 0
    gaps = gap_map(bodies, 5.0)["a"]
    np.testing.assert_allclose(gaps[top], 0.2)
    np.testing.assert_allclose(gaps[bottom], 0.1)
    gaps = gap_map(bodies, 5.0, exclude=[("c", "a")])["a"]
    np.testing.assert_allclose(gaps[bottom], 1.2)


# corners of a valid element, by how many there are
SHAPES = {
    4: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
    5: [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]],
    6: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]],
    8: CORNERS.tolist(),
}


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if kind.solid])
def test_mirrored_elements_are_valid_in_the_mirrored_order(name):
    kind = KINDS[name]
    corners = np.array(SHAPES[kind.corners], dtype=float)
    nodes = np.concatenate((corners, *(corners[list(edge)].mean(axis=0)[None] for edge in kind.edges)))
    nodes[:, 0] += 0.1 * nodes[:, 1]

    def worst(points, order):
        mesh = VolumeMesh(points, (Block(name, np.array([order]), np.array([1])),), np.arange(len(points)))
        return scaled_jacobians(mesh)[0]

    before = worst(nodes, range(kind.size))
    assert before > 0.3
    mirror = nodes * [-1, 1, 1]
    assert worst(mirror, range(kind.size)) < 0
    assert worst(mirror, kind.mirrored) == pytest.approx(before)
    assert [kind.mirrored[i] for i in kind.mirrored] == list(range(kind.size)), "twice is as it was"
    # each mid-side node stands between the ends of its edge still
    turned = nodes[list(kind.mirrored)]
    for number, (a, b) in enumerate(kind.edges):
        np.testing.assert_allclose(turned[kind.corners + number], (turned[a] + turned[b]) / 2)
