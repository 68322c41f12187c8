# SPDX-License-Identifier: GPL-3.0-or-later
"""Cleaning: of everything that scanners and exporters do to surfaces."""

from __future__ import annotations

import re

import numpy as np
import pytest
from cleancases import assert_closed_and_alike, assert_maps_hold, cleaned, inverted
from hypothesis import given, settings
from hypothesis import strategies as st
from surfaces import clipped, soup, together

from femors_addon.cleaning import clean
from femors_addon.mesh import Surface
from femors_addon.progress import FemorsError
from femors_addon.quality import edge_faults
from femors_addon.shapes import box, sphere


# --- merging --------------------------------------------------------------------------------------
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


@pytest.mark.parametrize("share", [0.001, 0.02, 0.5, 1.0])
@pytest.mark.parametrize("width", [1e-7, 1e-5, 4e-3])
def test_cracks_are_closed_whatever_their_share_and_width(share, width):
    """A few corners that still stand together are no reason to leave the others apart."""
    ball = sphere(3, radius=50.0)
    loose, rng = soup(ball), np.random.default_rng(1)
    points = loose.vertices.copy()
    off = rng.permutation(len(points))[: max(int(share * len(points)), 1)]
    points[off] += width * ball.mean_edge * rng.uniform(-1, 1, (len(off), 3)) / 2
    result = clean(points, loose.faces, "scan")
    assert len(result.surface.vertices) == len(ball.vertices)
    assert_closed_and_alike(result.surface)
    one, two = ball.faces.ravel(), result.vertex_map  # corners that were one vertex are one again
    assert len(np.unique(one * 10_000 + two)) == len(ball.vertices)
    (note,) = result.notes
    assert re.fullmatch(
        r"scan: \d+ (vertex stood on a crack|vertices stood on cracks) narrower than 0.01 of an edge "
        r"and (was|were) merged for the maths",
        note,
    )


def test_a_crack_between_shared_vertices_is_closed():
    """As of two halves that another program has put together: no soup, and no vertex twice."""
    ball = sphere(3)
    upper = ball.vertices[ball.faces].mean(axis=1)[:, 2] > 0
    points = np.concatenate((ball.vertices, ball.vertices * (1 + 1e-6)))
    raw = Surface(points, np.where(upper[:, None], ball.faces + len(ball.vertices), ball.faces))
    result = cleaned(raw)
    assert len(result.surface.vertices) == len(ball.vertices)
    assert_closed_and_alike(result.surface)
    assert "cracks" in result.notes[0] and "belong to no face" in result.notes[1]


@pytest.mark.parametrize("between", [1, 2, 3, 200])
def test_fine_open_borders_stay(between):
    """However many nodes stand close together along them."""
    x = np.concatenate(([0.0], 1.0 + 1e-4 * np.arange(between + 1), [2.0]))
    count = len(x)
    points = np.column_stack((np.tile(x, 2), np.repeat([0.0, 1.0], count), 0.1 * np.tile(x, 2) ** 2))
    a = np.arange(count - 1)
    one, two = np.column_stack((a, a + 1, a + count + 1)), np.column_stack((a, a + count + 1, a + count))
    result = clean(points, np.concatenate((one, two)))
    assert len(result.surface.vertices) == 2 * count and len(result.surface.faces) == 2 * (count - 1)
    assert not any("crack" in note for note in result.notes)


@pytest.mark.parametrize("above", [-1e-3, -1e-5, 1e-5, 1e-3])
def test_slivers_where_a_mesh_was_cut_stay(above):
    """Of a plane just beside a vertex, as clipping leaves them: two edges apart, but no crack."""
    ball = sphere(3)
    heights = np.sort(ball.vertices[:, 2])
    points, faces = clipped(ball, heights[len(heights) * 6 // 10] + above * ball.mean_edge)
    result = clean(points, faces)
    assert not any("crack" in note or "stand twice" in note for note in result.notes)
    assert edge_faults(result.surface) == edge_faults(Surface(points, faces))


def test_the_ends_of_an_edge_do_not_come_together_by_others_between_them():
    """Two vertices of long edges lie at a short one, each a hair from an end of it, and near each other."""
    hair, short = 4e-6, 5e-4
    points = [[0, 0, 0], [0, short, 0], [1, 0, 0.1], [1, 1, 0], [2, 0, 0.3]]
    points += [[-hair, 0, 0], [-1, 0, 0.1], [-1, -1, 0], [-hair, short, 0], [-1, 1, 0.2], [-1, 2, -0.5]]
    faces = [[0, 2, 1], [1, 2, 3], [2, 4, 3], [5, 6, 7], [8, 9, 10]]
    result = cleaned(Surface(np.array(points, dtype=float), np.array(faces)))
    assert len(result.surface.faces) == len(faces)
    assert len(result.surface.vertices) == len(points)


def test_triangles_that_cannot_be_put_together_are_told():
    ball = sphere(3)
    loose = soup(ball)
    noise = 0.1 * ball.mean_edge * np.random.default_rng(0).uniform(-1, 1, loose.vertices.shape)
    notes = clean(loose.vertices + noise, loose.faces, "scan").notes
    assert notes[-1].startswith(
        "scan: is in 1280 open pieces, of 1280 faces: if corners that belong together"
    )
    block = box()
    grains = together(*[block.moved(block.vertices + [30 * k, 0, 0]) for k in range(150)])
    assert not any("pieces" in note for note in cleaned(grains).notes), "closed ones are no fault"


def test_cracks_and_equal_vertices_are_told_apart():
    ball = sphere(2)
    again = ball.vertices[ball.faces[0]]
    vertices = np.concatenate((ball.vertices, again, ball.vertices[[9]] + 1e-6))
    faces = ball.faces.copy()
    faces[0] = len(ball.vertices) + np.arange(3)
    last = np.flatnonzero((faces == 9).any(axis=1))[0]
    faces[last] = np.where(faces[last] == 9, len(vertices) - 1, faces[last])
    assert [note.split(": ")[1] for note in cleaned(Surface(vertices, faces)).notes] == [
        "1 vertex stood on a crack narrower than 0.01 of an edge and was merged for the maths",
        "3 vertices stood twice or more and were merged for the maths",
    ]


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


# --- errors ---------------------------------------------------------------------------------------
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


# --- all of it at once ----------------------------------------------------------------------------
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
