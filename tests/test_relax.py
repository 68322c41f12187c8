# SPDX-License-Identifier: GPL-3.0-or-later
"""The end of a morph: what must stay still stays still, shapes come back, and nothing folds over."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from femors_addon import folds, relax, shapes
from femors_addon.cleaning import clean
from femors_addon.folds import Reference, bad_faces, folded, unfolded
from femors_addon.mesh import Float, Surface
from femors_addon.morph_settings import MorphSettings
from femors_addon.nearest import SurfaceIndex
from femors_addon.quality import aspect_ratio, dihedral_angles, flipped_faces, self_intersections
from femors_addon.relax import ShapeMatching, averaging, guarded, slide


def sheet(n: int = 12) -> Surface:
    """A flat square sheet of n x n cells with both diagonals in turn, facing up."""
    x, y = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0), indexing="ij")
    at = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (corner.ravel() for corner in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    even = np.add.outer(np.arange(n), np.arange(n)).ravel() % 2 == 0
    one = np.where(even[:, None], np.column_stack((a, b, c)), np.column_stack((a, b, d)))
    two = np.where(even[:, None], np.column_stack((a, c, d)), np.column_stack((b, c, d)))
    return Surface(np.column_stack((x.ravel(), y.ravel(), 0 * x.ravel())), np.concatenate((one, two)))


def shaken(surface: Surface, share: float, seed: int = 0) -> Float:
    """Inner vertices moved at random within the plane."""
    rng = np.random.default_rng(seed)
    move = rng.uniform(-share, share, surface.vertices.shape) * (1, 1, 0)
    move[surface.border] = 0.0
    return surface.vertices + move


# --- averaging ----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "surface", [shapes.bone(700), sheet(), shapes.sphere(1)], ids=["bone", "sheet", "ball"]
)
def test_rows_of_the_averaging_sum_to_one(surface):
    mean = averaging(surface)
    assert np.asarray(mean.sum(axis=1)).ravel() == pytest.approx(np.ones(len(surface.vertices)))
    assert mean.diagonal().max() == 0.0
    assert mean.data.min() > 0.0
    assert ((mean > 0) != (surface.adjacency > 0)).nnz == 0


def test_a_short_edge_counts_most():
    points = sheet(4).vertices.copy()
    points[12] += (0.999, 0.0, 0.0)  # next to its neighbour
    mean = averaging(sheet(4).moved(points))
    assert mean[12].toarray().max() > 0.999
    points[12] = points[17]  # even where no length is left, all is finite
    assert np.isfinite(averaging(sheet(4).moved(points)).data).all()


def test_a_vertex_without_faces_has_no_neighbours():
    ball = shapes.sphere(1)
    loose = Surface(np.concatenate((ball.vertices, [[9.0, 9, 9]])), ball.faces)
    sums = np.asarray(averaging(loose).sum(axis=1)).ravel()
    assert sums[-1] == 0.0
    assert sums[:-1] == pytest.approx(np.ones(len(ball.vertices)))


# --- sliding ------------------------------------------------------------------------------------
def test_sliding_leaves_a_linear_displacement_on_a_flat_patch():
    """A stretch, a shear, a turn: only what bends is evened out."""
    flat = sheet()
    mean = averaging(flat)
    linear = flat.vertices @ np.random.default_rng(0).normal(size=(3, 3)) + (1.0, 2.0, 3.0)
    out = slide(flat, linear, mean, 25)
    # the border's own one-sided means are no concern of the inner vertices two edges away
    inner = ((flat.vertices[:, :2] > 2.5) & (flat.vertices[:, :2] < 9.5)).all(axis=1)
    assert slide(flat, linear, mean, 1)[inner] == pytest.approx(linear[inner], abs=1e-9)
    assert np.array_equal(out[flat.border], linear[flat.border])


def test_sliding_evens_out_along_and_never_across():
    ball = shapes.sphere(3)
    rng = np.random.default_rng(0)
    noise = 0.05 * rng.normal(size=ball.vertices.shape)
    out = slide(ball, noise, averaging(ball), 20)
    normal = ball.vertex_normals
    across = np.einsum("ij,ij->i", noise, normal)
    assert np.einsum("ij,ij->i", out, normal) == pytest.approx(across, abs=1e-12)
    along = [move - np.einsum("ij,ij->i", move, normal)[:, None] * normal for move in (noise, out)]
    assert np.linalg.norm(along[1]) < 0.5 * np.linalg.norm(along[0])
    assert np.array_equal(slide(ball, noise, averaging(ball), 0), noise)


def test_sliding_lessens_the_bending_however_long():
    """The energy that it is the flow of never grows, so that many rounds are as stable as few."""
    bone = shapes.bone(700)
    mean = averaging(bone)
    one, two = bone.edges.T
    weight = 1.0 / np.sum((bone.vertices[one] - bone.vertices[two]) ** 2, axis=1)
    total = np.bincount(np.concatenate((one, two)), np.tile(weight, 2))
    displacement = np.random.default_rng(1).normal(size=bone.vertices.shape)
    energy = []
    for _ in range(60):
        bend = mean @ displacement - displacement
        energy.append(total @ np.sum(bend**2, axis=1))
        displacement = slide(bone, displacement, mean, 5)
    assert energy == sorted(energy, reverse=True)
    assert energy[-1] < 0.4 * energy[0]


# --- shape matching -----------------------------------------------------------------------------
def test_a_mesh_moved_by_a_similarity_has_its_shapes():
    bone = shapes.bone(700)
    matching = ShapeMatching(bone)
    turn = Rotation.random(random_state=0).as_matrix()
    for factor in (1.0, 0.03, 40.0):
        moved = factor * bone.vertices @ turn + (100.0, -50.0, 3.0)
        assert np.abs(matching.move(moved)).max() < 1e-10 * factor * bone.mean_edge


def test_a_distorted_planar_patch_gets_its_shapes_back():
    flat = sheet()
    matching, positions = ShapeMatching(flat), shaken(flat, 0.4)
    before = np.abs(positions - flat.vertices).max()
    worst = aspect_ratio(flat.moved(positions)).max()
    for _ in range(400):
        positions = positions + 0.8 * matching.move(positions)
        assert np.abs(positions[:, 2]).max() < 1e-12  # within the plane
    assert np.abs(positions - flat.vertices).max() < 0.02 * before
    assert aspect_ratio(flat.moved(positions)).max() < aspect_ratio(flat).max() * 1.02 < worst


def test_the_border_stays():
    flat = sheet()
    move = ShapeMatching(flat).move(shaken(flat, 0.3))
    assert not move[flat.border].any()
    assert np.abs(move[~flat.border]).max() > 0.01


@pytest.mark.parametrize("points", [np.zeros((169, 3)), np.tile([1e-200, 0, 0], (169, 1))])
def test_shape_matching_of_a_collapsed_patch_is_finite(points):
    assert np.isfinite(ShapeMatching(sheet()).move(points)).all()
    assert np.isfinite(ShapeMatching(sheet().moved(points)).move(sheet().vertices)).all()


# --- folds --------------------------------------------------------------------------------------
def test_folded_faces_are_found_in_any_pose():
    flat = sheet()
    points = flat.vertices.copy()
    middle = 6 * 13 + 6
    points[middle] += (1.4, 0.45, 0.02)
    over = np.flatnonzero(flat.moved(points).face_cross[:, 2] < 0)
    assert len(over)
    assert set(over) <= set(folded(Reference(flat), flat.moved(points)).tolist())
    turn = Rotation.random(random_state=3).as_matrix()
    assert set(over) <= set(folded(Reference(flat), flat.moved(points @ turn + 7.0)).tolist())
    assert len(folded(Reference(flat), flat.moved(flat.vertices @ turn))) == 0
    # what was folded in the reference is not news
    assert len(folded(Reference(flat.moved(points)), flat.moved(points))) == 0


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("strength", [0.3, 1.0, 3.0, 30.0])
def test_a_guarded_step_never_folds(strength, seed):
    """Whatever is asked for, however wild."""
    rng = np.random.default_rng(seed)
    for surface in (sheet(), shapes.sphere(2, radius=3.0), shapes.bone(700, length=60.0)):
        mean = averaging(surface)
        smooth = 0.1 * surface.vertices @ rng.normal(size=(3, 3))
        step = strength * surface.mean_edge * rng.normal(size=surface.vertices.shape)
        taken = guarded(surface, smooth, step, mean)
        assert np.isfinite(taken).all()
        begun, after = (surface.moved(surface.vertices + move) for move in (smooth, smooth + taken))
        assert len(flipped_faces(begun, after)) == 0
        was, first, now = (dihedral_angles(state) for state in (surface, begun, after))
        assert (now <= np.maximum(110.0, first))[was < 60.0].all()  # nor is an edge that was blunt pleated
        # each node goes its own way or stays, never farther
        length = np.linalg.norm(step, axis=1)
        assert (np.linalg.norm(taken, axis=1) <= length + 1e-12).all()
        along = np.einsum("ij,ij->i", taken, step) / length
        assert along == pytest.approx(np.linalg.norm(taken, axis=1), abs=1e-9)


def ridge(height: float) -> Surface:
    """A sheet, raised along its middle: the edges there are bent by twice the slope."""
    flat = sheet()
    return flat.moved(flat.vertices + np.where(flat.vertices[:, :1] == 6.0, (0.0, 0.0, height), 0.0))


@pytest.mark.parametrize(("height", "taken"), [(0.0, 0.5), (0.5, 0.5), (0.6, 1.0)])
def test_an_edge_is_bent_to_110_degrees_and_farther_only_where_it_was_sharp(height, taken):
    """Up to 1.8 it would be 122 degrees; from 0 and from 53 half of the step is taken, from 62 all."""
    begun, end = ridge(height), ridge(1.8)
    step = end.vertices - begun.vertices
    after = guarded(begun, np.zeros_like(step), step, averaging(begun))
    inner = (step[:, 2] > 0) & ~begun.border
    assert after[inner, 2] == pytest.approx(taken * step[inner, 2])


def test_an_edge_that_is_pleated_already_may_go_along():
    flat, pleated = sheet(), ridge(1.8)
    step = np.tile([1.0, 2.0, 3.0], (len(flat.vertices), 1))
    displacement = pleated.vertices - flat.vertices
    assert np.array_equal(guarded(flat, displacement, step, averaging(flat)), step)


@pytest.mark.parametrize("stretch", [1.6, 2.2])
def test_an_edge_is_held_wherever_its_surroundings_go(stretch):
    """A roof is stretched as a whole, and steeper still: no face turns far from its surroundings."""

    def roof(slope: float) -> Surface:
        flat = sheet()
        up = slope * (6.0 - np.abs(flat.vertices[:, :1] - 6.0))
        return flat.moved(flat.vertices + up * (0.0, 0.0, 1.0))

    low, begun, steep = roof(0.56), roof(0.56 * stretch), roof(1.9)  # bent by 58, 84 or 102, and 125 degrees
    displacement, step = begun.vertices - low.vertices, steep.vertices - begun.vertices
    after = begun.moved(begun.vertices + guarded(low, displacement, step, averaging(low)))
    assert 60.0 < dihedral_angles(after).max() <= 110.0


def test_a_harmless_step_is_taken_in_full():
    bone = shapes.bone(700)
    turn = Rotation.from_rotvec((0.1, 0.2, 0.3)).as_matrix()
    step = 0.2 * bone.vertices @ turn + (1.0, 2.0, 3.0)
    assert np.array_equal(guarded(bone, np.zeros_like(step), step, averaging(bone)), step)


@pytest.mark.parametrize("seed", range(3))
def test_folds_are_mended_near_by(seed):
    ball = shapes.sphere(4, radius=10.0)
    rng = np.random.default_rng(seed)
    displacement = 0.05 * ball.vertices @ rng.normal(size=(3, 3))
    hurt = rng.integers(0, len(ball.vertices), 3)
    aside = np.cross(ball.vertices[hurt], rng.normal(size=(3, 3)))
    broken = displacement.copy()
    broken[hurt] += 2.5 * ball.mean_edge * aside / np.linalg.norm(aside, axis=1, keepdims=True)
    assert len(bad_faces(Reference(ball), ball.moved(ball.vertices + broken))) > 3
    mended, left = unfolded(Reference(ball), broken, averaging(ball), bad_faces)
    assert not len(left)
    after = ball.moved(ball.vertices + mended)
    assert len(flipped_faces(ball, after)) == len(self_intersections(after)) == 0
    # far from the damage nothing was touched
    far = (
        np.linalg.norm(ball.vertices[:, None] - ball.vertices[hurt], axis=2).min(axis=1) > 9 * ball.mean_edge
    )
    assert far.sum() > 500
    assert np.array_equal(mended[far], displacement[far])


def test_what_is_left_is_counted_as_the_judge_counts(monkeypatch):
    """Folds alone are looked at while there are any; the number returned is of all that is bad."""
    ball = shapes.sphere(3)
    broken = np.zeros_like(ball.vertices)
    broken[[5, 50, 500]] = 2.5 * ball.mean_edge * np.random.default_rng(5).normal(size=(3, 3))
    assert 0 < len(folded(Reference(ball), ball.moved(ball.vertices + broken))) < 40
    monkeypatch.setattr(folds, "PATCHES", (1,))
    monkeypatch.setattr(folds, "_harmonic", lambda displacement, *_: displacement)  # mends nothing
    asked = []

    def judge(reference, moved):
        asked.append(moved)
        return np.arange(40)

    out, left = unfolded(Reference(ball), broken, averaging(ball), judge)
    assert np.array_equal(out, broken)
    assert len(left) == 40
    assert len(asked) == 1  # of the best state alone: a later one that has as many folds cannot be it


def test_a_sound_displacement_is_not_mended():
    ball = shapes.sphere(2)
    displacement = 0.3 * ball.vertices
    out, left = unfolded(Reference(ball), displacement, averaging(ball), bad_faces)
    assert np.array_equal(out, displacement)
    assert not len(left)


def test_what_was_bad_before_is_not_counted():
    """A source that crosses itself is the user's own."""
    ball = shapes.sphere(2)
    two = Surface(
        np.concatenate((ball.vertices, ball.vertices + (0.7, 0, 0))),
        np.concatenate((ball.faces, ball.faces + len(ball.vertices))),
    )
    assert len(self_intersections(two)) > 0
    assert len(bad_faces(Reference(two), two.moved(two.vertices * 1.1))) == 0


# --- all together -------------------------------------------------------------------------------
def test_settling_lays_nodes_on_the_target_with_their_shapes():
    ball = shapes.sphere(3, radius=10.0)
    target = SurfaceIndex(shapes.sphere(4, radius=11.0))
    rng = np.random.default_rng(0)
    rough = 0.08 * ball.vertices + 0.2 * ball.mean_edge * rng.normal(size=ball.vertices.shape)
    told: list[float] = []
    known = relax.Shapes.of(ball, Reference(ball), target.surface)
    out, left, landed = relax.settle(
        known,
        Reference(ball),
        rough,
        target,
        None,
        MorphSettings(),
        lambda fraction, text: told.append(fraction),
    )
    moved = ball.moved(ball.vertices + out)
    assert not len(left)
    assert np.abs(landed - moved.vertices).max() < 1e-9  # nothing had to be mended
    assert target.closest(moved.vertices).distance.max() < 1e-9
    assert aspect_ratio(moved).max() < 0.8 * aspect_ratio(ball.moved(ball.vertices + rough)).max()
    assert told == sorted(told)
    # a weight of zero keeps a node where the displacement has it
    weight = np.where(ball.vertices[:, 2] > 0, 0.0, 1.0)
    even = 0.08 * ball.vertices
    held, _, _ = relax.settle(
        known, Reference(ball), even, target, weight, MorphSettings(), lambda fraction, text: None
    )
    assert np.array_equal(held[weight == 0], even[weight == 0])
    assert target.closest((ball.vertices + held)[weight == 1]).distance.max() < 1e-9


def test_only_nodes_that_were_laid_on_the_target_are_said_to_lie_there():
    ball = shapes.sphere(3, radius=10.0)
    half = clean(ball.vertices, ball.faces[ball.corners[:, :, 2].min(axis=1) > -1.0]).surface
    target = SurfaceIndex(half)
    even = 0.02 * ball.vertices
    settings = MorphSettings(partial="target")
    ready = relax.Shapes.of(ball, Reference(ball), half)
    out, _, landed = relax.settle(
        ready, Reference(ball), even, target, None, settings, lambda fraction, text: None
    )
    known = np.isfinite(landed).all(axis=1)
    low = ball.vertices[:, 2] < -3.0
    assert known.any() and not known[low].any()
    assert target.closest(landed[known]).distance.max() < 1e-9
    assert target.closest((ball.vertices + out)[low]).distance.min() > 1.0
