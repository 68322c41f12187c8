# SPDX-License-Identifier: GPL-3.0-or-later
"""Reduction: about as many nodes as asked for, still the same shape, whatever the mesh is like."""

from __future__ import annotations

import numpy as np
import pytest
from surfaces import cut, together

from femors_addon import shapes
from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.reduce import pyramid, reduced


def euler(surface: Surface) -> int:
    return len(surface.vertices) - len(surface.edges) + len(surface.faces)


@pytest.fixture(scope="module")
def bone() -> Surface:
    return shapes.bone(4000)


@pytest.mark.parametrize(("nodes", "lost"), [(2000, 0.005), (600, 0.02), (150, 0.07)])
def test_the_shape_stays_with_fewer_nodes(bone, nodes, lost):
    small = reduced(bone, nodes)
    assert len(small.vertices) == pytest.approx(nodes, rel=0.05)
    assert euler(small) == 2
    assert not small.border.any()
    assert small.volume == pytest.approx(bone.volume, rel=lost)
    assert small.mean_edge > bone.mean_edge
    distance = SurfaceIndex(bone).closest(small.vertices).distance
    assert distance.max() < 0.5 * small.mean_edge
    assert np.median(distance) < 0.05 * small.mean_edge
    # outward, as what it was made of
    found = SurfaceIndex(bone).closest(small.corners.mean(axis=1))
    assert (np.einsum("ij,ij->i", small.face_normals, bone.face_normals[found.face]) > 0).mean() > 0.98


def test_no_more_nodes_than_there_are(bone):
    assert reduced(bone, len(bone.vertices)) is bone
    assert reduced(bone, 10**9) is bone


def test_the_unit_and_the_place_do_not_matter(bone):
    """The reducer itself works in single precision: a bone in metres, or far from the origin, as well."""
    plain = reduced(bone, 800)
    for scale, shift in ((1e-3, 0.0), (1e6, 0.0), (1.0, 1e5)):
        other = reduced(bone.moved(bone.vertices * scale + shift), 800)
        back = (other.vertices - shift) / scale
        # rounding may decide some collapses otherwise: the same shape, if not the same nodes
        assert SurfaceIndex(plain).closest(back).distance.max() < 0.2 * plain.mean_edge
        assert len(back) == pytest.approx(len(plain.vertices), rel=0.02)


def test_the_same_every_time(bone):
    one, two = reduced(bone, 700), reduced(Surface(bone.vertices, bone.faces), 700)
    assert one.vertices.tobytes() == two.vertices.tobytes()
    assert one.faces.tobytes() == two.faces.tobytes()


def test_an_open_border_stays_where_it_is(bone):
    small = reduced(cut(bone, 150.0, np.inf)[0], 500)
    rim = small.vertices[small.border]
    assert len(rim) > 8
    assert np.abs(rim[:, 2] - 150.0).max() < small.mean_edge


def test_several_components_and_tiny_meshes():
    """What cannot be reduced is left as it is; nothing vanishes without a word."""
    balls = [shapes.sphere(2, centre=(3.0 * i, 0, 0)) for i in range(3)]
    three = together(*balls)
    small = reduced(three, 150)
    assert euler(small) == 6
    assert small.volume == pytest.approx(three.volume, rel=0.2)
    tetrahedron = Surface(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    )
    for nodes in (0, 1, 3, 4):
        assert len(reduced(tetrahedron, nodes).faces) == 4
    for nodes in (0, 1, 5):
        low = reduced(balls[0], nodes)
        assert len(low.faces) >= 4
        assert low.volume > 0


def test_a_pyramid_goes_from_coarse_to_fine(bone):
    levels = pyramid(bone, [2000, 120, 500])
    assert [len(level.vertices) for level in levels] == pytest.approx([120, 500, 2000], rel=0.06)
    assert pyramid(bone, []) == []
    assert pyramid(bone, [10**6]) == [bone]
