# SPDX-License-Identifier: GPL-3.0-or-later
"""Islands and cavities that only one of two meshes has: left out of the maths, carried along, and said."""

import numpy as np
import pytest

from femors_addon.cleaning import clean
from femors_addon.mesh import Surface
from femors_addon.morph import morph
from femors_addon.morph_settings import MorphSettings
from femors_addon.quality import self_intersections
from femors_addon.shapes import sphere
from femors_addon.strays import without_strays

AXES = np.array([1.0, 1.4, 2.0])


def egg(halvings=3, size=10.0):
    ball = sphere(halvings)
    bump = 1 + 0.15 * np.exp(-((ball.vertices - (0.6, 0.8, 0.0)) ** 2).sum(axis=1) / 0.2)
    return ball.moved(size * AXES * ball.vertices * bump[:, None])


def joined(*surfaces):
    starts = np.cumsum([0] + [len(s.vertices) for s in surfaces])
    faces = [s.faces + start for s, start in zip(surfaces, starts, strict=False)]
    return Surface(np.concatenate([s.vertices for s in surfaces]), np.concatenate(faces))


def island(at, radius=0.6):
    ball = sphere(1)
    return ball.moved(radius * ball.vertices + np.array(at, dtype=float))


def solid_block(side, at):
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = np.array([half for a, b, c, d in quads for half in ((a, b, c), (a, c, d))], dtype=np.int32)
    return Surface(0.5 * side * corners + np.array(at), faces)


def with_cavity(outer, share=0.85):
    return joined(outer, outer.moved(share * outer.vertices))


def of(surface):
    return clean(surface.vertices, surface.faces)


def test_islands_of_the_target_are_left_out_and_the_source_is_not_pulled_to_them():
    source, target = egg(), egg().moved(1.1 * egg().vertices)
    dirty = joined(target, island((0, 0, 26)), island((16, 0, 0)))
    plain, result = morph(source, target), morph(source, dirty)
    np.testing.assert_array_equal(result.vertices, plain.vertices)
    assert result.converged
    assert [w for w in result.warnings if "target: small pieces" in w and "(2," in w]


def test_a_cavity_of_the_target_is_left_out():
    source, target = egg(), egg().moved(1.1 * egg().vertices)
    result = morph(source, with_cavity(target))
    np.testing.assert_array_equal(result.vertices, morph(source, target).vertices)
    assert result.converged
    assert [w for w in result.warnings if "target: walls of cavities inside (1) were left out" in w]


@pytest.mark.parametrize("kind", ["island", "cavity"])
def test_those_of_the_source_go_along_with_the_rest(kind):
    outer = egg()
    source = joined(outer, island((0, 0, 26))) if kind == "island" else with_cavity(outer)
    result = morph(source, outer.moved(1.1 * outer.vertices))
    n = len(outer.vertices)
    scaled = 1.1 * source.vertices[n:]
    assert np.abs(result.vertices[n:] - scaled).max() < 0.3  # of 40: neither flattened nor left behind
    assert not len(self_intersections(Surface(result.vertices, source.faces)))
    assert [w for w in result.warnings if w.startswith("source:") and "carried along" in w]


def test_what_both_have_is_kept():
    one, two = with_cavity(egg()), with_cavity(egg().moved(1.1 * egg().vertices))
    one, two = joined(one, island((0, 0, 26), 1.5)), joined(two, island((0, 16, 26), 1.5))
    for before, after in zip((of(one), of(two)), without_strays(of(one), of(two)), strict=True):
        assert after.surface.faces.shape == before.surface.faces.shape and after.notes == before.notes


def test_parts_of_a_torn_surface_and_large_pieces_are_kept():
    whole = egg()
    cut = np.argsort(whole.face_areas, kind="stable")[:3]
    torn = joined(
        Surface(whole.vertices, np.delete(whole.faces, cut, axis=0)),
        Surface(whole.vertices, whole.faces[cut]),  # lies where it was, but is not joined
    )
    pair = joined(whole, island((30, 0, 0), 5.0))
    for given in (Surface(torn.vertices + 0.0, torn.faces), pair):
        # vertices are shifted by less than a hair, so that nothing is merged
        shifted = given.vertices.copy()
        shifted[len(whole.vertices) :] += 1e-3
        made = of(Surface(shifted, given.faces))
        assert without_strays(of(whole), made)[1] is made


def test_what_touches_a_large_face_far_from_its_corners_is_no_island():
    whole = egg(5)
    block = solid_block(14.0, (40.0, 0.0, 0.0))
    on_the_block = island((47.7, 0.0, 0.5))  # 0.1 off the middle of a face, 9.9 from its corners
    triangle = np.array([[-3.0, -2.0, 0.0], [3.0, -2.0, 0.0], [0.0, 4.0, 0.0]])
    on_the_egg = Surface(triangle + (0.0, 0.0, whole.vertices[:, 2].max() + 0.1), np.array([[0, 1, 2]]))
    rest = joined(whole, block)
    for piece in (on_the_block, on_the_egg):
        made = of(joined(rest, piece))
        assert without_strays(of(rest), made)[1] is made
        away = of(joined(rest, piece.moved(piece.vertices + (2.0, 0.0, 2.0))))
        assert without_strays(of(rest), away)[1] is not away


def test_a_speck_in_both_is_no_counterpart():
    source, target = egg(), egg().moved(1.1 * egg().vertices)
    one, two = joined(source, island((0, 0, 26), 0.4)), joined(target, island((16, 0, 0), 0.4))
    result = morph(one, two)
    plain = morph(source, target)
    np.testing.assert_array_equal(result.vertices[: len(source.vertices)], plain.vertices)
    assert result.converged and sum("small pieces" in w for w in result.warnings) == 2


def test_pieces_that_run_into_the_rest_are_counted():
    """What is left out of the maths is in the mesh that is written."""
    source = with_cavity(egg(), 0.5)
    flat = egg().moved(egg().vertices * [0.3, 1.0, 1.0])
    result = morph(source, flat, MorphSettings(alignment="rigid"))
    merged = of(source)
    moved = Surface(result.vertices, source.faces)
    assert len(np.unique(self_intersections(moved))) == result.after.self_intersecting > 0
    assert result.before.self_intersecting == 0 and merged.surface.faces.shape == source.faces.shape
    assert [w for w in result.warnings if "cross others" in w]


def test_an_island_without_weight_stays():
    source = joined(egg(), island((0, 0, 26)))
    n = len(egg().vertices)
    weights = np.ones(len(source.vertices))
    weights[n:] = 0.0
    target = egg().moved(1.1 * egg().vertices)
    kept = morph(source, target, MorphSettings(alignment="none"), weights=weights).vertices
    np.testing.assert_array_equal(kept[n:], source.vertices[n:])
    weights[n:] = 0.5
    half = morph(source, target, MorphSettings(alignment="none"), weights=weights).vertices
    full = morph(source, target, MorphSettings(alignment="none")).vertices
    np.testing.assert_allclose(half[n:] - source.vertices[n:], 0.5 * (full - source.vertices)[n:], rtol=0.05)
