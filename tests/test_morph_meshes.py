# SPDX-License-Identifier: GPL-3.0-or-later
"""The morph endures any mesh, or says in one line why not."""

from __future__ import annotations

import numpy as np
import pytest
from morphs import GOAL, SMALL, finite, subjects
from solids import hexes, moved
from surfaces import cut, soup, together

from femors_addon import cli_morph, morph_outcome, shapes
from femors_addon.mesh import Float, Surface, triangulate
from femors_addon.morph import MorphResult, MorphSettings, morph
from femors_addon.progress import FemorsError


# --- meshes of every kind -------------------------------------------------------------------------
def in_order_of_use(surface: Surface) -> Surface:
    """Vertices numbered as the faces name them, as merging a soup does."""
    _, first, inverse = np.unique(surface.faces, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return Surface(
        surface.vertices[np.unique(surface.faces)[np.argsort(first)]], rank[inverse].reshape(-1, 3)
    )


@pytest.fixture(scope="module")
def clean_result() -> tuple[Surface, MorphResult]:
    source = in_order_of_use(SMALL)
    return source, morph(source, in_order_of_use(GOAL))


def test_a_soup_moves_as_the_merged_mesh(clean_result):
    source, plain = clean_result
    loose = soup(source)
    result = morph(loose, soup(in_order_of_use(GOAL)))
    assert finite(result, loose)
    assert result.vertices == pytest.approx(plain.vertices[source.faces.ravel()], abs=1e-6)
    # copies of a vertex go together, bit for bit
    _, group = np.unique(loose.vertices, axis=0, return_inverse=True)
    for one in (0, 5, 77):
        assert len(np.unique(result.vertices[group.ravel() == one], axis=0)) == 1
    assert not any("merged" in warning for warning in result.warnings), "of a soup it is no news"


@pytest.mark.parametrize("which", ["source", "target", "both"])
def test_a_mesh_inside_out_gives_the_same(clean_result, which):
    source, plain = clean_result
    turned = Surface(source.vertices, source.faces[:, ::-1]) if which != "target" else source
    goal = in_order_of_use(GOAL)
    goal = Surface(goal.vertices, goal.faces[:, ::-1]) if which != "source" else goal
    result = morph(turned, goal)
    assert np.array_equal(result.vertices, plain.vertices)
    assert result.after.flipped == 0
    assert any("wound inward" in warning for warning in result.warnings)


def test_mixed_winding_gives_the_same(clean_result):
    source, plain = clean_result
    odd = np.random.default_rng(0).random(len(source.faces)) < 0.4
    mixed = Surface(source.vertices, np.where(odd[:, None], source.faces[:, ::-1], source.faces))
    assert morph(mixed, in_order_of_use(GOAL)).vertices == pytest.approx(plain.vertices, abs=1e-6)


def test_faces_twice_or_without_area_and_loose_vertices_change_nothing(clean_result):
    source, plain = clean_result
    n = len(source.vertices)
    vertices = np.concatenate((source.vertices, [[3.0, 3.0, 3.0], [0.0, 0.0, 0.0]]))
    extra = [source.faces[3], source.faces[7][::-1], [0, 0, 1], [2, 2, 2], [n, n, n]]
    messy = Surface(vertices, np.concatenate((source.faces, extra)))
    goal = in_order_of_use(GOAL)
    result = morph(messy, goal)
    assert finite(result, messy)
    assert np.array_equal(result.vertices[:n], plain.vertices)
    # loose vertices go along by the field
    assert result.vertices[n:] == pytest.approx(plain.apply(vertices[n:]))
    for words in ("stand twice", "no area", "belong to no face"):
        assert any(words in warning for warning in result.warnings), words
    messy_goal = Surface(
        np.concatenate((goal.vertices, [[9.0, 9, 9]])), np.concatenate((goal.faces, goal.faces[:9]))
    )
    assert np.array_equal(morph(source, messy_goal).vertices, plain.vertices)


def test_quads_on_their_fixed_diagonal():
    block = shapes.box((3, 2, 1), (6, 4, 2))
    quads = block.faces.reshape(-1, 2, 3)[:, [0, 0, 0, 1], [0, 1, 2, 2]]  # the two halves of each cell
    triangles, _ = triangulate(np.full(len(quads), 4), quads.ravel())
    source = Surface(block.vertices, triangles)
    target = shapes.box((3.3, 2.1, 1.2), (7, 5, 3))
    result = morph(source, target)
    assert finite(result, source)
    assert result.after.flipped == 0
    assert result.after.surface_to_target.p99 < 0.02


def test_several_components():
    """Each finds its own: a bone beside a ball."""
    source = together(shapes.bone(700, length=10.0), shapes.sphere(2, radius=1.5, centre=(5, 0, 5)))
    target = together(
        shapes.bone(700, length=10.4, lattice=1), shapes.sphere(2, radius=1.7, centre=(5.3, 0.2, 5.1))
    )
    result = morph(source, target)
    assert finite(result, source)
    assert result.converged
    first = len(source.vertices) - 162
    away = np.linalg.norm(result.vertices[first:] - (5.3, 0.2, 5.1), axis=1)
    assert away == pytest.approx(np.full(162, 1.7), abs=0.06)


def test_open_borders():
    """Two bones without their far ends: onto each other."""
    whole = shapes.pair(900, 900, seed=2)
    source, used = cut(whole.source, 60, 999)
    target, _ = cut(whole.target, 60, 999)
    result = morph(source, target)
    assert finite(result, source)
    assert result.after.flipped == result.after.self_intersecting == 0
    assert np.linalg.norm(result.vertices - whole.truth[used], axis=1).mean() < 0.02 * target.diagonal


@pytest.mark.parametrize("partial", ["source", "target"])
def test_partial_overlap_does_not_squeeze(partial):
    """Where one shows a part only, the rest follows by the field and keeps its size."""
    pair = subjects()
    size = pair.target.diagonal
    if partial == "source":
        source, used = cut(pair.source, -99, 200)
        result = morph(source, pair.target, MorphSettings(partial="source"))
        there, truth = np.ones(len(used), dtype=bool), pair.truth[used]
    else:
        source, truth = pair.source, pair.truth
        result = morph(source, cut(pair.target, -99, 200)[0], MorphSettings(partial="target"))
        there = truth[:, 2] < 180
        span = np.ptp(result.vertices, axis=0).max()
        assert span == pytest.approx(np.ptp(truth, axis=0).max(), rel=0.08)
    assert finite(result, source)
    assert np.linalg.norm(result.vertices - truth, axis=1)[there].mean() < 0.02 * size
    assert result.after.flipped == 0


# --- bad input ------------------------------------------------------------------------------------
def broken(kind: str) -> tuple[Float, np.ndarray]:
    vertices, faces = SMALL.vertices.copy(), SMALL.faces
    if kind == "empty":
        return np.empty((0, 3)), np.empty((0, 3), dtype=int)
    if kind == "no faces":
        return vertices, np.empty((0, 3), dtype=int)
    if kind == "one triangle":
        return vertices[:3], np.array([[0, 1, 2]])
    if kind == "planar":
        return vertices * (1, 1, 0), faces
    if kind == "a line":
        return vertices * (1, 0, 0), faces
    if kind == "a point":
        return vertices * 0, faces
    vertices[5] = {"NaN": np.nan, "infinite": np.inf}[kind]
    return vertices, faces


@pytest.mark.parametrize(
    "kind", ["empty", "no faces", "one triangle", "planar", "a line", "a point", "NaN", "infinite"]
)
@pytest.mark.parametrize("side", ["source", "target"])
def test_bad_meshes_are_told_in_one_line(kind, side):
    with pytest.raises(FemorsError) as error:
        bad = Surface(*broken(kind))
        morph(*((bad, GOAL) if side == "source" else (SMALL, bad)))
    said = str(error.value)
    assert "\n" not in said
    assert 10 < len(said) < 200
    if kind not in ("NaN", "infinite"):  # those are told before anything knows whose they are
        assert said.startswith(side)


@pytest.mark.parametrize(
    "change", [{"alignment": "wild"}, {"levels": -1}, {"projection": np.nan}, {"spread_start": -1.0}]
)
def test_settings_outside_their_limits_are_told(change):
    with pytest.raises(FemorsError):
        morph(SMALL, GOAL, MorphSettings(**change))


def test_new_folds_are_a_fault_also_where_the_source_crosses_itself_more():
    """Two balls through each other, laid onto a plate: fewer faces cross than before, but others."""
    ball, plate = shapes.sphere(3, radius=10.0), hexes((12, 12, 2), (16.0, 16.0, 1.0)).surface()[0]
    two = together(ball, moved(ball, (7.0, 0.0, 0.0)))
    result = morph(two, plate, MorphSettings(alignment="none"))
    assert 0 < result.after.self_intersecting < result.before.self_intersecting and result.converged
    (fault,) = result.faults
    assert "did not in the source" in fault and result.warnings.count(fault) == 1
    assert fault in cli_morph._faults(result, two)


def roof(height: float) -> Surface:
    """A strip of 12 squares along x, its middle raised: the edge there is bent by twice the slope."""
    x, y = np.meshgrid(np.arange(-6.0, 7.0), np.arange(2.0))
    points = np.column_stack((x.ravel(), y.ravel(), np.where(x == 0, height, 0.0).ravel()))
    low = np.arange(12)
    faces = [np.column_stack(corners) for corners in ((low, low + 1, low + 14), (low, low + 14, low + 13))]
    return Surface(points, np.concatenate(faces))


@pytest.mark.parametrize(
    ("before", "after", "target", "told"),
    [
        (0.0, 1.7, 0.0, False),  # 119 degrees
        (0.0, 1.8, 0.0, True),  # 122
        (0.57, 1.8, 0.0, True),  # 59 before
        (0.6, 1.8, 0.0, False),  # 62
        (0.0, 1.8, 1.8, False),  # as the target
    ],
)
def test_pleats_are_told_that_neither_mesh_has(before, after, target, told):
    notes = morph_outcome._pleated(roof(before), roof(after), roof(target))
    assert len(notes) == told
    if told:
        assert notes[0].startswith("1 edge is bent by more than 120 degrees, by less than 60 in the source: ")
        assert notes[0].endswith(f"look near (0, 0.5, {after:g})")


def test_what_is_to_be_said_of_pleats_is_said_with_the_result(monkeypatch):
    monkeypatch.setattr(morph_outcome, "_pleated", lambda *surfaces: (f"pleats of {len(surfaces)}",))
    assert "pleats of 3" in morph(SMALL, GOAL).warnings


def test_a_good_morph_has_no_pleats(clean_result):
    assert not any("pleats" in warning for warning in clean_result[1].warnings)
