# SPDX-License-Identifier: GPL-3.0-or-later
"""Alignment of whole meshes: known transforms recovered, from any pose, and what is said of it."""

from __future__ import annotations

import numpy as np
import pytest
from aligncases import BALL, SHEAR, TURNED_BALL, off, placed, pose, subjects, twice
from scipy.spatial.transform import Rotation

from femors_addon import shapes
from femors_addon.align import DOUBT, DOUBT_WHOLE, align
from femors_addon.commandline import for_command
from femors_addon.icp import Cloud, Registration, icp, matched
from femors_addon.mesh import Float, Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.poses import _same_shape, best_start, decided, principal_frame
from femors_addon.progress import Cancelled
from femors_addon.transforms import homogeneous, inverse, transformed


@pytest.fixture(scope="module")
def bones():
    """One bone, meshed twice."""
    return twice()


@pytest.fixture(scope="module")
def pair():
    """Two subjects."""
    return subjects()


# --- whole meshes ---------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("kind", ["rigid", "similarity", "affine"])
def test_a_known_transform_is_recovered(bones, kind, seed):
    linear = {"rigid": np.eye(3), "similarity": 1.3 * np.eye(3), "affine": SHEAR}[kind]
    known = pose(seed) @ homogeneous(linear, (5.0, -3.0, 2.0))
    source, meshed_anew = bones
    truth = transformed(known, source.vertices)
    size = source.diagonal
    same = align(source, placed(known, source), kind)
    assert off(same.matrix, source.vertices, truth, size) < 1e-4
    # another mesh of the same shape: to a small part of the mean edge, which is 2.5 % of the size here
    other = align(source, placed(known, meshed_anew), kind)
    assert off(other.matrix, source.vertices, truth, size) < 1.5e-3
    assert same.warnings == other.warnings == ()
    assert other.residual < 0.02 * size


@pytest.mark.parametrize("kind", ["rigid", "similarity", "affine"])
def test_what_a_kind_may_do(pair, kind):
    """Rigid keeps lengths, similarity keeps their ratios, and neither mirrors; the more free, the closer."""
    result = align(pair.source, pair.target, kind)
    linear = result.matrix[:3, :3]
    product = linear.T @ linear
    assert np.linalg.det(linear) > 0
    assert result.matrix[3].tolist() == [0, 0, 0, 1]
    if kind == "rigid":
        assert product == pytest.approx(np.eye(3), abs=1e-9)
    if kind == "similarity":
        assert product / product[0, 0] == pytest.approx(np.eye(3), abs=1e-9)
    limit = {"rigid": 0.06, "similarity": 0.02, "affine": 0.012}[kind]
    assert off(result.matrix, pair.source.vertices, pair.truth, pair.target.diagonal) < limit


def test_none_leaves_the_source_where_it_is(pair):
    result = align(placed(pose(1), pair.source), pair.target, "none")
    assert np.array_equal(result.matrix, np.eye(4))
    assert result.residual > 0.1 * pair.target.diagonal


@pytest.mark.parametrize("kind", ["rigid", "affine"])
def test_twenty_poses_end_at_one_place(pair, kind):
    """The result is a function of the shape, not of where it lies."""
    size, ends = pair.target.diagonal, []
    for seed in range(20 if kind == "affine" else 3):
        start = pose(seed, reach=10.0 * size)
        ends.append(align(placed(start, pair.source), pair.target, kind).matrix @ start)
    first = transformed(ends[0], pair.source.vertices)
    for end in ends[1:]:
        assert np.abs(transformed(end, pair.source.vertices) - first).max() < 1e-6 * size


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("source", "target", "reached"),
    [
        (shapes.sphere(3), shapes.sphere(3, radius=2.0, centre=(5, 6, 7)), 3e-3),
        (shapes.box((1, 2, 3), 4), shapes.box((1.1, 1.8, 3.5), 5), 1e-2),
        (shapes.box((1, 1, 1), 4), shapes.box((1.2, 1, 1), 5), 1.5e-2),
        (shapes.box((100, 60, 0.5), (20, 12, 1)), shapes.box((100, 60, 0.5), (25, 15, 1)), 2e-3),
        (shapes.box((1, 1, 200), (2, 2, 100)), shapes.box((1, 1, 200), (2, 2, 80)), 1e-3),
    ],
    ids=["ball", "block", "cube", "sheet", "rod"],
)
def test_compact_flat_and_long_shapes(source, target, reached, seed):
    """Whatever the principal axes leave open."""
    source = placed(pose(seed, 10.0), source)
    result = align(source, target, "affine")
    distance = SurfaceIndex(target).closest(transformed(result.matrix, source.vertices)).distance
    assert distance.mean() < reached * target.diagonal
    assert np.linalg.det(result.matrix[:3, :3]) > 0


@pytest.mark.parametrize("partial", ["none", "source", "target"])
@pytest.mark.parametrize("kind", ["rigid", "similarity", "affine"])
def test_starts_side_by_side_end_where_each_ends_alone(pair, kind, partial):
    source, target = pair[:2]
    work = Registration(Cloud.of(source), Cloud.of(target), partial, 1e-4 * target.diagonal)
    turns = Rotation.random(6, random_state=2).as_matrix()
    starts = np.array([homogeneous(turn, target.vertices.mean(axis=0)) for turn in turns])
    found = icp(work, starts, kind, 20)
    assert len({round(fit.misfit, 3) for fit in found}) > 1  # they end in several places
    for start, fit in zip(starts, found, strict=True):
        (alone,) = icp(work, start[None], kind, 20)
        assert fit.misfit == pytest.approx(alone.misfit, rel=1e-6)
        assert matched(work, fit.matrix[None]).misfit[0] == pytest.approx(fit.misfit, rel=1e-9)


def test_the_same_bits_every_time(pair):
    one, two = (align(pair.source, pair.target, "affine") for _ in range(2))
    assert one.matrix.tobytes() == two.matrix.tobytes()
    assert one.residual == two.residual


def test_the_source_is_not_touched_and_progress_may_cancel(pair):
    told: list[float] = []
    before = pair.source.vertices.copy()
    align(pair.source, pair.target, "affine", progress=lambda fraction, text: told.append(fraction))
    assert np.array_equal(pair.source.vertices, before)
    assert told == sorted(told)
    assert (told[0], told[-1]) == (0.0, 1.0)
    for last in range(len(told)):
        seen = []

        def cancel(fraction, text, seen=seen, last=last):
            seen.append(fraction)
            if len(seen) > last:
                raise Cancelled

        with pytest.raises(Cancelled):
            align(pair.source, pair.target, "affine", progress=cancel)


# --- unlike shapes, which fit in several poses ----------------------------------------------------
def knobbed(rng: np.random.Generator, radii: tuple[float, float, float]) -> Surface:
    """An ellipsoid with three knobs at random places."""
    ball = shapes.sphere(3)
    reach = np.ones(len(ball.vertices))
    for _ in range(3):
        at, height, width = rng.normal(size=3), rng.uniform(0.2, 0.5), rng.uniform(0.25, 0.5)
        angle = np.arccos(np.clip(ball.vertices @ (at / np.linalg.norm(at)), -1, 1))
        reach += height * np.exp(-((angle / width) ** 2) / 2)
    return ball.moved(ball.vertices * reach[:, None] * radii)


def shuffled(surface: Surface, seed: int) -> Surface:
    """The same mesh, its vertices and faces in another order."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(surface.vertices))
    faces = np.argsort(order)[surface.faces][rng.permutation(len(surface.faces))]
    return Surface(surface.vertices[order], faces.astype(np.int32))


@pytest.fixture(scope="module")
def unlike() -> tuple[Surface, Surface]:
    """Two shapes of which one, laid onto the other, fits about equally well in several poses."""
    rng = np.random.default_rng(11)
    return knobbed(rng, (1.0, 1.3, 1.7)), knobbed(rng, (1.0, 1.2, 1.6))


def test_the_doubt_names_the_options_on_the_command_line():
    for words in (DOUBT, DOUBT_WHOLE):
        assert for_command(words).endswith("or pass --source-landmarks and --target-landmarks")


def test_the_order_of_the_vertices_does_not_choose_the_pose(unlike):
    """A sheared fit with few samples chose poses 36 to 75 degrees apart for these three orders."""
    source, target = unlike
    ends = [align(mesh, target).matrix for mesh in (source, shuffled(source, 1), shuffled(source, 3))]
    first = transformed(ends[0], source.vertices)
    for end in ends[1:]:
        assert off(end, source.vertices, first, target.diagonal) < 0.02


def test_it_is_told_where_whole_shapes_fit_in_several_poses(unlike):
    source, target = unlike
    for mesh in (source, shuffled(source, 1)):
        assert align(mesh, target).warnings == (DOUBT_WHOLE,)
    marks = source.vertices[::100]
    assert align(source, target, landmarks=(marks, marks)).warnings == ()


def outgrown(seed: int) -> tuple[Surface, Surface]:
    """Two ellipsoids with four knobs each in the same places, of heights that have nothing in common."""
    ball, heights = shapes.sphere(3), np.random.default_rng(1000 + seed).uniform(0.2, 1.0, (2, 4))
    out = []
    for tall, radii in zip(heights, ((1.0, 1.2, 1.4), (1.1, 1.0, 1.5)), strict=True):
        rng, reach = np.random.default_rng(seed), np.ones(len(ball.vertices))
        for height in tall:
            at, width = rng.normal(size=3), rng.uniform(0.2, 0.45)
            angle = np.arccos(np.clip(ball.vertices @ (at / np.linalg.norm(at)), -1, 1))
            reach += height * np.exp(-((angle / width) ** 2) / 2)
        out.append(ball.moved(ball.vertices * reach[:, None] * radii))
    return out[0], out[1]


@pytest.mark.parametrize("seed", [11, 25, 32, 36])
def test_knobs_that_grew_differently_are_laid_on_each_other(seed):
    """By distance alone poses 150 to 174 degrees off were as near; by position and normal they are not."""
    source, target = outgrown(seed)
    start = pose(seed + 1)
    turned = align(placed(start, source), target).matrix[:3, :3] @ start[:3, :3]
    u, _, v = np.linalg.svd(turned)
    assert np.degrees(np.arccos((np.trace(u @ v) - 1) / 2)) < 20


@pytest.mark.parametrize(
    ("source", "target"),
    [
        (shapes.sphere(3), shapes.sphere(3, radius=2.0, centre=(5, 6, 7))),
        (placed(np.diag([1.0, 2.0, 3.0, 1.0]), BALL), placed(np.diag([1.2, 1.9, 3.0, 1.0]), BALL)),
        (shapes.box((1, 2, 3), 4), shapes.box((1.1, 1.8, 3.5), 5)),
        (shapes.box((1, 1, 1), 6), shapes.sphere(3)),
        (shapes.bone(900, seed=1), shapes.bone(1000, seed=2, lattice=1)),
    ],
    ids=["balls", "ellipsoids", "blocks", "cube and ball", "bones"],
)
def test_no_pose_is_doubted_where_it_does_not_matter(source, target):
    """A shape that lies on itself when turned has no pose of its own; two bones of a kind have one."""
    for start in (pose(0), pose(1, 10.0)):
        assert align(placed(start, source), target).warnings == ()


def turn_between(one: Float, two: Float) -> float:
    """Angle in degrees between the rotations next to two matrices (4, 4)."""
    u, _, v = np.linalg.svd(one[:3, :3] @ np.linalg.inv(two[:3, :3]))
    return float(np.degrees(np.arccos(np.clip((np.trace(u @ v) - 1) / 2, -1, 1))))


@pytest.mark.parametrize("angle", [10, 35, 90])
@pytest.mark.parametrize(
    ("shape", "target"),
    [
        (placed(np.diag([1.0, 1.3, 1.7, 1.0]), BALL), placed(np.diag([1.1, 1.25, 1.8, 1.0]), TURNED_BALL)),
        (placed(np.diag([1.0, 1.0, 3.0, 1.0]), BALL), placed(np.diag([1.1, 1.0, 3.1, 1.0]), TURNED_BALL)),
        (
            shapes.box((4, 3, 1), 8, low=(-2, -1.5, -0.5)),
            shapes.box((4.2, 2.9, 1), 7, low=(-2.1, -1.4, -0.5)),
        ),
    ],
    ids=["ellipsoid", "spindle", "plate"],
)
def test_a_shape_that_lies_on_itself_is_not_turned_more_than_it_must_be(shape, target, angle):
    """It fits as well in other poses, and was turned by half a turn: landmarks would end elsewhere."""
    axis = np.array([3.0, -1.0, 1.0]) / np.sqrt(11.0)
    start = homogeneous(Rotation.from_rotvec(np.radians(angle) * axis).as_matrix(), (30.0, -20.0, 10.0))
    found = align(placed(start, shape), target)
    assert turn_between(found.matrix, np.eye(4)) < angle + 8
    assert not found.warnings


@pytest.mark.parametrize(
    ("shape", "angle", "axis"),
    [
        (placed(np.diag([1.0, 1.0, 3.0, 1.0]), BALL), 35, (3, -1, 1)),
        (shapes.box((4, 4, 1), 8, low=(-2, -2, -0.5)), 10, (3, -1, 1)),
        (shapes.box((2, 2, 2), 6, low=(-1, -1, -1)), 25, (1, 2, 3)),
        (shapes.box((2, 2, 2), 6, low=(-1, -1, -1)), 35, (3, -1, 1)),
    ],
    ids=["spindle", "plate", "cube", "cube turned more"],
)
def test_a_shape_that_lies_on_itself_is_laid_onto_its_own_mesh_as_it_was(shape, angle, axis):
    """All poses in which nodes fall on nodes leave nothing: none is better for its rounding."""
    axis = np.array(axis) / np.linalg.norm(axis)
    turn = Rotation.from_rotvec(np.radians(angle) * axis).as_matrix()
    start = homogeneous(turn, np.array([0.3, 0.21, 0.09]) * shape.diagonal)
    found = align(placed(start, shape), shape)
    assert turn_between(found.matrix, np.eye(4)) < angle + 1
    assert not found.warnings


def test_what_is_turned_back_does_not_lie_on_itself():
    """ICP of a bone with itself, a sixth of a turn apart, finds it as it was; a spindle it leaves there."""
    bone, spindle = shapes.bone(900, seed=1), placed(np.diag([1.0, 1.0, 3.0, 1.0]), BALL)
    for shape, same in ((bone, False), (spindle, True)):
        work = Registration(Cloud.of(shape), Cloud.of(shape), "none", 1e-5 * shape.diagonal)
        axis = principal_frame(shape.vertices).axes[:, 0]
        turn = homogeneous(Rotation.from_rotvec(np.pi / 3 * axis).as_matrix(), (0.0, 0.0, 0.0))
        assert _same_shape(work, np.eye(4), turn) == same


def test_the_given_pose_does_not_choose_among_poses_of_another_shape(unlike):
    """They fit about equally well, and one of them only is right: it is the same from wherever one starts."""
    source, target = unlike
    work = Registration(Cloud.of(source), Cloud.of(target), "none", 1e-5 * target.diagonal)
    start = best_start(work, np.eye(4), "similarity", np.eye(4))
    assert len(start.close) > 2
    ends = [decided(work, start, fit.matrix, "similarity") for fit in start.close]
    for end in ends:
        assert end.doubtful
        assert np.array_equal(end.matrix, ends[0].matrix)


# --- small parts ----------------------------------------------------------------------------------
def test_inverse_is_the_inverse():
    for seed in range(5):
        matrix = pose(seed + 1) @ homogeneous(SHEAR * 10.0 ** (seed - 2), (1e3, 0.0, -5.0))
        assert inverse(matrix) @ matrix == pytest.approx(np.eye(4), abs=1e-8)
