# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line that carries files: femors transfer, femors landmarks."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from commands import run
from fieldcases import BONE, CARRIER, MARKS, TARGET, site, slab, write_files

from femors_addon import cli_landmarks, deckfiles, keptfield, landmarkfiles, meshfiles, shapes
from femors_addon.mesh import Surface
from femors_addon.meshfiles import MeshFile
from femors_addon.nearest import SurfaceIndex
from femors_addon.transfer import Transfer
from femors_addon.transfer_settings import TransferSettings

# --- the command line -----------------------------------------------------------------------------


@pytest.fixture()
def files(tmp_path: Path) -> Path:
    """A field, a site, a deck and landmarks, in a folder."""
    return write_files(tmp_path)


def test_every_input_comes_out_under_its_name_and_in_its_format(files, capsys):
    inputs = [files / name for name in ("site.stl", "cart.inp", "marks.csv")]
    code, said, err = run(capsys, "transfer", files / "f.npz", *inputs, "-o", files / "out", "--quiet")
    assert (code, said, err) == (0, "", "")
    assert sorted(p.name for p in (files / "out").iterdir()) == ["cart.inp", "marks.csv", "site.stl"]
    truth = Transfer(CARRIER, TransferSettings())
    soup = meshfiles.read(files / "site.stl")
    got = meshfiles.read(files / "out" / "site.stl")
    assert np.array_equal(got.corners, soup.corners)
    assert got.vertices == pytest.approx(CARRIER.carry(soup.vertices).points, abs=1e-4)  # single precision
    deck = deckfiles.read_deck(files / "out" / "cart.inp")
    assert deck.coordinates == pytest.approx(truth.mesh(slab()).points, abs=1e-6)
    old, new = ((files / place).read_text().splitlines() for place in ("cart.inp", "out/cart.inp"))
    assert len(old) == len(new) and old[-2:] == new[-2:]
    marks = landmarkfiles.read(files / "out" / "marks.csv")
    assert marks.names == ("a", "b", "c")
    assert marks.points == pytest.approx(CARRIER.carry(MARKS).points, rel=1e-9)


def test_the_table_has_what_each_landmark_is_worth(files, capsys):
    table = files / "table.csv"
    args = ["transfer", files / "f.npz", files / "marks.csv", "-o", files / "out", "--table", table]
    code, said, _ = run(capsys, *args)
    assert code == 0
    assert table.read_text().splitlines()[0].startswith("name,x,y,z,distance,residual,stretch")
    assert "0.250" in said  # the residual
    code, said, _ = run(capsys, "transfer", files / "f.npz", files / "site.stl", "-o", files / "out2")
    assert f": {len(site().vertices)} points" in said  # not three for each triangle of the STL file
    assert landmarkfiles.read(table).names == ("a", "b", "c")


def test_a_report_has_every_landmark_and_file_before_and_after(files, capsys):
    inputs = [files / name for name in ("site.stl", "cart.inp", "marks.csv")]
    args = ["transfer", files / "f.npz", *inputs, "--project", files / "target.ply", "--quiet"]
    reports = [files / name for name in ("r.json", "r.html", "r.csv")]
    for report in reports:
        assert run(capsys, *args, "-o", files / "out", "--report", report)[0] == 0
    got = json.loads(reports[0].read_text())
    truth = CARRIER.carry(MARKS)
    for row, (mark, before, distance) in enumerate(zip("abc", MARKS, truth.distance, strict=True)):
        record = got["landmarks"][row]
        assert record["landmark"] == mark and record["before"] == pytest.approx(before)
        assert record["after"] == pytest.approx(
            SurfaceIndex(TARGET).closest(truth.points[row]).point[0], abs=1e-4
        )
        assert record["distance_before"] == pytest.approx(distance, abs=1e-9)
        assert record["distance_after"] == pytest.approx(0.0, abs=1e-4), "projected"
        assert record["in_range"] == "yes" and record["residual"] == pytest.approx(0.25)
    things = {thing["name"]: thing for thing in got["carried"]}
    assert things["site.stl"]["distance_after"]["maximum"] < 1e-4
    assert things["cart.inp"]["distance_before"]["maximum"] > 0.5
    assert things["cart.inp"]["points"] == len(slab().nodes)
    assert things["site.stl"]["points"] == len(site().vertices)  # not three for each triangle
    page = reports[1].read_text()
    assert page.count("data:image/png") == 4 and "<svg" in page and "from &#x27;target.ply&#x27;" in page
    assert all(f"<th>{mark}</th>" in page for mark in "abc") and "In range" in page
    assert "landmarks.2.distance_after" in reports[2].read_text()


def test_a_report_says_of_which_file_a_landmark_is(files, capsys):
    (files / "more.csv").write_text((files / "marks.csv").read_text().replace("a,", "z,"))
    reports = [files / name for name in ("r.json", "r.html")]
    for inputs, expected in (
        (["marks.csv"], [("a", None), ("b", None), ("c", None)]),  # one file needs no column
        (["marks.csv", "more.csv"], [*((n, "marks.csv") for n in "abc"), *((n, "more.csv") for n in "zbc")]),
    ):
        args = ["transfer", files / "f.npz", *(files / name for name in inputs), "--quiet"]
        for report in reports:
            assert run(capsys, *args, "-o", files / "out", "--report", report)[0] == 0
        rows = json.loads(reports[0].read_text())["landmarks"]
        assert [(row["landmark"], row.get("file")) for row in rows] == expected
        page = reports[1].read_text()
        assert ("<th>Landmark</th><th>File</th><th>Before</th>" in page) == (len(inputs) > 1)
        assert ("<tr><th>z</th><td>more.csv</td>" in page) == (len(inputs) > 1)


def test_a_report_says_what_the_field_does_not_reach(files, capsys):
    far = np.vstack([MARKS[:1], MARKS[1:2] + 0.3 * CARRIER.size, MARKS[2:] + 9 * CARRIER.size])
    landmarkfiles_lines = [f"{x!r},{y!r},{z!r}" for x, y, z in far.tolist()]
    (files / "far.csv").write_text("\n".join(["x,y,z", *landmarkfiles_lines, ""]))
    report = files / "r.json"
    args = ["transfer", files / "f.npz", files / "far.csv", "-o", files / "out", "--report", report]
    assert run(capsys, *args, "--quiet")[0] == 0
    rows = json.loads(report.read_text())["landmarks"]
    assert [row["in_range"] for row in rows] == ["yes", "partly", "no, alignment only"]
    args[-1] = files / "half.json"
    assert run(capsys, *args, "--quiet", "--strength", "0.5")[0] == 0
    got = json.loads((files / "half.json").read_text())
    assert all(row["distance_after"] is None for row in got["landmarks"]), "on no surface"
    args[-1] = files / "back.html"
    assert run(capsys, *args, "--quiet", "--inverse")[0] in (0, 1)
    assert "from the source, where the field has it" in args[-1].read_text()


def test_strength_project_and_inverse(files, capsys):
    start = ["transfer", files / "f.npz", files / "marks.csv", "--quiet", "-o"]
    assert run(capsys, *start, files / "half", "--strength", "0.5")[0] == 0
    assert run(capsys, *start, files / "laid", "--project", files / "target.ply")[0] == 0
    whole = CARRIER.carry(MARKS).points
    half, laid = (landmarkfiles.read(files / place / "marks.csv").points for place in ("half", "laid"))
    assert half == pytest.approx((MARKS + whole) / 2)
    assert SurfaceIndex(TARGET).closest(laid).distance.max() < 1e-4  # single precision in the file
    again = ["transfer", files / "f.npz", files / "laid" / "marks.csv", "--inverse", "-o", files / "back"]
    assert run(capsys, *again)[0] == 0
    assert landmarkfiles.read(files / "back" / "marks.csv").points == pytest.approx(MARKS, abs=1e-4)


def test_slicers_files_in_the_other_axes(files, capsys):
    """The same points, once in LPS and once in RAS, arrive at the same place."""
    for space, signs in (("LPS", [1, 1, 1]), ("RAS", [-1, -1, 1])):
        controls = [{"label": n, "position": (p * signs).tolist()} for n, p in zip("abc", MARKS, strict=True)]
        document = {"markups": [{"coordinateSystem": space, "controlPoints": controls}]}
        (files / f"{space}.mrk.json").write_text(json.dumps(document))
    both = [files / "LPS.mrk.json", files / "RAS.mrk.json"]
    assert run(capsys, "transfer", files / "f.npz", *both, "-o", files / "out")[0] == 0
    one, two = (landmarkfiles.read(files / "out" / path.name).points for path in both)
    assert one == pytest.approx(CARRIER.carry(MARKS).points, rel=1e-9)
    assert two == pytest.approx(one, rel=1e-9)
    raw = json.loads((files / "out" / "RAS.mrk.json").read_text())["markups"][0]
    assert raw["coordinateSystem"] == "RAS"
    assert raw["controlPoints"][0]["position"][0] == pytest.approx(-one[0, 0], rel=1e-9)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["f.npz", "gone.csv", "-o", "out"], "gone.csv"),
        (["marks.csv", "site.stl", "-o", "out"], "not a field file"),
        (["cut.npz", "site.stl", "-o", "out"], "cut short"),
        (["newer.npz", "site.stl", "-o", "out"], "newer FEMORS"),
        (["f.npz", "site.stl", "-o", "marks.csv"], "marks.csv: is a file; name a folder"),
        (["f.npz", "site.stl", "-o", "."], "also an input"),
        (["f.npz", "site.stl", "site.stl", "-o", "out"], "two outputs"),
        (["f.npz", "notes.txt", "-o", "out"], "not a known kind"),
        (["f.npz", "notes.txt", "-o", "out"], ".vtk, .vtu, .msh, .mesh, .mrk.json, .json, .fcsv, .csv"),
        (["f.npz", "twice.csv", "-o", "out"], "'a' stands twice"),
        (["f.npz", "site.stl", "-o", "out", "--strength", "2"], "--strength: "),
        (["f.npz", "site.stl", "-o", "out", "--strength", "0.5", "--project", "target.ply"], "strength 1"),
        (["f.npz", "site.stl", "-o", "out", "--table", "t.csv"], "no input is a landmark file"),
        (["f.npz", "-o", "out"], "required"),
    ],
)
def test_bad_input_is_refused_and_nothing_is_written(files, capsys, monkeypatch, args, words):
    monkeypatch.chdir(files)
    whole = (files / "f.npz").read_bytes()
    (files / "cut.npz").write_bytes(whole[: len(whole) // 2])
    with np.load(files / "f.npz") as arrays:
        np.savez(files / "newer.npz", **(dict(arrays) | {"layout": keptfield.LAYOUT + 1}))
    (files / "twice.csv").write_text("a,1,2,3\na,4,5,6\n")
    (files / "notes.txt").write_text("hello")
    before = {path: path.read_bytes() for path in files.iterdir()}
    code, said, err = run(capsys, "transfer", *args)
    assert code == 2 and said == ""
    assert words in err and err.count("\n") == 1, err
    assert {path: path.read_bytes() for path in files.iterdir()} == before


def test_what_was_carried_already_is_written_and_told(files, capsys):
    code, _, err = run(capsys, "transfer", files / "f.npz", files / "target.ply", "-o", files / "out")
    assert code == 1 and "already" in err and "(pass --inverse)" in err
    assert (files / "out" / "target.ply").exists()


def test_a_mesh_in_another_unit_is_written_and_told(files, capsys):
    for factor, words, units in (
        (0.001, "1000 times smaller than the source", "millimetres and metres differ by 1000"),
        (1000.0, "1000 times larger than the source", "millimetres and metres differ by 1000"),
        (1 / 25.4, "25.4 times smaller than the source", "millimetres and inches differ by 25.4"),
    ):
        meshfiles.write(files / "odd.ply", MeshFile.of(BONE.moved(factor * BONE.vertices)))
        code, _, err = run(capsys, "transfer", files / "f.npz", files / "odd.ply", "-o", files / "out")
        assert code == 1 and words in err and units in err and err.count("\n") == 1, err
        assert (files / "out" / "odd.ply").exists()


@pytest.mark.parametrize("factor", [1e-1, 1e-2, 1e-3, 1e-6])
def test_a_part_in_another_unit_is_told_whatever_its_size(files, capsys, factor):
    """Such as the site of a ligament in metres beside a bone in millimetres, even with the origin on it."""
    for radius in (0.004, 0.01, 0.02):
        site = shapes.sphere(2, radius=radius * BONE.diagonal)
        site = factor * (site.vertices + BONE.vertices[10]), site.faces
        meshfiles.write(files / "site.ply", MeshFile.of(Surface(*site)))
        code, _, err = run(capsys, "transfer", files / "f.npz", files / "site.ply", "-o", files / "out")
        assert code == 1 and "smaller than the source" in err, err
        assert f"differ by {1 / factor:g})" in err and err.count("\n") == 1, err


def test_a_mesh_that_is_far_too_large_is_in_another_unit(files, capsys):
    meshfiles.write(files / "odd.ply", MeshFile.of(BONE.moved(50.0 * BONE.vertices)))
    code, _, err = run(capsys, "transfer", files / "f.npz", files / "odd.ply", "-o", files / "out")
    assert code == 1 and "is 50 times larger than the source of the field" in err and "unit" in err, err


def test_a_small_mesh_apart_from_the_bone_in_any_unit_is_told_with_its_size(files, capsys):
    small = shapes.sphere(1, radius=BONE.diagonal / 160.0)
    meshfiles.write(files / "odd.ply", MeshFile.of(small.moved(small.vertices + BONE.bounds[1])))
    err = run(capsys, "transfer", files / "f.npz", files / "odd.ply", "-o", files / "out")[2]
    assert "times smaller than the source" in err and "unit" not in err, err


def test_a_small_thing_on_the_bone_is_in_its_unit(files, capsys):
    small = shapes.sphere(1, radius=0.005 * BONE.diagonal)
    meshfiles.write(files / "screw.ply", MeshFile.of(small.moved(small.vertices + BONE.vertices[10])))
    assert run(capsys, "transfer", files / "f.npz", files / "screw.ply", "-o", files / "out")[0] == 0


def test_a_landmark_far_from_the_bone_is_told_with_its_distance(files, capsys):
    (files / "far.csv").write_text("near,{},{},{}\nfar,0,-90,200\n".format(*MARKS[0]))
    code, _, err = run(capsys, "transfer", files / "f.npz", files / "far.csv", "-o", files / "out")
    assert code == 0
    assert "'far' (" in err and "'near'" not in err


def test_notes_of_the_command_line_name_its_options(subjects, tmp_path, capsys):
    folder, _ = subjects
    bone = meshfiles.read(folder / "one.ply").surface()
    meshfiles.write(tmp_path / "small.ply", MeshFile.of(bone.moved(bone.vertices / 1000.0)))
    args = [tmp_path / "small.ply", folder / "target.ply", "-o", tmp_path / "o.ply"]
    err = run(capsys, "morph", *args)[2]
    assert "--fix-units" in err and "tick" not in err


# --- femors landmarks -----------------------------------------------------------------------------
@pytest.fixture(scope="module")
def subjects(tmp_path_factory) -> tuple[Path, np.ndarray]:
    """Two templates and a target that is known to the vertex; landmarks of each, in other orders."""
    folder = tmp_path_factory.mktemp("subjects")
    source, target, truth = shapes.pair(1500, 1400, seed=5, strength=0.5)
    meshfiles.write(folder / "one.ply", MeshFile.of(source))
    meshfiles.write(folder / "target.ply", MeshFile.of(target))
    other = shapes.warp(source.vertices, ("grow", 0.04), ("bend", -0.05))
    meshfiles.write(folder / "two.ply", MeshFile.of(source.moved(other)))
    rows = [3, 500, 1000, 1400]
    for name, points, order in (("one", source.vertices, [0, 1, 2, 3]), ("two", other, [2, 0, 3, 1])):
        lines = ["m{},{},{},{}".format(k, *map(repr, points[rows[k]].tolist())) for k in order]
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    return folder, truth[rows]


def test_landmarks_of_one_template(subjects, tmp_path, capsys):
    folder, truth = subjects
    args = [folder / "one.ply", folder / "target.ply", folder / "one.csv", "-o", tmp_path / "out.csv"]
    args += ["--report", tmp_path / "r.html"]
    code, said, err = run(capsys, "landmarks", *args, "--project")
    assert code == 0, err
    got = landmarkfiles.read(tmp_path / "out.csv")
    assert got.names == ("m0", "m1", "m2", "m3")
    assert np.linalg.norm(got.points - truth, axis=1).mean() < 0.01 * 450
    surface = meshfiles.read(folder / "target.ply").surface()
    assert SurfaceIndex(surface).closest(got.points).distance.max() < 1e-6
    assert said.startswith("landmark")
    page = (tmp_path / "r.html").read_text()
    assert "<th>m3</th>" in page and page.count("data:image/png") == 4 and "Verdict" in page


def test_landmarks_of_several_templates(subjects, tmp_path, capsys):
    folder, truth = subjects
    more = ["--template", folder / "two.ply", folder / "two.csv", "--table", tmp_path / "t.csv"]
    more += ["--report", tmp_path / "r.json"]
    args = [folder / "one.ply", folder / "target.ply", folder / "one.csv", "-o", tmp_path / "out.csv"]
    assert run(capsys, "landmarks", *args, *more)[0] == 0
    got = landmarkfiles.read(tmp_path / "out.csv")
    assert got.names == ("m0", "m1", "m2", "m3")
    assert np.linalg.norm(got.points - truth, axis=1).mean() < 0.01 * 450
    table = (tmp_path / "t.csv").read_text().splitlines()
    spread = [float(line.split(",")[8]) for line in table[1:]]
    assert all(0 < value < 10 for value in spread)
    report = json.loads((tmp_path / "r.json").read_text())
    assert [row["spread"] for row in report["landmarks"]] == pytest.approx(spread)
    first = dict(zip(("m0", "m1", "m2", "m3"), landmarkfiles.read(folder / "one.csv").points, strict=True))
    target = SurfaceIndex(meshfiles.read(folder / "target.ply").surface())
    for row, place in zip(report["landmarks"], got.points, strict=True):
        assert row["before"] == pytest.approx(first[row["landmark"]]) and row["templates"] == 2
        assert row["after"] == pytest.approx(place)
        assert row["distance_after"] == pytest.approx(target.signed(place)[0], abs=1e-4)
    assert len(report["templates"]) == 2 and report["settings"]["alignment"] == "affine"
    alone = ["--template", folder / "one.ply", folder / "one.csv", *more[:3]]
    assert run(capsys, "landmarks", folder / "target.ply", *alone, "-o", tmp_path / "o2.csv")[0] == 0
    assert (tmp_path / "o2.csv").read_text() == (tmp_path / "out.csv").read_text()


def test_known_landmarks_steer(subjects, tmp_path, capsys):
    folder, truth = subjects
    lines = ["m{},{},{},{}".format(k, *truth[k].tolist()) for k in range(4)]
    (tmp_path / "known.csv").write_text("\n".join(lines))
    args = [folder / "one.ply", folder / "target.ply", folder / "one.csv", "-o", tmp_path / "out.csv"]
    assert run(capsys, "landmarks", *args, "--known", tmp_path / "known.csv", "--steer", "--quiet")[0] == 0
    got = landmarkfiles.read(tmp_path / "out.csv").points
    assert np.linalg.norm(got - truth, axis=1).max() < 1.5


def test_landmarks_of_a_morph_that_folds_are_written_and_said(subjects, tmp_path, capsys, monkeypatch):
    folder, _ = subjects
    plain, fault = cli_landmarks.morph, "2 faces fold over, though they did not in the source"

    def folding(*args, **kwargs):
        return dataclasses.replace(plain(*args, **kwargs), faults=(fault,), warnings=(fault,))

    monkeypatch.setattr(cli_landmarks, "morph", folding)
    args = [folder / "one.ply", folder / "target.ply", folder / "one.csv", "-o", tmp_path / "out.csv"]
    code, _, err = run(capsys, "landmarks", *args)
    assert code == 1 and err.count(fault) == 1 and (tmp_path / "out.csv").exists()


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["one.ply", "target.ply", "-o", "o.csv"], "2 files are given"),
        (["target.ply", "-o", "o.csv"], "1 file is given"),
        (["one.ply", "target.ply", "one.csv", "-o", "o.stl"], "no kind of landmark file"),
        (["one.ply", "target.ply", "one.csv", "-o", "one.csv"], "also an input"),
        (
            ["one.ply", "target.ply", "one.csv", "-o", "o.csv", "-t", "one.ply", "one.csv"],
            "the same template",
        ),
        (["one.ply", "target.ply", "gone.csv", "-o", "o.csv"], "gone.csv"),
        (["one.ply", "target.ply", "one.csv", "-o", "o.csv", "-t", "two.ply", "plain.csv"], "some have none"),
        (["one.ply", "target.ply", "one.csv", "-o", "o.csv", "--known", "plain.csv"], "shares 0 name"),
    ],
)
def test_bad_input_to_landmarks_is_refused(subjects, capsys, monkeypatch, args, words):
    folder, _ = subjects
    monkeypatch.chdir(folder)
    (folder / "plain.csv").write_text("1,2,3\n4,5,6\n7,8,9\n")
    code, _, err = run(capsys, "landmarks", *args)
    assert code == 2 and words in err and err.count("\n") == 1, err
    assert not (folder / "o.csv").exists() and not (folder / "o.stl").exists()
