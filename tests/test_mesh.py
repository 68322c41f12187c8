# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces: theory of their measures."""

from __future__ import annotations

import numpy as np
import pytest
from cleancases import inverted
from scipy.sparse import csgraph

from femors_addon import mesh
from femors_addon.mesh import Surface, connected, edge_matrix, triangulate
from femors_addon.progress import FemorsError
from femors_addon.shapes import box, sphere
from femors_addon.triples import unit


# --- Surface --------------------------------------------------------------------------------------
def test_arrays_are_copied_typed_and_read_only():
    vertices, faces = np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], dtype=np.uint64)
    surface = Surface(vertices, faces)
    vertices[0] = 9.0
    assert surface.vertices[0].tolist() == [1, 0, 0]
    assert (surface.vertices.dtype, surface.faces.dtype) == (np.float64, np.int32)
    for array in (surface.vertices, surface.faces):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_bad_numbers_are_told():
    points = np.zeros((5, 3))
    points[[2, 4], 1] = np.nan, np.inf
    with pytest.raises(FemorsError, match=r"2 of 5 vertices .* not finite \(first: vertex 2\)"):
        Surface(points, [[0, 1, 2]])
    for face in ([0, 1, 3], [-1, 0, 1]):
        with pytest.raises(FemorsError, match="names a vertex that the mesh does not have"):
            Surface(np.eye(3), [face])


def test_measures_of_a_box():
    block = box((1, 2, 3), 2, low=(10, 20, 30))
    assert block.volume == pytest.approx(6.0)
    assert inverted(block).volume == pytest.approx(-6.0)
    assert block.face_areas.sum() == pytest.approx(22.0)
    assert block.diagonal == pytest.approx(np.sqrt(14.0))
    assert [b.tolist() for b in block.bounds] == [[10, 20, 30], [11, 22, 33]]
    assert box(cells=1).mean_edge == pytest.approx((12 + 6 * np.sqrt(2)) / 18)
    # normals: a closed surface's area vectors cancel, and each points away from the middle
    assert block.face_cross.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)
    middle = block.corners.mean(axis=1) - block.vertices.mean(axis=0)
    assert (np.einsum("ij,ij->i", block.face_normals, middle) > 0).all()


def test_normals_of_a_sphere_point_outward():
    ball = sphere(3)
    assert np.einsum("ij,ij->i", ball.vertex_normals, ball.vertices).min() > 0.999
    loose = Surface(np.concatenate((ball.vertices, [[5.0, 0, 0]])), ball.faces)
    assert loose.vertex_normals[-1].tolist() == [0, 0, 0]


def test_volume_does_not_lose_digits_far_away():
    far = box(low=(1e7, -1e7, 1e7))
    assert far.volume == pytest.approx(1.0, abs=1e-7)


def test_topology_of_a_closed_and_an_open_surface():
    ball = sphere(1)
    assert len(ball.vertices) - len(ball.edges) + len(ball.faces) == 2
    assert (ball.edges[:, 0] < ball.edges[:, 1]).all()
    assert np.array_equal(ball.edges[np.lexsort(ball.edges.T[::-1])], ball.edges)
    faces, edges = ball.edge_faces
    assert len(faces) == len(ball.edges)
    for pair, edge in zip(faces, edges, strict=True):
        assert set(edge) == set(ball.faces[pair[0]]) & set(ball.faces[pair[1]])
    assert not ball.border.any()
    cut = Surface(ball.vertices, ball.faces[1:])
    assert np.flatnonzero(cut.border).tolist() == sorted(ball.faces[0].tolist())
    assert len(cut.edge_faces[0]) == len(ball.edges) - 3
    assert np.array_equal(ball.adjacency.toarray(), ball.adjacency.toarray().T)
    assert ball.adjacency.sum() == 2 * len(ball.edges)
    for vertex in range(len(ball.vertices)):
        assert ball.vertex_faces[vertex].indices.tolist() == np.argwhere(ball.faces == vertex)[:, 0].tolist()


def test_an_edge_of_three_faces_is_nobodys_pair():
    points = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, -1, 0]]
    fan = Surface(points, [[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    assert len(fan.edge_faces[0]) == 0
    assert len(fan.edges) == 7


def test_a_moved_surface_keeps_its_topology_and_not_its_geometry():
    ball = sphere(1)
    _ = ball.edges, ball.edge_faces, ball.adjacency, ball.vertex_faces, ball.volume, ball.vertex_normals
    larger = ball.moved(2.0 * ball.vertices)
    for name in ("edges", "edge_faces", "adjacency", "vertex_faces"):
        assert getattr(larger, name) is getattr(ball, name)
    assert larger.volume == pytest.approx(8.0 * ball.volume)


@pytest.mark.parametrize("vertices", [np.empty((0, 3)), np.zeros((2, 3))])
def test_an_empty_surface_has_no_measure_but_zero(vertices):
    empty = Surface(vertices, np.empty((0, 3)))
    assert (empty.volume, empty.mean_edge, empty.diagonal) == (0.0, 0.0, 0.0)
    assert [b.tolist() for b in empty.bounds] == [[0, 0, 0], [0, 0, 0]]
    assert empty.edges.shape == empty.edge_faces[0].shape == empty.edge_faces[1].shape == (0, 2)
    assert empty.vertex_normals.shape == vertices.shape
    assert empty.border.shape == (len(vertices),)
    assert empty.adjacency.shape == (len(vertices),) * 2


def test_unit_leaves_nothing_as_nothing():
    assert unit(np.array([[3.0, 0, 4.0], [0, 0, 0]])).tolist() == [[0.6, 0, 0.8], [0, 0, 0]]


# --- triangulate ----------------------------------------------------------------------------------
def test_polygons_become_fans_on_a_fixed_diagonal():
    triangles, polygon = triangulate([3, 0, 4, 2, 5, 1], [7, 8, 9, 0, 1, 2, 3, 5, 6, 10, 11, 12, 13, 14, 4])
    assert triangles.tolist() == [[7, 8, 9], [0, 1, 2], [0, 2, 3], [10, 11, 12], [10, 12, 13], [10, 13, 14]]
    assert polygon.tolist() == [0, 2, 2, 4, 4, 4]


def test_triangles_alone_are_as_among_other_polygons():
    corners = np.random.default_rng(0).integers(0, 9, 3 * 50).astype(np.int32)
    alone, ours = triangulate(np.full(50, 3), corners)
    among, theirs = triangulate(np.append(np.full(50, 3), 4), np.append(corners, (0, 1, 2, 3)))
    np.testing.assert_array_equal(alone, among[:50])
    np.testing.assert_array_equal(ours, theirs[:50])
    assert (alone.dtype, ours.dtype) == (among.dtype, theirs.dtype)
    with pytest.raises(IndexError):
        triangulate([3, 3], corners[:3])
    alone[:] = 0
    assert corners.any(), "what was given is not what is returned"


def test_no_polygons_are_no_triangles():
    for sizes in ([], [2, 1, 0]):
        triangles, polygon = triangulate(sizes, np.arange(sum(sizes)))
        assert triangles.shape == (0, 3)
        assert polygon.shape == (0,)


# --- edges and components ------------------------------------------------------------------------
def test_edges_along_which_two_faces_run_the_same_way():
    shape = box((1.0, 2.0, 3.0), 4)
    assert not shape.opposed_edges.any()
    faces = shape.faces.copy()
    faces[7] = faces[7, ::-1]
    turned = Surface(shape.vertices, faces)
    np.testing.assert_array_equal(turned.opposed_edges, (turned.edge_faces[0] == 7).any(axis=1))


@pytest.mark.parametrize("edges", [0, 40, 90, 400])
def test_pieces_are_found_some_edges_at_a_time(edges, monkeypatch):
    """The same pieces in the same order as at once, and SciPy is never asked about more at once."""
    random = np.random.default_rng(edges)
    pairs = random.integers(0, 100, (edges, 2)).astype(np.int32)
    whole = csgraph.connected_components(edge_matrix(pairs, 100), directed=False)[1]
    asked = []
    at_once = csgraph.connected_components
    monkeypatch.setattr(
        csgraph,
        "connected_components",
        lambda graph, **options: asked.append(graph.nnz) or at_once(graph, **options),
    )
    for size in (1, 7, 1000):
        monkeypatch.setattr(mesh, "EDGES", size)
        asked.clear()
        assert connected(pairs, 100).tolist() == whole.tolist()
        assert max(asked, default=0) <= 2 * size


def test_closed_components_are_told_one_by_one():
    one, two = sphere(1), sphere(1, centre=(3.0, 0.0, 0.0))
    faces = np.concatenate((one.faces, two.faces[1:] + len(one.vertices)))
    both = Surface(np.concatenate((one.vertices, two.vertices)), faces)
    assert both.closed[both.components].tolist() == [True] * 80 + [False] * 79
    assert Surface(np.zeros((0, 3)), np.zeros((0, 3), int)).closed.tolist() == []
