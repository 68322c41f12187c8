# SPDX-License-Identifier: GPL-3.0-or-later
"""The morph as a whole: known maps recovered, any mesh endured, and every way it ends."""

from __future__ import annotations

import dataclasses
import itertools
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from surfaces import cut, soup, together

from femors_addon import morph_fit, morph_outcome, shapes
from femors_addon import settings as declared
from femors_addon.commandline import for_command
from femors_addon.mesh import Float, Surface, triangulate
from femors_addon.morph import PRESETS, MorphResult, MorphSettings, morph
from femors_addon.morph_fit import verdict
from femors_addon.nearest import SurfaceIndex
from femors_addon.progress import FemorsError
from femors_addon.quality import flipped_faces
from femors_addon.report_files import report_bytes
from femors_addon.transforms import transformed

STAY = MorphSettings(alignment="none")
LAYERED = MorphSettings(levels=2, reduction=0.4, iterations=4, fine_iterations=3)
"""All stages, on meshes of a few hundred nodes."""


def ellipsoid(halvings: int = 2, radii: tuple[float, float, float] = (1.0, 1.3, 1.7)) -> Surface:
    ball = shapes.sphere(halvings)
    return ball.moved(ball.vertices * radii)


SMALL, GOAL = ellipsoid(), ellipsoid(2, (1.2, 1.2, 2.0))


def finite(result: MorphResult, source: Surface) -> bool:
    """One finite number for whatever the source has."""
    assert result.vertices.shape == source.vertices.shape
    assert result.surface_distance.shape == result.displacement.shape == (len(source.vertices),)
    arrays = (result.vertices, result.surface_distance, result.displacement, result.transform)
    json.dumps(result.report(), allow_nan=False)
    return all(np.isfinite(array).all() for array in arrays)


@pytest.fixture(scope="module")
def pair() -> shapes.Pair:
    """Two subjects, meshed independently, the true place of every vertex known."""
    return shapes.pair(900, 800, seed=1)


@pytest.fixture(scope="module")
def morphed(pair) -> MorphResult:
    return morph(pair.source, pair.target)


# --- what must come out ---------------------------------------------------------------------------
def test_a_shape_onto_itself_stays():
    """Same mesh: no vertex moves. Same shape meshed anew: within the facets of the two."""
    bone = shapes.bone(900)
    result = morph(bone, bone)
    assert np.abs(result.vertices - bone.vertices).max() < 1e-9 * bone.diagonal
    assert result.converged
    anew = morph(bone, shapes.bone(900, lattice=1))
    # 0.15 of the mean edge measured
    assert np.linalg.norm(anew.vertices - bone.vertices, axis=1).mean() < 0.3 * bone.mean_edge
    assert anew.after.surface_to_target.maximum < 1e-6 * bone.diagonal


@pytest.mark.parametrize(
    ("nodes", "seed", "posed"), [(900, 1, False), (900, 2, True), (2500, 0, True), (2500, 3, False)]
)
def test_a_known_smooth_map_is_recovered(nodes, seed, posed):
    """Mean error of 0.25 to 0.6 % of the size measured."""
    source, target, truth = shapes.pair(nodes, nodes - 100, seed=seed, posed=posed)
    result = morph(source, target)
    error = np.linalg.norm(result.vertices - truth, axis=1) / target.diagonal
    aligned = np.linalg.norm(transformed(result.transform, source.vertices) - truth, axis=1) / target.diagonal
    assert error.mean() < 0.008
    assert error.max() < 0.03
    # where nothing tells how far to slide along a shaft, a coarse mesh may lose a little
    assert error.mean() < (1.0 if nodes > 2000 else 1.5) * aligned.mean()
    assert result.converged
    assert result.after.surface_to_target.p99 < 1e-6 * target.diagonal
    assert result.after.target_to_surface.p99 < 0.35 * target.mean_edge
    assert result.after.flipped == result.after.self_intersecting == 0
    assert result.after.aspect.p99 < 1.15 * result.before.aspect.p99


def test_what_the_result_says_is_so(pair, morphed):
    """Its figures, measured again from outside."""
    source, target = pair.source, pair.target
    after = source.moved(morphed.vertices)
    assert morphed.surface_distance == pytest.approx(SurfaceIndex(target).closest(morphed.vertices).distance)
    aligned = transformed(morphed.transform, source.vertices)
    assert morphed.displacement == pytest.approx(np.linalg.norm(morphed.vertices - aligned, axis=1), abs=1e-9)
    assert morphed.after.flipped == len(flipped_faces(source, after))
    back = SurfaceIndex(after).closest(target.vertices).distance
    assert morphed.after.target_to_surface.maximum == pytest.approx(back.max())
    assert morphed.before.surface_to_target.maximum == pytest.approx(
        SurfaceIndex(target).closest(aligned).distance.max()
    )
    assert morphed.seconds > 0
    assert morphed.history
    assert all(
        step.spread > 0 and step.nodes > 0 and np.isfinite(step.rms + step.largest)
        for step in morphed.history
    )
    assert morphed.settings == MorphSettings()


@pytest.mark.parametrize(
    ("partial", "far", "words"),
    [
        ("none", 4, "not converged: 96.0 % of the result is within 1.2 of the target, where 99 % should be"),
        ("none", 1, "converged: 99 % of each surface is within"),
        (
            "source",
            60,
            "not converged: 40.0 % of the result's nodes are within 1.2 of the target's nodes around them, "
            "where half should be (half are within 7)",
        ),
        (
            "source",
            40,
            "converged over the shared part: 60.0 % of the result's nodes are within 1.2 of the target's "
            "nodes around them, where half should be (half are within 0.5)",
        ),
        (
            "target",
            60,
            "converged over the shared part: 100.0 % of the target's nodes are within 1.2 of the result's "
            "surface, where half should be (half are within 0.25)",
        ),
    ],
)
def test_the_verdict_says_what_share_is_near(partial, far, words):
    near, some = np.full(100, 0.25), np.full(100, 0.5)
    some[:far] = 7.0
    some[:1] = 1.1 if far == 1 else 7.0
    settings = MorphSettings(partial=partial)
    laid, around = (some, some) if partial == "none" else (np.zeros(100), some)
    converged, reason = verdict(laid, near, around, settings, size=100.0, edge=1.0, weighted=False)
    assert reason.startswith(words) and converged == words.startswith("converged")
    assert converged or reason.endswith(" within 7)")


@pytest.mark.parametrize("closed", [False, True])
def test_the_verdict_on_a_partial_source_is_no_distance_that_is_zero_by_construction(pair, closed):
    """The target's nodes around the result are measured; the face that closes the cut does not count."""
    source = cut(pair.source, -99, 200)[0]
    if closed:
        rim = source.edges[source.border[source.edges].all(axis=1)]
        middle = source.vertices[source.border].mean(axis=0)
        fan = np.column_stack((rim, np.full(len(rim), len(source.vertices))))
        source = Surface(np.vstack((source.vertices, middle)), np.vstack((source.faces, fan)))
    result = morph(source, pair.target, MorphSettings(partial="source"))
    said = float(result.stop_reason.split("half are within ")[1].rstrip(")"))
    assert result.converged
    assert result.after.surface_to_target.median < 1e-9
    assert 0.1 < said < pair.target.mean_edge
    assert said == pytest.approx(np.median(result.residual), rel=0.01)


HINT = "set Overlap to "


@pytest.mark.parametrize("alignment", ["affine", "rigid"])
@pytest.mark.parametrize(("low", "high"), [(-99, 150), (250, 999), (-99, 250)])
def test_a_part_that_is_morphed_onto_a_whole_is_told(pair, low, high, alignment):
    """Drawn out over the whole it converges all the same; by a rigid alignment it falls short."""
    source = cut(pair.source, low, high)[0]
    said = morph(source, pair.target, MorphSettings(alignment=alignment)).warnings
    assert [for_command(note) for note in said if HINT in note] == [
        "the source is open and the target closed: if the source shows only a part of what the target shows, "
        "pass --partial source"
    ]
    assert not any(
        HINT in note for note in morph(source, pair.target, MorphSettings(partial="source")).warnings
    )


def test_a_whole_that_is_morphed_onto_a_part_is_told(pair):
    notes = morph(pair.source, cut(pair.target, -99, 200)[0]).warnings
    (said,) = (note for note in notes if HINT in note)
    assert "the target is open and the source closed" in said and "set Overlap to Target is part" in said


def test_open_meshes_of_the_same_part_are_not_told_of_overlap(pair, morphed):
    """Both cut; one with a hole; one cut a little shorter; both closed."""
    height = pair.source.bounds[1][2]
    holed = Surface(pair.source.vertices, pair.source.faces[6:])
    results = (
        morphed,
        morph(holed, pair.target),
        morph(cut(pair.source, -99, 200)[0], cut(pair.target, -99, 190)[0]),
        morph(cut(pair.source, -99, height - 8)[0], pair.target),
    )
    assert [[note for note in result.warnings if HINT in note] for result in results] == [[]] * 4
    assert all(result.converged for result in results)


def test_distances_beyond_a_partial_target_are_so_too(pair):
    target = cut(pair.target, -99, 200)[0]
    result = morph(pair.source, target, MorphSettings(partial="target"))
    there = SurfaceIndex(target).closest(result.vertices).distance
    assert there.max() > 50
    assert result.surface_distance == pytest.approx(there, abs=1e-9)
    assert result.after.surface_to_target.maximum == pytest.approx(there.max())


def test_the_report_is_json_and_the_summary_text(morphed):
    report = json.loads(json.dumps(morphed.report(), allow_nan=False))
    assert report["converged"] is True
    assert report["settings"]["alignment"] == "affine"
    assert len(report["history"]) == len(morphed.history)
    assert {"before", "after", "warnings", "stop_reason", "transform"} <= set(report)
    lines = morphed.summary().splitlines()
    assert 5 < len(lines) < 20
    assert max(map(len, lines)) < 120


def test_a_sample_that_tells_the_figures_before_is_told(pair, morphed, monkeypatch):
    assert "sample" not in json.dumps(morphed.report()) and "sample" not in morphed.summary()
    monkeypatch.setattr(morph_outcome, "BEFORE", 300)
    result = morph(pair.source, pair.target)
    said = "aligned: distances at a sample of the vertices, at most 300 of each mesh"
    assert said in result.summary().splitlines()
    assert json.loads(report_bytes("r.json", result.report(), "t"))["sampled"] == said
    assert f'sampled,"{said}"' in report_bytes("r.csv", result.report(), "t").decode().splitlines()
    assert f"<td>{said}</td>" in report_bytes("r.html", result.report(), "t").decode()


def test_progress_rises_and_says_where_it_is(pair):
    told: list[tuple[float, str]] = []
    morph(SMALL, GOAL, LAYERED, lambda fraction, text: told.append((fraction, text)))
    fractions = [fraction for fraction, _ in told]
    assert fractions[0] == 0.0
    assert fractions[-1] == 1.0
    assert all(b >= a - 1e-9 for a, b in itertools.pairwise(fractions))
    words = " ".join(text for _, text in told)
    assert all(
        word in words for word in ("alignment", "reduced", "dense", "iteration 1 of", "RMS", "relaxation")
    )


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_runs(pair, preset):
    """*As published* has lengths in mm, and this pair is in mm."""
    result = morph(pair.source, pair.target, PRESETS[preset])
    assert finite(result, pair.source)
    assert result.converged
    assert result.settings.preset == preset
    assert result.after.flipped == 0
    assert result.after.surface_to_target.p99 < {"published": 0.01, "gross": 0.01}.get(preset, 1e-6) * 450.0
    error = np.linalg.norm(result.vertices - pair.truth, axis=1)
    assert error.mean() < (0.02 if preset == "published" else 0.012) * pair.target.diagonal


def test_tolerance_skips_what_changes_nothing():
    """Iterations end early once steps are small, and the result hardly differs."""
    strict, loose = (morph(SMALL, GOAL, dataclasses.replace(STAY, tolerance=t)) for t in (0.0, 0.02))
    assert len(loose.history) < len(strict.history)
    assert np.abs(strict.vertices - loose.vertices).max() < 0.1 * SMALL.mean_edge


# --- the same again -------------------------------------------------------------------------------
def test_the_same_bits_every_time(pair, morphed):
    again = morph(Surface(pair.source.vertices, pair.source.faces), pair.target)
    assert again.vertices.tobytes() == morphed.vertices.tobytes()
    assert again.history == morphed.history
    assert again.transform.tobytes() == morphed.transform.tobytes()


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_the_unit_does_not_matter(pair, morphed, unit):
    """Both in metres, or in micrometres."""
    result = morph(
        pair.source.moved(pair.source.vertices * unit), pair.target.moved(pair.target.vertices * unit)
    )
    assert result.vertices / unit == pytest.approx(morphed.vertices, abs=1e-6 * pair.target.diagonal)


def test_a_source_in_another_unit_gives_the_same_shape(pair, morphed):
    metres = pair.source.moved(pair.source.vertices / 1000)
    said = []
    with pytest.raises(
        FemorsError, match=r"1000 times its size would fit the target; tick Convert units .*set Overlap"
    ):
        morph(metres, pair.target, progress=lambda fraction, text: said.append(text))
    assert said == ["cleaning"]
    result = morph(metres, pair.target, MorphSettings(fix_units=True))
    assert result.vertices == pytest.approx(morphed.vertices, abs=1e-4 * pair.target.diagonal)
    assert any("1000 times" in warning and "was applied" in warning for warning in result.warnings)


@pytest.mark.parametrize("seed", range(3))
def test_the_pose_does_not_matter(pair, morphed, seed):
    turn = Rotation.random(random_state=seed).as_matrix()
    away = pair.source.vertices @ turn + np.random.default_rng(seed).normal(size=3) * 2000
    result = morph(pair.source.moved(away), pair.target)
    assert np.linalg.norm(result.vertices - morphed.vertices, axis=1).max() < 1e-4 * pair.target.diagonal


def test_a_mirrored_source_is_morphed_where_it_may_be_mirrored(pair):
    other = Surface(pair.source.vertices * (-1, 1, 1), pair.source.faces[:, ::-1])
    result = morph(other, pair.target, MorphSettings(fix_mirror=True))
    assert np.linalg.det(result.transform[:3, :3]) < 0
    assert any("mirrored" in warning for warning in result.warnings)
    assert np.linalg.norm(result.vertices - pair.truth, axis=1).mean() < 0.012 * pair.target.diagonal
    assert result.after.flipped == result.after.self_intersecting == 0


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
def test_partial_overlap_does_not_squeeze(pair, partial):
    """Where one shows a part only, the rest follows by the field and keeps its size."""
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


# --- weights --------------------------------------------------------------------------------------
@pytest.mark.parametrize("nodes", [900, 2500])
def test_weights_hold_what_must_stay(nodes):
    """Exactly, whatever levels and mending come between; what is free still reaches the target."""
    source, target, _ = shapes.pair(nodes, nodes, seed=1)
    free = source.vertices[:, 2] < 200
    result = morph(source, target, STAY, weights=free.astype(float))
    assert np.array_equal(result.vertices[~free], source.vertices[~free])
    distance = result.surface_distance[source.vertices[:, 2] < 150]
    assert np.percentile(distance, 99) < 0.01 * target.diagonal
    assert result.after.flipped == 0


def test_a_share_is_a_share(pair):
    full = morph(pair.source, pair.target, STAY)
    for share in (0.0, 0.25, 1.0):
        part = morph(pair.source, pair.target, STAY, weights=np.full(len(pair.source.vertices), share))
        wanted = pair.source.vertices + share * (full.vertices - pair.source.vertices)
        assert part.vertices == pytest.approx(wanted, abs=1e-9)


def test_weights_of_a_soup(pair):
    """A merged vertex takes the largest of its copies' weights, so that none tears off."""
    loose = soup(SMALL)
    weights = np.zeros(len(loose.vertices))
    weights[::2] = 1.0
    result = morph(loose, GOAL, STAY, weights=weights)
    _, group = np.unique(loose.vertices, axis=0, return_inverse=True)
    for one in range(0, 162, 20):
        assert len(np.unique(result.vertices[group.ravel() == one], axis=0)) == 1


def test_weights_are_told_not_to_hold_the_alignment():
    result = morph(SMALL, GOAL, weights=np.zeros(len(SMALL.vertices)))
    assert any("not the alignment" in warning for warning in result.warnings)


@pytest.mark.parametrize(
    "weights", [np.ones(3), np.full(162, np.nan), np.full(162, -0.1), np.full(162, 1.1), []]
)
def test_bad_weights_are_told(weights):
    with pytest.raises(FemorsError, match="162 numbers from 0 to 1"):
        morph(SMALL, GOAL, weights=weights)


# --- landmarks ------------------------------------------------------------------------------------
def test_landmarks_start_the_morph(pair, morphed):
    at = [10, 200, 400, 600, 800]
    away = pair.source.moved(pair.source.vertices @ Rotation.random(random_state=9).as_matrix() + 1e3)
    result = morph(away, pair.target, source_landmarks=away.vertices[at], target_landmarks=pair.truth[at])
    assert np.linalg.norm(result.vertices - morphed.vertices, axis=1).mean() < 2e-3 * pair.target.diagonal


@pytest.mark.parametrize(
    ("ours", "theirs", "words"),
    [
        (np.eye(3), None, "both meshes"),
        (None, np.eye(3), "both meshes"),
        (np.eye(3), np.ones((2, 3)), "paired"),
        (np.eye(3)[:2], np.eye(3)[:2], "at least 3"),
        (np.full((3, 3), np.nan), np.eye(3), "not finite"),
        (np.ones((4, 3)), np.eye(4)[:, :3], "one line"),
    ],
)
def test_bad_landmarks_are_told(ours, theirs, words):
    with pytest.raises(FemorsError, match=words) as error:
        morph(SMALL, GOAL, source_landmarks=ours, target_landmarks=theirs)
    assert "\n" not in str(error.value)


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


# --- settings at their extremes -------------------------------------------------------------------
def extremes() -> list[tuple[str, object]]:
    """Every setting at its least, its most, and for lengths at what is far too small and too large."""
    out: list[tuple[str, object]] = []
    for name, (field, spec) in declared.specs(MorphSettings).items():
        if spec.choices:
            values: list[object] = [choice[0] for choice in spec.choices]
        elif isinstance(field.default, bool):
            values = [False, True]
        else:
            values = [spec.minimum, 1e9 if spec.maximum is None else spec.maximum]
            values += [1e-9] if spec.unit == "length" else []
        out += [(name, type(field.default)(value)) for value in values]
    return out


@pytest.mark.parametrize(("name", "value"), extremes())
@pytest.mark.parametrize(
    "base", [STAY, dataclasses.replace(PRESETS["published"], alignment="none")], ids=["own", "paper"]
)
def test_no_setting_breaks_the_morph(base, name, value):
    result = morph(SMALL, GOAL, dataclasses.replace(base, **{name: value}))
    assert finite(result, SMALL)
    assert result.stop_reason


def test_nothing_to_do_is_no_failure():
    """No iterations, no projection, no relaxation: the aligned source."""
    idle = MorphSettings(
        alignment="none", iterations=0, fine_iterations=0, dense_iterations=0, projection=0.0, relaxation=0
    )
    result = morph(SMALL, GOAL, idle)
    assert np.array_equal(result.vertices, SMALL.vertices)
    assert result.history == ()


def test_the_length_of_a_border_is_that_of_edges_with_one_face():
    """Not of every edge between two of its nodes: the square's diagonal."""
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert morph_fit._border_length(Surface(corners, [[0, 1, 2], [0, 2, 3]])) == 4.0
    assert morph_fit._border_length(SMALL) == 0.0


# --- the field ------------------------------------------------------------------------------------
def test_the_field_carries_other_points_as_the_vertices_go(pair, morphed):
    """On the surface: 2 % of the mean edge measured, 12 % at most."""
    apart = np.linalg.norm(morphed.apply(pair.source.vertices) - morphed.vertices, axis=1)
    assert apart.mean() < 0.05 * pair.source.mean_edge
    assert apart.max() < 0.3 * pair.source.mean_edge
    middle = pair.source.corners.mean(axis=1)
    faces = morphed.vertices[pair.source.faces].mean(axis=1)
    assert np.linalg.norm(morphed.apply(middle) - faces, axis=1).mean() < 0.1 * pair.source.mean_edge
    assert morphed.apply(np.empty((0, 3))).shape == (0, 3)
    # far away: with what is nearest, never NaN
    assert np.isfinite(morphed.apply([[1e6, 0, 0]])).all()
