# SPDX-License-Identifier: GPL-3.0-or-later
"""Alignment: known transforms recovered, from any pose, whole and partial, and what is said of it."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from surfaces import cut

from femors_addon import shapes
from femors_addon.align import DOUBT, DOUBT_WHOLE, align
from femors_addon.commandline import for_command
from femors_addon.icp import Cloud, Registration, icp, matched
from femors_addon.mesh import Float, Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.progress import Cancelled, FemorsError
from femors_addon.transforms import homogeneous, inverse, landmark_transform, transformed
from femors_addon.triples import renumbered
from femors_addon.units import size_ratio, unit_factor

BALL = shapes.sphere(3)
SHEAR = np.array([[1.1, 0.1, 0.0], [0.0, 0.95, 0.05], [0.02, 0.0, 1.2]])


def pose(seed: int, reach: float = 300.0) -> Float:
    """A random rotation and shift (4, 4); seed 0 is none."""
    if seed == 0:
        return np.eye(4)
    shift = np.random.default_rng(seed).normal(size=3) * reach
    return homogeneous(Rotation.random(random_state=seed).as_matrix(), shift)


def placed(matrix: Float, surface: Surface) -> Surface:
    return surface.moved(transformed(matrix, surface.vertices))


def mirrored(surface: Surface) -> Surface:
    """The other side's bone, outward again."""
    return Surface(surface.vertices * (-1, 1, 1), surface.faces[:, ::-1])


def off(matrix: Float, points: Float, truth: Float, size: float) -> float:
    """Mean distance between where points go and where they belong, as a share of a size."""
    return float(np.linalg.norm(transformed(matrix, points) - truth, axis=1).mean() / size)


@pytest.fixture(scope="module")
def bones() -> tuple[Surface, Surface]:
    """One bone, meshed twice."""
    return shapes.bone(900, seed=3), shapes.bone(1000, seed=3, lattice=1)


@pytest.fixture(scope="module")
def pair() -> shapes.Pair:
    """Two subjects."""
    return shapes.pair(900, 900, seed=1)


# --- whole meshes -------------------------------------------------------------------------------
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


# --- left and right, metres and millimetres -------------------------------------------------------
@pytest.mark.parametrize("seed", [0, 1])
def test_a_mirrored_source_is_told_and_mirrored_where_wished(pair, seed):
    other_side = placed(pose(seed), mirrored(pair.source))
    told = align(other_side, pair.target, "affine")
    assert np.linalg.det(told.matrix[:3, :3]) > 0
    assert len(told.warnings) == 1
    assert "mirror image fits the target better" in told.warnings[0]
    assert "tick Mirror" in told.warnings[0]
    done = align(other_side, pair.target, "affine", fix_mirror=True)
    assert np.linalg.det(done.matrix[:3, :3]) < 0
    assert "it was mirrored" in done.warnings[0]
    assert off(done.matrix, other_side.vertices, pair.truth, pair.target.diagonal) < 0.012
    assert done.residual < 0.5 * told.residual


def test_no_mirror_is_seen_where_there_is_none(pair):
    for source in (pair.source, shapes.sphere(3), shapes.box((1, 2, 3), 4)):
        target = pair.target if source is pair.source else source
        result = align(source, target, "affine", fix_mirror=True)
        assert result.warnings == ()
        assert np.linalg.det(result.matrix[:3, :3]) > 0


@pytest.mark.parametrize("factor", [10.0, 25.4, 100.0, 304.8, 1000.0])
@pytest.mark.parametrize("up", [True, False])
def test_another_unit_is_told_and_applied_where_wished(pair, factor, up):
    factor = factor if up else 1.0 / factor
    foreign = placed(homogeneous(np.eye(3) / factor, np.zeros(3)), pair.source)
    assert unit_factor(foreign, pair.target) == pytest.approx(factor)
    told = align(foreign, pair.target, "none")
    assert np.array_equal(told.matrix, np.eye(4))
    assert f"{factor:g} times its size" in told.warnings[0]
    assert "tick Convert units" in told.warnings[0]
    converted = align(foreign, pair.target, "none", fix_units=True)
    assert converted.matrix == pytest.approx(np.diag([factor, factor, factor, 1.0]))
    assert "was applied" in converted.warnings[0]


@pytest.mark.parametrize("kind", ["rigid", "affine"])
def test_millimetres_and_metres_end_at_one_place(pair, kind):
    plain = align(pair.source, pair.target, kind)
    size = pair.target.diagonal
    metres = placed(homogeneous(np.eye(3) / 1000, np.zeros(3)), pair.source)
    result = align(metres, pair.target, kind, fix_units=True)
    there = transformed(plain.matrix, pair.source.vertices)
    assert off(result.matrix, metres.vertices, there, size) < 1e-6
    # a rigid alignment that is not told to convert keeps the lengths that it is given
    if kind == "rigid":
        unchanged = align(metres, pair.target, kind).matrix[:3, :3]
        assert np.linalg.det(unchanged) == pytest.approx(1.0)


def test_sizes_as_people_have_them_are_no_other_unit(pair):
    for factor in (0.5, 0.8, 1.0, 1.5, 2.0):
        assert (
            unit_factor(placed(homogeneous(np.eye(3) * factor, np.zeros(3)), pair.source), pair.target)
            is None
        )


@pytest.mark.parametrize("ratio", [5.0, 6.0, 17.0, 1 / 5.5])
def test_merely_different_sizes_are_told_as_such(pair, ratio):
    other = placed(homogeneous(np.eye(3) / ratio, np.zeros(3)), pair.source)
    assert unit_factor(other, pair.target) is None
    for kind in ("none", "affine"):
        (said,) = align(other, pair.target, kind).warnings
        times = size_ratio(other, pair.target)
        words = f"{times:.4g} times larger" if ratio > 1 else f"{1 / times:.4g} times smaller"
        assert said == f"the target is {words} than the source"


@pytest.mark.parametrize("up", [True, False])
@pytest.mark.parametrize(
    ("ratio", "factor"),
    [(600.0, 1000.0), (450.0, 1000.0), (50.0, 100.0), (1.1e6, 1e6), (0.9e9, 1e9), (7.5, 10.0)],
)
def test_sizes_that_no_anatomy_has_are_another_unit(pair, ratio, factor, up):
    """An adult's bone in metres beside a child's in millimetres, of 0.6 and of 0.45 of its size."""
    if not up:
        ratio, factor = 1.0 / ratio, 1.0 / factor
    own = size_ratio(pair.source, pair.target)
    other = placed(homogeneous(np.eye(3) * own / ratio, np.zeros(3)), pair.source)
    assert unit_factor(other, pair.target) == pytest.approx(factor)


@pytest.mark.parametrize("ratio", [33.0, 1 / 33.0, 1e12])
def test_sizes_that_no_two_units_have_are_refused_with_their_ratio(pair, ratio):
    own = size_ratio(pair.source, pair.target)
    other = placed(homogeneous(np.eye(3) * own / ratio, np.zeros(3)), pair.source)
    words = "1e+12 times larger" if ratio > 1e3 else "33 times larger" if ratio > 1 else "33 times smaller"
    for fix in (False, True):
        with pytest.raises(FemorsError, match=re.escape(f"the target is {words}") + ".*: scale one of them"):
            align(other, pair.target, "none", fix_units=fix)


@pytest.mark.parametrize("times", [1e3, 1e6, 1e9])
def test_a_part_in_another_unit_is_told(pair, times):
    piece, _ = cut(pair.source, -99, 150)
    other = placed(homogeneous(np.eye(3) / times, np.zeros(3)), piece)
    assert unit_factor(other, pair.target, "source") == times
    assert unit_factor(pair.target, other, "target") == 1.0 / times


# --- parts --------------------------------------------------------------------------------------
PARTS = {
    "far end": (-99, 150),
    "near end": (220, 999),
    "all but the far end": (100, 999),
    "all but the near end": (-99, 300),
}


@pytest.mark.parametrize("seed", [0, 2])
@pytest.mark.parametrize("part", PARTS)
def test_a_part_finds_its_place_on_the_whole(bones, part, seed):
    """The same shape: what is left is within the mean edge of the meshes; from any pose."""
    source, target = bones
    piece, _ = cut(source, *PARTS[part])
    start = pose(seed)
    result = align(placed(start, piece), target, "rigid", partial="source")
    assert off(result.matrix @ start, piece.vertices, piece.vertices, target.diagonal) < 6e-3
    assert result.residual < target.mean_edge
    assert DOUBT not in result.warnings


@pytest.mark.parametrize("seed", [0, 2])
@pytest.mark.parametrize("part", PARTS)
def test_the_whole_finds_its_place_on_a_part(bones, part, seed):
    source, target = bones
    piece, _ = cut(target, *PARTS[part])
    start = pose(seed)
    result = align(placed(start, source), piece, "rigid", partial="target")
    # what the part does not show hangs on a long lever
    assert off(result.matrix @ start, source.vertices, source.vertices, target.diagonal) < 0.015
    _, there = cut(source, *PARTS[part])
    points = source.vertices[there]
    assert off(result.matrix @ start, points, points, target.diagonal) < 6e-3
    assert result.residual < target.mean_edge


def test_it_is_told_where_a_part_fits_in_several_places(bones):
    """A cap fits a ball everywhere; of a bone the pose is certain, and landmarks leave no doubt."""
    ball = shapes.sphere(4)
    cap = Surface(ball.vertices, ball.faces[(ball.corners[:, :, 2] > 0.3).all(axis=1)])
    kept, faces = renumbered(cap.faces, len(cap.vertices))
    cap = Surface(ball.vertices[kept], faces)
    assert DOUBT in align(placed(pose(3), cap), ball, "rigid", partial="source").warnings
    assert DOUBT in align(ball, placed(pose(3), cap), "rigid", partial="target").warnings
    points = cap.vertices[:4]
    marked = align(cap, ball, "rigid", partial="source", landmarks=(points, points))
    assert DOUBT not in marked.warnings
    assert DOUBT not in align(ball, ball, "rigid").warnings  # of whole meshes it is not asked


@pytest.mark.parametrize("part", PARTS)
def test_parts_of_another_subject(pair, part):
    """One-sided and trimmed: not squeezed into the other, as the whole would be."""
    size = pair.target.diagonal
    piece, used = cut(pair.source, *PARTS[part])
    result = align(placed(pose(1), piece), pair.target, "affine", partial="source")
    assert off(result.matrix @ pose(1), piece.vertices, pair.truth[used], size) < 0.015
    piece, _ = cut(pair.target, *PARTS[part])
    there = (pair.truth[:, 2] > PARTS[part][0]) & (pair.truth[:, 2] < PARTS[part][1])
    result = align(placed(pose(1), pair.source), piece, "affine", partial="target")
    assert off(result.matrix @ pose(1), pair.source.vertices[there], pair.truth[there], size) < 0.015
    assert 0.6 < np.linalg.det(result.matrix[:3, :3]) < 1.6


# --- landmarks ----------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["rigid", "similarity", "affine"])
def test_landmarks_give_the_known_transform(kind):
    rng = np.random.default_rng(0)
    points = rng.normal(size=(6, 3)) * 50
    linear = {"rigid": np.eye(3), "similarity": 2.5 * np.eye(3), "affine": SHEAR}[kind]
    known = pose(4) @ homogeneous(linear, (1.0, 2.0, 3.0))
    assert landmark_transform(points, transformed(known, points), kind) == pytest.approx(known, abs=1e-9)


def test_landmarks_are_fitted_by_least_squares():
    """No nearby rigid transform or similarity does better; a mirrored set is not mirrored back."""
    rng = np.random.default_rng(1)
    points, goals = rng.normal(size=(2, 7, 3))
    for kind in ("rigid", "similarity"):
        for goal in (goals, points * (-1, 1, 1)):
            found = landmark_transform(points, goal, kind)
            assert np.linalg.det(found[:3, :3]) > 0
            least = np.sum((transformed(found, points) - goal) ** 2)
            for _ in range(50):
                growth = 1.0 + (kind == "similarity") * rng.normal() * 1e-2
                nudge = homogeneous(
                    growth * Rotation.from_rotvec(rng.normal(size=3) * 1e-2).as_matrix(),
                    rng.normal(size=3) * 1e-2,
                )
                assert np.sum((transformed(nudge @ found, points) - goal) ** 2) >= least


def test_three_landmarks_do_and_four_in_a_plane_are_no_affine_map():
    rng = np.random.default_rng(2)
    for points in (rng.normal(size=(3, 3)), rng.normal(size=(6, 3)) * (1, 1, 0)):
        known = homogeneous(1.5 * pose(5)[:3, :3], (1.0, 1.0, 1.0))
        for kind in ("similarity", "affine"):
            found = landmark_transform(points, transformed(known, points), kind)
            assert transformed(found, points) == pytest.approx(transformed(known, points), abs=1e-9)
            assert np.linalg.det(found[:3, :3]) == pytest.approx(1.5**3)


@pytest.mark.parametrize(
    ("source", "target", "words"),
    [
        (np.eye(3)[:2], np.eye(3)[:2], "at least 3 .* not 2"),
        (np.empty((0, 3)), np.empty((0, 3)), "at least 3"),
        (np.eye(3), np.ones((4, 3)), "source has 3, target has 4"),
        (np.outer(np.arange(5), (1.0, 2.0, 3.0)), np.ones((5, 3)), "on one line"),
        (np.ones((3, 3)), np.eye(3), "source's landmarks lie on one line"),
        (np.eye(3), np.outer(np.arange(3), (1.0, 2.0, 3.0)), "on one line"),
        (np.eye(3), np.ones((3, 3)), "target's landmarks lie on one line"),
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], np.eye(3), "not finite"),
        (np.eye(3), [[0, 0, 0], [1, 0, 0], [0, np.inf, 0]], "not finite"),
    ],
)
def test_landmarks_that_fix_nothing_are_told(source, target, words):
    with pytest.raises(FemorsError, match=words) as error:
        landmark_transform(source, target)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("partial", ["none", "source", "target"])
def test_landmarks_start_the_alignment(pair, partial):
    """Roughly placed, they lead to where the search over poses ends; no mirror is looked for."""
    at = [10, 200, 400, 600, 800]
    rough = pair.truth[at] + np.random.default_rng(0).normal(size=(5, 3)) * 3.0
    start = pose(3)
    marks = (transformed(start, pair.source.vertices[at]), rough)
    result = align(placed(start, pair.source), pair.target, "affine", partial=partial, landmarks=marks)
    assert off(result.matrix @ start, pair.source.vertices, pair.truth, pair.target.diagonal) < 0.02
    if partial == "none":
        plain = align(pair.source, pair.target, "affine")
        there = transformed(plain.matrix, pair.source.vertices)
        assert off(result.matrix @ start, pair.source.vertices, there, pair.target.diagonal) < 1e-3


def test_landmarks_outrule_the_search():
    """A ball has no pose of its own: the landmarks decide it."""
    ball = shapes.sphere(3)
    turn = pose(6)
    marks = (ball.vertices[:5], transformed(turn, ball.vertices[:5]))
    result = align(ball, placed(turn, ball), "rigid", landmarks=marks)
    assert result.matrix == pytest.approx(turn, abs=1e-6)


# --- small parts --------------------------------------------------------------------------------
def test_inverse_is_the_inverse():
    for seed in range(5):
        matrix = pose(seed + 1) @ homogeneous(SHEAR * 10.0 ** (seed - 2), (1e3, 0.0, -5.0))
        assert inverse(matrix) @ matrix == pytest.approx(np.eye(4), abs=1e-8)
