# SPDX-License-Identifier: GPL-3.0-or-later
"""The morph as a whole: known maps recovered, the same every time, and what a result says."""

from __future__ import annotations

import dataclasses
import itertools
import json

import numpy as np
import pytest
from morphs import GOAL, LAYERED, SMALL, STAY, finite, subjects, subjects_morphed
from scipy.spatial.transform import Rotation
from surfaces import cut

from femors_addon import morph_outcome, shapes
from femors_addon.commandline import for_command
from femors_addon.mesh import Surface
from femors_addon.morph import PRESETS, MorphResult, MorphSettings, morph
from femors_addon.morph_fit import verdict
from femors_addon.nearest import SurfaceIndex
from femors_addon.progress import FemorsError
from femors_addon.quality import flipped_faces
from femors_addon.report_files import report_bytes
from femors_addon.transforms import transformed


@pytest.fixture(scope="module")
def pair() -> shapes.Pair:
    return subjects()


@pytest.fixture(scope="module")
def morphed() -> MorphResult:
    return subjects_morphed()


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
            "not converged: half of the result's nodes are within 7 of the target's nodes around them; "
            "1.2 is asked for, and 40.0 % are within that",
        ),
        (
            "source",
            40,
            "converged over the shared part: half of the result's nodes are within 0.5 of the target's nodes "
            "around them; 1.2 is asked for, and 60.0 % are within that",
        ),
        (
            "target",
            60,
            "converged over the shared part: half of the target's nodes are within 0.25 of the result's "
            "surface; 1.2 is asked for, and 100.0 % are within that",
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
    assert converged or "within 7" in reason


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
    said = float(result.stop_reason.split("nodes are within ")[1].split()[0])
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
