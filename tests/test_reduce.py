# SPDX-License-Identifier: GPL-3.0-or-later
"""Reduction: about as many nodes as asked for, still the same shape, whatever the mesh is like."""

from __future__ import annotations

import fast_simplification
import numpy as np
import pytest
from surfaces import cut, together

from femors_addon import shapes
from femors_addon.cleaning import clean
from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.quality import aspect_ratio
from femors_addon.reduce import PIECE, pyramid, reduced


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


@pytest.mark.parametrize("stretch", [(30, 1, 1), (1, 100, 2), (1, 1, 1 / 30)])
def test_needles_are_taken_away_too(stretch):
    """Where all triangles are needles no collapse seemed to be left, and a level kept all its nodes."""
    ball = shapes.sphere(4)
    long = ball.moved(ball.vertices * stretch)
    small = reduced(long, 500)
    assert len(small.vertices) == pytest.approx(500, rel=0.05)
    assert euler(small) == 2 and not small.border.any()
    assert small.volume == pytest.approx(long.volume, rel=0.05)


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


# --- evenly, whatever the file's order -------------------------------------------------------------
def divided(surface: Surface) -> Surface:
    """Each face cut into four in its plane, in the order of the vertices along x."""
    middles = surface.vertices[surface.edges].mean(axis=1)
    keys = surface.edges[:, 0].astype(np.int64) * len(surface.vertices) + surface.edges[:, 1]
    sides = np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
    at = len(surface.vertices) + np.searchsorted(
        keys, sides[..., 0].astype(np.int64) * len(surface.vertices) + sides[..., 1]
    )
    a, b, c = surface.faces.T
    ab, bc, ca = at.T
    faces = np.concatenate(
        [np.column_stack(f) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    )
    vertices = np.concatenate((surface.vertices, middles))
    order = np.argsort(vertices[:, 0], kind="stable")
    faces = np.argsort(order)[faces]
    return Surface(vertices[order], faces[np.argsort(faces.min(axis=1), kind="stable")])


def test_flat_facets_keep_their_nodes_and_both_ends_are_as_coarse(bone):
    dense = divided(divided(divided(bone)))  # 256 000 nodes, most of them inside flat facets
    small = reduced(dense, 12_000)
    assert len(small.vertices) == pytest.approx(12_000, rel=0.02)
    assert np.percentile(aspect_ratio(small), 95) < 30.0
    ends = small.vertices[small.edges]
    length, along = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), ends.mean(axis=1)[:, 0]
    assert length.min() > 1e-5 * small.mean_edge
    low, high = (length[side].mean() for side in (along < np.median(along), along >= np.median(along)))
    whole = reduced(bone, 2000)
    ends = whole.vertices[whole.edges]
    length, along = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), ends.mean(axis=1)[:, 0]
    fair = length[along < np.median(along)].mean() / length[along >= np.median(along)].mean()
    assert low / high == pytest.approx(fair, rel=0.2)


@pytest.mark.parametrize("stretch", [(1, 1, 1), (6, 1, 1)])
def test_large_meshes_collapse_in_pieces_without_a_trace(monkeypatch, stretch):
    """No more faces at a time than a window can wait for; nothing is torn where pieces meet."""
    ball = shapes.sphere(6)  # 81 920 faces
    ball = ball.moved(ball.vertices * stretch)
    given: list[int] = []
    plain = fast_simplification.simplify

    def counting(points, triangles, **options):
        given.append(len(triangles))
        return plain(points, triangles, **options)

    monkeypatch.setattr(fast_simplification, "simplify", counting)
    small = reduced(ball, 8000)
    assert len(given) > 5 and max(given) <= PIECE
    assert len(small.vertices) == pytest.approx(8000, rel=0.02)
    assert euler(small) == 2 and not small.border.any()
    assert small.volume == pytest.approx(ball.volume, rel=0.002)
    # as fine where pieces met as elsewhere
    monkeypatch.setattr("femors_addon.reduce.PIECE", 10**9)
    whole = reduced(ball, 8000)
    assert np.percentile(aspect_ratio(small), 99) < 1.1 * np.percentile(aspect_ratio(whole), 99)


def test_open_meshes_collapse_in_pieces_too():
    ball = shapes.sphere(6)
    bowl, _ = cut(ball, -2.0, 0.3)
    small = reduced(bowl, 6000)
    assert len(small.vertices) == pytest.approx(6000, rel=0.02)
    assert euler(small) == 1
    assert small.vertices[small.border, 2] == pytest.approx(bowl.vertices[bowl.border, 2].mean(), abs=0.05)


@pytest.mark.parametrize(("missing", "most"), [(0.1, 1600), (0.4, 5500)])
def test_meshes_that_are_mostly_borders_are_reduced_as_well(missing, most):
    """What pieces share has to stay, and so does any border: such a mesh kept nearly all of its nodes."""
    ball = shapes.sphere(6)
    there = np.random.default_rng(1).random(len(ball.faces)) > missing
    torn = clean(ball.vertices, ball.faces[there]).surface
    assert len(reduced(torn, 1500).vertices) < most


def test_a_strip_and_a_soup_are_reduced_as_well():
    one = np.column_stack((np.arange(15_000.0), np.zeros(15_000), np.sin(np.arange(15_000) / 400)))
    strip = np.concatenate((one, one + (0.0, 1.0, 0.3)))
    low = np.arange(len(one) - 1)
    high = low + len(one)
    faces = np.concatenate(
        (np.column_stack((low, low + 1, high)), np.column_stack((low + 1, high + 1, high)))
    )
    assert len(reduced(clean(strip, faces).surface, 1500).vertices) < 5000
    ball = shapes.sphere(6)
    apart = ball.corners + 0.01 * ball.face_normals[:, None] * np.random.default_rng(2).random((81_920, 1, 1))
    soup = Surface(apart.reshape(-1, 3), np.arange(3 * 81_920, dtype=np.int32).reshape(-1, 3))
    assert len(reduced(soup, 1500).vertices) < 4500
