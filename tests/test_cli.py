# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: what it writes, what it says where, and how it ends."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from clicases import SOURCE, TARGET, ball
from commands import Terminal, refused, run

from femors_addon import cli, cli_morph, commandline, limits, meshfiles
from femors_addon.intersect import self_intersections
from femors_addon.meshfiles import MeshFile
from femors_addon.morph import MorphResult
from femors_addon.morph_settings import PRESETS
from femors_addon.progress import FemorsError

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture()
def pair(tmp_path):
    """A source of quads as OBJ and a target as STL."""
    meshfiles.write(tmp_path / "source.obj", SOURCE)
    meshfiles.write(tmp_path / "target.stl", TARGET)
    return tmp_path / "source.obj", tmp_path / "target.stl"


@pytest.fixture(scope="module")
def morphed() -> MorphResult:
    """What the morph of the pair gives, for tests of what is done with it."""
    return cli_morph.morph(SOURCE.surface(), TARGET.surface())


@pytest.fixture()
def no_morph(monkeypatch):
    """Make the computation a failure: what is refused must be refused before it."""

    def never(*args, **kwargs):
        raise AssertionError("the morph was started")

    monkeypatch.setattr(cli_morph, "morph", never)


# --- the whole way --------------------------------------------------------------------------------
def test_morph_from_files_to_files(pair, tmp_path, capsys):
    source, target = pair
    out, report, field = tmp_path / "out.obj", tmp_path / "r.json", tmp_path / "f.npz"
    code, said, err = run(
        capsys, "morph", source, target, "-o", out, "--report", report, "--field", field, "--align", "rigid"
    )
    assert code == 0, err
    before, after = meshfiles.read(source), meshfiles.read(out)
    assert len(after.vertices) == len(before.vertices)
    assert np.array_equal(after.corners, before.corners)
    radius = np.linalg.norm(after.vertices / [35, 26, 64], axis=1)
    assert np.median(np.abs(radius - 1)) < 0.02  # on the target, up to its facets
    written = json.loads(report.read_text())
    assert written["faults"] == []
    assert written["settings"]["alignment"] == "rigid"
    assert written["files"]["source"] == str(source)
    assert written["femors"] == cli.version()
    assert said.count("\n") >= 2
    with np.load(field) as arrays:
        assert {"transform", "centres", "displacements", "spread"} <= set(arrays)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        *("f.npz", "out.obj", "r.json", "source.obj", "target.stl"),
    ]


def test_quiet_says_nothing(pair, tmp_path, capsys, monkeypatch, morphed):
    noted = dataclasses.replace(morphed, warnings=("a remark",))

    def remark(source, target, settings, progress, **landmarks):
        progress(0.5, "working")
        return noted

    monkeypatch.setattr(cli_morph, "morph", remark)
    monkeypatch.setattr(commandline.sys, "stderr", terminal := Terminal())
    code, out, _ = run(capsys, "morph", *pair, "-o", tmp_path / "out.ply")
    assert (code, terminal.getvalue().split("\r")[-1]) == (0, "femors: note: a remark\n")
    assert "50 %  working" in terminal.getvalue()
    assert out == morphed.summary() + "\n"
    monkeypatch.undo()
    monkeypatch.setattr(cli_morph, "morph", remark)
    code, out, err = run(capsys, "morph", *pair, "-o", tmp_path / "out.ply", "--quiet")
    assert (code, out, err) == (0, "", "")


def test_limits_of_threads_and_memory(pair, tmp_path, capsys):
    before = limits.Limits.threads, limits.Limits.memory
    outs = [tmp_path / f"{threads}.ply" for threads in (1, 2)]
    for threads, out in enumerate(outs, 1):
        code, _, _ = run(capsys, "morph", *pair, "-o", out, "--threads", str(threads), "--quiet")
        assert code in (0, 1)
        assert (limits.Limits.threads, limits.Limits.memory) == before
    assert outs[0].read_bytes() == outs[1].read_bytes()
    said = refused(capsys, "morph", *pair, "-o", tmp_path / "no.ply", "--memory", "1")
    assert "needs about" in said and "the limit of --memory is 1 MB" in said
    assert not (tmp_path / "no.ply").exists()
    for option in ("--threads", "--memory"):
        assert "0 or more" in refused(capsys, "morph", *pair, "-o", tmp_path / "no.ply", f"{option}=-1")
    assert (limits.Limits.threads, limits.Limits.memory) == before


def test_stl_in_and_out_keeps_every_triangle(tmp_path, capsys):
    meshfiles.write(tmp_path / "a.stl", SOURCE)
    meshfiles.write(tmp_path / "b.ply", TARGET)
    code, _, err = run(capsys, "morph", tmp_path / "a.stl", tmp_path / "b.ply", "-o", tmp_path / "o.stl")
    assert code == 0, err
    before, after = meshfiles.read(tmp_path / "a.stl"), meshfiles.read(tmp_path / "o.stl")
    _, one = np.unique(before.vertices, axis=0, return_inverse=True)
    _, two = np.unique(after.vertices, axis=0, return_inverse=True)
    assert len(after.vertices) == len(before.vertices)
    # corners that were one vertex still are one, and no others have become so
    assert (
        len(np.unique(np.column_stack((one.ravel(), two.ravel())), axis=0)) == one.max() + 1 == two.max() + 1
    )


# --- exit code 1 ----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"converged": False, "stop_reason": "not converged: too far"}, "not converged: too far"),
        ({"flipped": 3}, "3 faces of the result are flipped"),
        ({"self_intersecting": 2}, "2 faces of the result cross"),
        ({"faults": ("2 faces fold over",)}, "2 faces fold over"),
        ({"faults": ("2 faces fold over",), "flipped": 1, "self_intersecting": 2}, "2 faces fold over"),
    ],
)
def test_an_imperfect_result_is_written_and_said(pair, tmp_path, capsys, monkeypatch, morphed, change, words):
    whole = {key: change[key] for key in change if key in ("converged", "stop_reason", "faults")}
    counted = {key: change[key] for key in change if key not in whole}
    imperfect = dataclasses.replace(morphed, **whole, after=dataclasses.replace(morphed.after, **counted))
    monkeypatch.setattr(cli_morph, "morph", lambda *args, **kwargs: imperfect)
    report = tmp_path / "r.json"
    code, out, err = run(capsys, "morph", *pair, "-o", tmp_path / "o.stl", "--report", report, "--quiet")
    assert (code, out) == (1, "")
    assert words in err
    assert "the result is written" in err
    assert (tmp_path / "o.stl").exists()
    (fault,) = json.loads(report.read_text())["faults"]  # no face is told of twice
    assert words in fault


# --- exit code 2 ----------------------------------------------------------------------------------
def test_bad_files_are_one_line_and_nothing_is_written(pair, tmp_path, capsys, no_morph):
    source, target = pair
    (tmp_path / "folder.stl").mkdir()
    text = tmp_path / "text.stl"
    text.write_text("not a mesh\n")
    before = sorted(tmp_path.iterdir())
    cases = [
        (tmp_path / "none.stl", target, "o.stl", "no such file"),
        (source, tmp_path / "none.stl", "o.stl", "no such file"),
        (text, target, "o.stl", "text"),
        (source, target, "o.step", "'.step'"),
        (source, target, "nowhere/o.stl", "no folder"),
        (source, target, "folder.stl", "folder"),
        (source, target, "source.obj", "also an input"),
        (source, target, "./target.stl", "also an input"),
    ]
    for one, two, out, words in cases:
        assert words in refused(capsys, "morph", one, two, "-o", tmp_path / out)
    report = ("-o", tmp_path / "o.stl", "--report")
    assert "two outputs" in refused(capsys, "morph", source, target, *report, tmp_path / "o.stl")
    assert "no folder" in refused(capsys, "morph", source, target, *report, tmp_path / "nowhere" / "r.json")
    said = refused(capsys, "morph", source, target, "-o", tmp_path / "o.stl", "--field", tmp_path / "F.txt")
    assert said == f"femors: {tmp_path / 'F.txt'}: a field's file ends in .npz\n"
    os.link(source, tmp_path / "hard.obj")
    assert "also an input" in refused(capsys, "morph", source, target, "-o", tmp_path / "hard.obj")
    (tmp_path / "hard.obj").unlink()
    assert sorted(tmp_path.iterdir()) == before


def test_a_folder_is_called_one(pair, tmp_path, capsys, no_morph):
    source, target = pair
    (tmp_path / "folder.stl").mkdir()
    out = tmp_path / "o.stl"
    said = f"femors: {tmp_path}: is a folder; name a file\n"
    for words in (
        ("morph", tmp_path, target, "-o", out),
        ("morph", source, tmp_path, "-o", out),
        ("morph", source, target, "-o", tmp_path),
        ("morph", source, target, "-o", out, "--report", tmp_path),
        ("morph", source, target, "-o", out, "--field", tmp_path),
        ("overclosure", tmp_path, "-o", tmp_path / "out"),
        ("transfer", tmp_path, source, "-o", tmp_path / "out"),
    ):
        assert refused(capsys, *words) == said
    assert "is a folder; name a file" in refused(capsys, "morph", tmp_path / "folder.stl", target, "-o", out)


def test_messages_of_the_core_name_the_file(pair, tmp_path, capsys, monkeypatch, morphed):
    source, target = pair
    texts = ["source: is odd", "target: is odd", "the source is odd"]
    expected = [f"{source}: is odd", f"{target}: is odd", "the source is odd"]
    noted = dataclasses.replace(morphed, warnings=tuple(texts))
    monkeypatch.setattr(cli_morph, "morph", lambda *args, **kwargs: noted)
    report = tmp_path / "r.json"
    _, _, err = run(capsys, "morph", *pair, "-o", tmp_path / "o.stl", "--report", report)
    assert err.splitlines() == [f"femors: note: {text}" for text in expected]
    assert json.loads(report.read_text())["warnings"] == expected
    for text, said in zip(texts, expected, strict=True):

        def refuse(*args, text=text, **kwargs):
            raise FemorsError(text)

        monkeypatch.setattr(cli_morph, "morph", refuse)
        assert refused(capsys, "morph", *pair, "-o", tmp_path / "o.stl") == f"femors: {said}\n"


def test_a_mesh_that_cannot_be_morphed_is_one_line(tmp_path, capsys):
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    meshfiles.write(tmp_path / "ball.stl", ball(8, 8, (1, 1, 1)))
    err = refused(capsys, "morph", tmp_path / "flat.obj", tmp_path / "ball.stl", "-o", tmp_path / "o.stl")
    assert err.startswith(f"femors: {tmp_path / 'flat.obj'}: ")
    assert not (tmp_path / "o.stl").exists()


def test_another_unit_is_told_with_the_option_once(tmp_path, capsys):
    meshfiles.write(tmp_path / "metres.obj", ball(10, 12, (0.03, 0.024, 0.06)))
    meshfiles.write(tmp_path / "mm.stl", TARGET)
    err = refused(capsys, "morph", tmp_path / "metres.obj", tmp_path / "mm.stl", "-o", tmp_path / "o.stl")
    assert "1000 times" in err and err.count("--fix-units") == 1 and "--partial source (or target)" in err


def test_a_defect_is_not_a_result(pair, tmp_path, capsys, no_morph):
    code, out, err = run(capsys, "morph", *pair, "-o", tmp_path / "o.stl")
    assert (code, out) == (3, "")
    assert "Traceback" in err
    assert "please report" in err
    assert not (tmp_path / "o.stl").exists()


@pytest.mark.parametrize(("error", "code"), [(KeyError, 3), (KeyboardInterrupt, 130)])
def test_what_goes_wrong_after_the_writing_says_so(pair, tmp_path, capsys, monkeypatch, morphed, error, code):
    def fails(self):
        raise error("summary")

    monkeypatch.setattr(cli_morph, "morph", lambda *args, **kwargs: morphed)
    monkeypatch.setattr(MorphResult, "summary", fails)
    seen, _, err = run(capsys, "morph", *pair, "-o", tmp_path / "o.stl")
    assert seen == code
    assert "the result is written" in err.splitlines()[-1]
    assert "nothing is written" not in err
    assert (tmp_path / "o.stl").exists()


@pytest.mark.parametrize("argv", [["morph", "a.obj", "b.stl", "-o", "o.stl"], ["--help"]])
@pytest.mark.parametrize("both", [False, True])
def test_a_reader_that_goes_away_does_not_change_the_end(pair, tmp_path, argv, both):
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "femors_addon", *argv]
    for path, name in zip(pair, ("a.obj", "b.stl"), strict=True):
        path.rename(tmp_path / name)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env=environment,
        stdout=write,
        stderr=write if both else subprocess.PIPE,
        text=True,
        timeout=60,
        check=False,
    )
    os.close(write)
    assert done.returncode == 0, done.stderr
    assert "Error" not in (done.stderr or "")
    assert (tmp_path / "o.stl").exists() == ("morph" in argv)


def test_self_intersections_are_counted_on_the_source_itself(tmp_path, capsys, monkeypatch, morphed):
    crossing = MeshFile(
        np.concatenate((SOURCE.vertices, SOURCE.vertices + (10.0, 3.0, 1.0))),
        np.concatenate((SOURCE.sizes, SOURCE.sizes)),
        np.concatenate((SOURCE.corners, SOURCE.corners + len(SOURCE.vertices))),
    )
    own = len(np.unique(self_intersections(crossing.surface())))
    assert own > 10
    meshfiles.write(tmp_path / "a.obj", crossing)
    meshfiles.write(tmp_path / "b.stl", TARGET)
    vertices = crossing.vertices
    for count, expected in ((own, 0), (own + 1, 1)):
        after = dataclasses.replace(morphed.after, self_intersecting=count)
        before = dataclasses.replace(morphed.before, self_intersecting=0)  # of other positions: no matter
        changed = dataclasses.replace(morphed, vertices=vertices, before=before, after=after)
        monkeypatch.setattr(cli_morph, "morph", lambda *args, changed=changed, **kwargs: changed)
        code, _, err = run(capsys, "morph", tmp_path / "a.obj", tmp_path / "b.stl", "-o", tmp_path / "o.stl")
        assert code == expected
        assert not expected or f"and {own} did in the source" in err


def test_out_of_memory_is_one_line(pair, tmp_path, capsys, monkeypatch):
    def greedy(*args, **kwargs):
        raise MemoryError

    monkeypatch.setattr(cli_morph, "morph", greedy)
    assert "memory" in refused(capsys, "morph", *pair, "-o", tmp_path / "o.stl")


# --- help, options --------------------------------------------------------------------------------
@pytest.mark.parametrize("preset", PRESETS)
def test_options_stand_over_the_preset(pair, tmp_path, capsys, monkeypatch, preset):
    seen = []

    def look(source, target, settings, progress, **landmarks):
        seen.append(settings)
        raise FemorsError("seen")

    monkeypatch.setattr(cli_morph, "morph", look)
    refused(capsys, "morph", *pair, "-o", tmp_path / "o.stl", "--preset", preset)
    options = [
        "--align",
        "none",
        "--partial",
        "target",
        "--levels",
        "1",
        "--fix-units",
        "--spread-end",
        "2.5",
    ]
    refused(capsys, "morph", *pair, "-o", tmp_path / "o.stl", "--preset", preset, *options)
    changed = {"alignment": "none", "partial": "target", "levels": 1, "fix_units": True, "spread_end": 2.5}
    assert seen == [PRESETS[preset], dataclasses.replace(PRESETS[preset], **changed)]


POINTS = np.array([[1, 2, 3.5], [-4, 5, 6], [7, 8, -9e1], [0, 1, 0]])


def test_landmarks_reach_the_morph(pair, tmp_path, capsys, monkeypatch):
    def look(source, target, settings, progress, *, source_landmarks, target_landmarks, landmark_names):
        assert landmark_names is None
        assert np.array_equal(source_landmarks, POINTS)
        assert np.array_equal(target_landmarks, POINTS + 1)
        raise FemorsError("seen")

    monkeypatch.setattr(cli_morph, "morph", look)
    np.savetxt(tmp_path / "a.csv", POINTS, delimiter=",")
    np.savetxt(tmp_path / "b.csv", POINTS + 1, delimiter=",")
    start = ["morph", *pair, "-o", tmp_path / "o.stl", "--source-landmarks", tmp_path / "a.csv"]
    assert "seen" in refused(capsys, *start, "--target-landmarks", tmp_path / "b.csv")
    assert "go together" in refused(capsys, *start)
    same = ["--target-landmarks", tmp_path / "b.csv", "--field", tmp_path / "b.csv"]
    assert "also an input" in refused(capsys, *start, *same)


def test_a_report_has_the_landmarks_that_led_the_morph(pair, tmp_path, capsys):
    """One row for each, as a page and as JSON."""
    points = SOURCE.surface().vertices
    points = points[np.linspace(0, len(points) - 1, 5).astype(int)]
    for name in ("a.csv", "b.csv"):
        rows = [f"P{number},{','.join(map(repr, place))}" for number, place in enumerate(points.tolist())]
        rows += ["alone,1,2,3"] if name == "b.csv" else []
        (tmp_path / name).write_text("\n".join(rows) + "\n")
    options = ["--source-landmarks", tmp_path / "a.csv", "--target-landmarks", tmp_path / "b.csv", "--steer"]
    page = tmp_path / "r.html"
    code, _, said = run(capsys, "morph", *pair, "-o", tmp_path / "o.stl", *options, "--report", page)
    assert code in (0, 1) and "Traceback" not in said
    text = page.read_text(encoding="utf-8")
    assert "pulled" in text and "not pulled" not in text
    left = "landmarks without a partner of the same name: alone; left out"
    assert f"note: {left}" in said and left in text
    for number in range(5):
        assert f"<td>P{number}</td>" in text or f"<th>P{number}</th>" in text
