# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces: theory of their measures, and cleaning of everything that scanners and exporters do to them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from surfaces import soup, together

from femors_addon.cleaning import Cleaned, clean
from femors_addon.mesh import Surface, triangulate
from femors_addon.orientation import oriented, winding_number
from femors_addon.progress import FemorsError
from femors_addon.shapes import box, sphere
from femors_addon.triples import unit


def inverted(surface: Surface, faces=slice(None)) -> Surface:
    """The surface with some faces (all) wound the other way."""
    turned = surface.faces.copy()
    turned[faces] = turned[faces][:, ::-1]
    return Surface(surface.vertices, turned)


def cleaned(surface: Surface, name: str = "mesh") -> Cleaned:
    return clean(surface.vertices, surface.faces, name)


def assert_maps_hold(raw: Surface, result: Cleaned) -> None:
    """Each used vertex is where it was, and each face has the corners of the one that it came from."""
    used = result.vertex_map >= 0
    assert np.array_equal(result.surface.vertices[result.vertex_map[used]], raw.vertices[used])
    origin = np.sort(result.vertex_map[raw.faces[result.face_map]], axis=1)
    assert np.array_equal(np.sort(result.surface.faces, axis=1), origin)
    assert np.array_equal(np.unique(result.surface.faces), np.arange(len(result.surface.vertices)))


def assert_closed_and_alike(surface: Surface) -> None:
    """Every half-edge has one partner that runs the other way."""
    half = surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    forth = set(map(tuple, half.tolist()))
    assert len(forth) == len(half)
    assert forth == set(map(tuple, half[:, ::-1].tolist()))


# --- Surface ------------------------------------------------------------------------------------
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


# --- triangulate --------------------------------------------------------------------------------
def test_polygons_become_fans_on_a_fixed_diagonal():
    triangles, polygon = triangulate([3, 0, 4, 2, 5, 1], [7, 8, 9, 0, 1, 2, 3, 5, 6, 10, 11, 12, 13, 14, 4])
    assert triangles.tolist() == [[7, 8, 9], [0, 1, 2], [0, 2, 3], [10, 11, 12], [10, 12, 13], [10, 13, 14]]
    assert polygon.tolist() == [0, 2, 2, 4, 4, 4]


def test_no_polygons_are_no_triangles():
    for sizes in ([], [2, 1, 0]):
        triangles, polygon = triangulate(sizes, np.arange(sum(sizes)))
        assert triangles.shape == (0, 3)
        assert polygon.shape == (0,)


# --- merging ------------------------------------------------------------------------------------
def test_a_sound_surface_is_left_as_it_is():
    ball = sphere(2)
    result = cleaned(ball)
    assert np.array_equal(result.surface.vertices, ball.vertices)
    assert np.array_equal(result.surface.faces, ball.faces)
    assert result.vertex_map.tolist() == list(range(len(ball.vertices)))
    assert result.face_map.tolist() == list(range(len(ball.faces)))
    assert result.notes == ()


def test_a_soup_is_put_together_in_order_of_appearance():
    ball = sphere(2)
    loose = soup(ball)
    result = cleaned(loose, "tibia")
    assert len(result.surface.vertices) == len(ball.vertices)
    assert_closed_and_alike(result.surface)
    assert_maps_hold(loose, result)
    first = np.unique(result.vertex_map, return_index=True)[1]
    assert (np.diff(first) > 0).all()
    assert result.notes == (), "an STL file is never otherwise"


def test_vertices_that_stand_twice_beside_shared_ones_are_told():
    ball = sphere(2)
    vertices = np.concatenate((ball.vertices, ball.vertices[ball.faces[:2].ravel()]))
    faces = ball.faces.copy()
    faces[:2] = len(ball.vertices) + np.arange(6).reshape(2, 3)
    result = cleaned(Surface(vertices, faces), "tibia")
    assert_closed_and_alike(result.surface)
    count = len(np.unique(ball.faces[:2]))
    assert result.notes == (f"tibia: {count} vertices stood twice or more and were merged for the maths",)


def test_a_soup_of_rounded_numbers_is_put_together():
    ball = sphere(2, radius=50.0)
    noise = np.random.default_rng(0).uniform(-1e-6, 1e-6, (3 * len(ball.faces), 3))
    loose = soup(ball)
    result = clean(loose.vertices + noise, loose.faces)
    assert len(result.surface.vertices) == len(ball.vertices)
    assert_closed_and_alike(result.surface)
    assert result.surface.volume == pytest.approx(ball.volume, rel=1e-6)


def test_near_but_separate_vertices_of_a_real_mesh_stay_apart():
    ball = sphere(2)
    twin = together(ball, ball.moved(ball.vertices * (1 + 1e-9)))
    assert len(cleaned(twin).surface.vertices) == 2 * len(ball.vertices)


def test_both_zeros_are_one_place():
    block = soup(box(low=(-0.5, -0.5, -0.5), cells=2))
    points = block.vertices.copy()
    zeros = np.argwhere(points == 0.0)
    points[tuple(zeros[::2].T)] = -0.0
    assert_closed_and_alike(clean(points, block.faces).surface)


def test_vertices_without_a_face_are_left_out_and_told():
    ball = sphere(1)
    points = np.insert(ball.vertices, [0, 7], [[9.0, 9, 9], [8.0, 8, 8]], axis=0)
    place = np.flatnonzero(points[:, 0] < 5)
    raw = Surface(points, place[ball.faces])
    result = cleaned(raw)
    assert np.flatnonzero(result.vertex_map < 0).tolist() == [0, 8]
    assert_maps_hold(raw, result)
    assert result.notes == ("mesh: 2 vertices belong to no face",)


def test_faces_without_area_and_twins_are_left_out_and_told():
    ball = sphere(1)
    on_edge = ball.vertices[ball.faces[0, :2]].mean(axis=0)
    points = np.concatenate((ball.vertices, [on_edge]))
    a, b, c = ball.faces[0]
    n = len(ball.vertices)
    extra = [[a, a, b], [a, b, n], [b, c, a], [c, b, a]]  # a point, a line, a twin, a turned twin
    raw = Surface(points, np.concatenate((ball.faces[:5], extra, ball.faces[5:])))
    result = cleaned(raw)
    assert result.face_map.tolist() == [*range(5), *range(9, 9 + len(ball.faces) - 5)]
    assert_maps_hold(raw, result)
    assert_closed_and_alike(result.surface)
    assert result.notes == (
        "mesh: 2 faces have no area and were left out of the maths",
        "mesh: 2 faces stand twice and were counted once",
        "mesh: 1 vertex belongs to no face",
    )


def test_slender_faces_that_have_area_stay():
    thin = box((1.0, 1.0, 1e-5), 2)
    assert len(cleaned(thin).surface.faces) == len(thin.faces)


# --- winding ------------------------------------------------------------------------------------
def volumes(surface: Surface, *counts: int) -> list[float]:
    """Signed volumes of consecutive runs of faces."""
    runs = np.split(surface.faces, np.cumsum(counts)[:-1])
    return [Surface(surface.vertices, run).volume for run in runs]


@pytest.mark.parametrize("share", [0.01, 0.3, 0.5, 0.99, 1.0])
def test_mixed_and_inverted_winding_is_mended(share):
    ball = sphere(2)
    wrong = np.random.default_rng(5).permutation(len(ball.faces))[: int(share * len(ball.faces))]
    result = cleaned(inverted(ball, wrong))
    assert_closed_and_alike(result.surface)
    assert result.surface.volume == pytest.approx(ball.volume)
    assert result.notes == (
        f"mesh: {len(wrong)} of {len(ball.faces)} faces were wound inward and turned for the maths",
    )


def test_each_component_is_wound_for_itself():
    parts = [sphere(1), inverted(box(low=(5, 0, 0))), inverted(sphere(1, centre=(0, 9, 0)), slice(0, 30))]
    result = cleaned(together(*parts))
    assert_closed_and_alike(result.surface)
    got = volumes(result.surface, *(len(p.faces) for p in parts))
    assert got == pytest.approx([parts[0].volume, 1.0, parts[0].volume])


@pytest.mark.parametrize("turned", range(8))
def test_nested_shells_alternate(turned):
    shells = [sphere(2, radius=3.0), sphere(2, radius=2.0), sphere(1, radius=1.0)]
    given_ = [inverted(s) if turned >> i & 1 else s for i, s in enumerate(shells)]
    beside = sphere(1, centre=(9.0, 0, 0))
    raw = together(given_[2], beside, given_[0], given_[1])  # not in the order of nesting
    result = cleaned(raw)
    got = volumes(result.surface, 80, 80, 320, 320)
    assert got == pytest.approx([shells[2].volume, beside.volume, shells[0].volume, -shells[1].volume])
    bone_only = result.surface.volume
    assert bone_only == pytest.approx(shells[2].volume + beside.volume + shells[0].volume - shells[1].volume)


def test_shells_that_touch_at_one_vertex_are_wound_apart():
    one, two = sphere(1), sphere(1)
    two = inverted(two.moved(two.vertices - two.vertices[0] + one.vertices[0] * 1.0 + 0.0))
    two = two.moved(2 * one.vertices[0] - two.vertices)  # the point reflection beyond the common vertex
    result = cleaned(together(one, two))
    assert len(result.surface.vertices) == 2 * len(one.vertices) - 1
    assert volumes(result.surface, 80, 80) == pytest.approx([one.volume, one.volume])


@pytest.mark.parametrize("turn", [False, True])
def test_an_open_shell_bulges_outward(turn):
    ball = sphere(3)
    cap = Surface(ball.vertices, ball.faces[(ball.corners[:, :, 2] > 0.3).all(axis=1)])
    shape = cleaned(inverted(cap) if turn else cap).surface
    assert np.einsum("ij,ij->i", shape.vertex_normals, shape.vertices).min() > 0.9


def test_winding_is_mended_across_a_moebius_band_without_end():
    n = 30
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    rows = []
    for side in (-0.3, 0.3):
        r = 1 + side * np.cos(angle / 2)
        rows.append(np.column_stack((r * np.cos(angle), r * np.sin(angle), side * np.sin(angle / 2))))
    low, high = np.arange(n), np.arange(n) + n
    low2, high2 = np.append(low[1:], high[0]), np.append(high[1:], low[0])
    faces = np.concatenate((np.column_stack((low, low2, high)), np.column_stack((high, low2, high2))))
    result = clean(np.concatenate(rows), faces)
    assert len(result.surface.faces) == 2 * n  # no side is the right one, but nothing is lost


def test_a_twin_face_does_not_upset_its_neighbours():
    # a pillow: two faces with all three edges in common, wound as a closed surface should be
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [6, 0, 0], [5, 1, 0], [5, 0, 1]]
    tetrahedron = [[3, 5, 4], [3, 4, 6], [4, 5, 6], [5, 6, 3]]  # the last one the wrong way round
    surface, turned = oriented(Surface(points, [[0, 1, 2], [2, 1, 0], *tetrahedron]))
    assert turned == 1
    assert surface.faces[:2].tolist() == [[0, 1, 2], [2, 1, 0]]


def test_oriented_counts_what_it_turned():
    ball = sphere(1)
    same, none = oriented(ball)
    assert same is ball
    assert none == 0
    back, count = oriented(inverted(ball, slice(0, 7)))
    assert count == 7
    assert back.face_normals == pytest.approx(ball.face_normals, abs=1e-12)


def test_many_components_of_mixed_winding_are_mended():
    cubes = [box(low=(2 * i, 2 * j, 0), cells=1) for i in range(50) for j in range(50)]
    raw = together(*cubes)
    wrong = np.random.default_rng(0).random(len(raw.faces)) < 0.1
    result = cleaned(inverted(raw, wrong))
    assert_closed_and_alike(result.surface)
    assert result.surface.volume == pytest.approx(2500.0)


@pytest.mark.parametrize(("turn", "inside"), [(False, 1.0), (True, -1.0)])
def test_winding_number_counts_shells(turn, inside):
    ball = sphere(2)
    corners = (inverted(ball) if turn else ball).corners
    points = np.array([[0, 0, 0], [0.5, 0.5, 0.5], [0.99, 0, 0], [1.01, 0, 0], [30, 1, 2]])
    assert winding_number(corners, points) == pytest.approx([inside] * 2 + [inside, 0, 0], abs=1e-9)
    # one side of a cube, seen from its middle, is a sixth of all there is to see
    block = box(low=(-0.5, -0.5, -0.5), cells=2)
    top = block.corners[(block.corners[:, :, 2] > 0.4).all(axis=1)]
    assert winding_number(top, np.zeros((1, 3))) == pytest.approx([1 / 6])


# --- errors -------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("vertices", "faces", "words"),
    [
        (np.zeros((4, 3)), np.empty((0, 3)), "scan: has no faces"),
        (np.eye(3), [[0, 1, 2]], "scan: 1 usable face"),
        (np.full((4, 3), np.nan), [[0, 1, 2]], "scan: 4 of 4 vertices"),
        (np.eye(4, 3), [[0, 1, 9]], "scan: a face names a vertex"),
        (np.ones((6, 3)), [[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 5]], "scan: 0 usable face"),
        (box(cells=2).vertices * (1, 1, 0), box(cells=2).faces, "scan: all vertices lie in one plane"),
    ],
)
def test_what_cannot_be_worked_with_is_said_in_one_line(vertices, faces, words):
    with pytest.raises(FemorsError) as caught:
        clean(vertices, faces, "scan")
    assert str(caught.value).startswith(words)
    assert "\n" not in str(caught.value)


def test_a_flat_sheet_anywhere_in_space_is_refused():
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(5.0), np.arange(5.0)))
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    points = np.column_stack((x, y, 0 * x)) @ turn + 1000.0
    at = np.arange(25).reshape(5, 5)
    a, b, c = (corner.ravel() for corner in (at[:-1, :-1], at[1:, :-1], at[1:, 1:]))
    with pytest.raises(FemorsError, match="in one plane"):
        clean(points, np.column_stack((a, b, c)))


def test_the_input_is_left_alone():
    ball = inverted(soup(sphere(1)), slice(0, 9))
    vertices, faces = ball.vertices.copy(), ball.faces.copy()
    clean(vertices, faces)
    assert np.array_equal(vertices, ball.vertices)
    assert np.array_equal(faces, ball.faces)


# --- all of it at once --------------------------------------------------------------------------
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31), unmerge=st.floats(0, 1), turn=st.floats(0, 1), scale=st.integers(-6, 6))
def test_whatever_is_done_to_a_surface_is_undone(seed, unmerge, turn, scale):
    rng = np.random.default_rng(seed)
    ball = together(sphere(1), box(cells=2, low=(3, 0, 0)))
    points, faces = ball.vertices * 10.0**scale, ball.faces.copy()
    # some corners get a vertex of their own
    for face, corner in np.argwhere(rng.random(faces.shape) < unmerge):
        points = np.concatenate((points, points[faces[face, corner]][None]))
        faces[face, corner] = len(points) - 1
    wrong = rng.random(len(faces)) < turn
    faces[wrong] = faces[wrong][:, ::-1]
    faces = np.roll(faces, rng.integers(3), axis=1)
    order = rng.permutation(len(points))
    raw = Surface(points[order], np.argsort(order)[rng.permutation(faces)])
    result = cleaned(raw)
    assert len(result.surface.vertices) == len(ball.vertices)
    assert_maps_hold(raw, result)
    assert_closed_and_alike(result.surface)
    assert result.surface.volume == pytest.approx(ball.volume * 1000.0**scale)


def test_edges_along_which_two_faces_run_the_same_way():
    shape = box((1.0, 2.0, 3.0), 4)
    assert not shape.opposed_edges.any()
    faces = shape.faces.copy()
    faces[7] = faces[7, ::-1]
    turned = Surface(shape.vertices, faces)
    np.testing.assert_array_equal(turned.opposed_edges, (turned.edge_faces[0] == 7).any(axis=1))


def test_closed_components_are_told_one_by_one():
    one, two = sphere(1), sphere(1, centre=(3.0, 0.0, 0.0))
    faces = np.concatenate((one.faces, two.faces[1:] + len(one.vertices)))
    both = Surface(np.concatenate((one.vertices, two.vertices)), faces)
    assert both.closed[both.components].tolist() == [True] * 80 + [False] * 79
    assert Surface(np.zeros((0, 3)), np.zeros((0, 3), int)).closed.tolist() == []
