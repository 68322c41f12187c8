# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole geometries by a field, and the command line that carries files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from femors_addon import cli, deckfiles, keptfield, landmarkfiles, meshfiles, shapes
from femors_addon.carry import Carrier
from femors_addon.keptfield import KeptField
from femors_addon.mesh import Surface
from femors_addon.meshfiles import MeshFile
from femors_addon.nearest import SurfaceIndex
from femors_addon.progress import FemorsError
from femors_addon.transfer import Transfer
from femors_addon.transfer_settings import TransferSettings
from femors_addon.transforms import homogeneous, transformed
from femors_addon.volume import Block, VolumeMesh
from femors_addon.volume_quality import scaled_jacobians

BONE = shapes.bone(1500)
STEPS = shapes.differences(2)
SHIFT = homogeneous(np.eye(3), np.array([300.0, 0.0, 0.0]))


def field() -> KeptField:
    """From the bone to its warped self, far enough away that the two cannot be mixed up."""
    centres = transformed(SHIFT, BONE.vertices)
    goal = transformed(SHIFT, shapes.warp(BONE.vertices, *STEPS))
    residual = np.full(len(centres), 0.25)
    return KeptField(
        SHIFT, centres, goal - centres, BONE.faces, residual, 0.75 * BONE.mean_edge, "bone", "other"
    )


CARRIER = Carrier(field())
TARGET = field().morphed


def site(distance: float = 0.0, count: int = 60) -> Surface:
    """A patch of the bone, at some distance from it."""
    near = np.argsort(np.linalg.norm(BONE.vertices - BONE.vertices[200], axis=1), kind="stable")[:count]
    inside = np.isin(BONE.faces, near).all(axis=1)
    used, faces = np.unique(BONE.faces[inside], return_inverse=True)
    return Surface((BONE.vertices + distance * BONE.vertex_normals)[used], faces.reshape(-1, 3))


def slab() -> VolumeMesh:
    """Wedges between two offsets of a patch: cartilage of 3 mm."""
    inner, outer = site(0.0), site(3.0)
    count = len(inner.vertices)
    nodes = np.concatenate((inner.vertices, outer.vertices))
    wedges = np.column_stack((inner.faces, inner.faces + count))
    block = Block("penta6", wedges, np.arange(len(wedges)) + 1)
    return VolumeMesh(nodes, (block,), np.arange(len(nodes)) + 1)


# --- surfaces -------------------------------------------------------------------------------------
def test_a_patch_lands_on_the_target_and_projected_exactly():
    patch = site(0.5)
    plain = Transfer(CARRIER, TransferSettings()).points(patch.vertices)
    assert plain.notes == plain.faults == ()
    assert SurfaceIndex(TARGET).signed(plain.points) == pytest.approx(0.5, abs=0.02)
    laid = Transfer(CARRIER, TransferSettings(), TARGET).points(patch.vertices)
    assert np.abs(SurfaceIndex(TARGET).closest(laid.points).distance).max() < 1e-9
    assert laid.projected == pytest.approx(np.linalg.norm(laid.points - plain.points, axis=1))
    assert "projected by 0.49" in laid.summary()


def test_inside_stays_inside_and_outside_out():
    """Random points near a bone that is bent: none changes its side."""
    rng = np.random.default_rng(0)
    points = BONE.vertices[rng.integers(0, len(BONE.vertices), 2000)] + rng.normal(size=(2000, 3)) * 4.0
    before = SurfaceIndex(BONE).signed(points)
    got = Transfer(CARRIER, TransferSettings()).points(points)
    after = SurfaceIndex(TARGET).signed(got.points)
    clear = np.abs(before) > 1e-3
    assert (np.sign(after[clear]) == np.sign(before[clear])).all()


def test_inverse_and_strength_of_things():
    patch = site(2.0).vertices
    there = Transfer(CARRIER, TransferSettings()).points(patch).points
    back = Transfer(CARRIER, TransferSettings(inverse=True)).points(there)
    assert np.abs(back.points - patch).max() < 1e-3
    assert "error of the inverse" in back.summary()
    half = Transfer(CARRIER, TransferSettings(strength=0.5)).points(patch)
    assert half.points == pytest.approx((patch + there) / 2)


# --- solids ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("project", [False, True])
def test_cartilage_keeps_its_thickness_and_its_elements(project):
    mesh = slab()
    assert (scaled_jacobians(mesh) > 0).all()
    transfer = Transfer(CARRIER, TransferSettings(), TARGET if project else None)
    got = transfer.mesh(mesh)
    assert (scaled_jacobians(mesh.moved(got.points)) > 0).all()
    off = SurfaceIndex(TARGET).signed(got.points)
    half = len(off) // 2
    assert np.abs(off[:half]).max() < (1e-6 if project else 0.01)
    assert off[half:].min() > 2.5 and off[half:].max() < 3.5


def test_nodes_outside_are_put_back_outside_a_target_that_is_farther_out():
    """Without that, the nodes 3 mm off the bone would end 2 mm inside a target that is 5 mm larger."""
    mesh = slab()
    larger = TARGET.moved(TARGET.vertices + 5.0 * TARGET.vertex_normals)
    got = Transfer(CARRIER, TransferSettings(), larger).mesh(mesh)
    half = len(mesh.nodes) // 2
    assert got.kept > 0.9 * half and "put back" in got.summary()
    off = SurfaceIndex(larger).signed(got.points)[half:]
    assert np.percentile(off, 5) > 1.0 and np.median(off) == pytest.approx(3.0, abs=0.3)


def test_a_field_that_mirrors_refuses_solids():
    mirror = np.diag([-1.0, 1, 1, 1])
    centres = transformed(mirror, BONE.vertices)
    flipped = KeptField(
        mirror, centres, np.zeros_like(centres), BONE.faces[:, ::-1], np.zeros(len(centres)), 3.0
    )
    with pytest.raises(FemorsError, match="inside out"):
        Transfer(Carrier(flipped), TransferSettings()).mesh(slab())
    points = site(2.0).vertices
    got = Transfer(Carrier(flipped), TransferSettings()).points(points)
    assert got.points == pytest.approx(points * [-1, 1, 1], abs=1e-6)


# --- words ----------------------------------------------------------------------------------------
def test_what_is_on_the_target_already_is_told():
    there = Transfer(CARRIER, TransferSettings()).points(site().vertices).points
    again = Transfer(CARRIER, TransferSettings()).points(there)
    assert any("already" in fault for fault in again.faults)
    assert Transfer(CARRIER, TransferSettings(inverse=True)).points(there).faults == ()
    back = Transfer(CARRIER, TransferSettings(inverse=True)).points(site().vertices)
    assert any("lies on the source already" in fault for fault in back.faults)


def test_what_is_far_is_told_with_its_distance():
    far = site().vertices - [0.0, 80.0, 0.0]
    got = Transfer(CARRIER, TransferSettings()).points(far)
    assert any("from the source's surface" in note for note in got.notes) and not got.faults
    away = Transfer(CARRIER, TransferSettings()).points(far - [0.0, 5e3, 0.0])
    assert any("another object" in fault for fault in away.faults)
    assert away.points == pytest.approx(transformed(SHIFT, far - [0.0, 5e3, 0.0]))


def test_points_in_metres_and_a_foreign_surface_are_remarked():
    rows = BONE.vertices[[10, 400, 900, 1200]]
    transfer = Transfer(CARRIER, TransferSettings())
    assert transfer.points(rows).notes == ()
    small = transfer.points(rows / 1000.0 + [0.0, 3.0, 200.0])
    assert any("metres" in note for note in small.notes)
    assert transfer.points(BONE.corners[5]).notes == ()  # a small site on the bone
    other = TARGET.moved(TARGET.vertices + [0.0, 40.0, 0.0])
    laid = Transfer(CARRIER, TransferSettings(), other).points(rows)
    assert any("is it the right one" in note for note in laid.notes)
    assert Transfer(CARRIER, TransferSettings(), TARGET).points(rows).notes == ()


def test_what_cannot_be_is_refused():
    with pytest.raises(FemorsError, match="strength 1"):
        Transfer(CARRIER, TransferSettings(strength=0.5), TARGET)
    with pytest.raises(FemorsError, match="Strength"):
        Transfer(CARRIER, TransferSettings(strength=2.0))
    with pytest.raises(FemorsError, match="no points"):
        Transfer(CARRIER, TransferSettings()).points(np.empty((0, 3)))


# --- the command line -----------------------------------------------------------------------------
MARKS = BONE.vertices[[10, 400, 900]]


@pytest.fixture()
def files(tmp_path: Path) -> Path:
    """A field, a site, a deck and landmarks, in a folder."""
    field().save(tmp_path / "f.npz")
    meshfiles.write(tmp_path / "site.stl", MeshFile.of(site()))
    meshfiles.write(tmp_path / "target.ply", MeshFile.of(TARGET))
    meshfiles.write(tmp_path / "bone.ply", MeshFile.of(BONE))
    deck = ["*NODE"]
    deck += [f"{n}, {x:.12g}, {y:.12g}, {z:.12g}" for n, (x, y, z) in enumerate(slab().nodes, 1)]
    deck += ["*ELEMENT, TYPE=C3D6, ELSET=CART"]
    deck += [", ".join(map(str, [n, *(row + 1)])) for n, row in enumerate(slab().blocks[0].nodes, 1)]
    (tmp_path / "cart.inp").write_text("\n".join([*deck, "*END STEP", ""]))
    lines = [f"{name},{x!r},{y!r},{z!r}" for name, (x, y, z) in zip("abc", MARKS.tolist(), strict=True)]
    (tmp_path / "marks.csv").write_text("\n".join(["name,x,y,z", *lines, ""]))
    return tmp_path


def run(capsys, *args) -> tuple[int, str, str]:
    code = cli.main([str(arg) for arg in args])
    said = capsys.readouterr()
    return code, said.out, said.err


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
    page = reports[1].read_text()
    assert page.count("data:image/png") == 4 and "<svg" in page and "from &#x27;target.ply&#x27;" in page
    assert all(f"<th>{mark}</th>" in page for mark in "abc") and "In range" in page
    assert "landmarks.2.distance_after" in reports[2].read_text()


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
        (["f.npz", "site.stl", "-o", "marks.csv"], "is a file; a folder is needed"),
        (["f.npz", "site.stl", "-o", "."], "also an input"),
        (["f.npz", "site.stl", "site.stl", "-o", "out"], "two outputs"),
        (["f.npz", "notes.txt", "-o", "out"], "not a known kind"),
        (["f.npz", "twice.csv", "-o", "out"], "'a' stands twice"),
        (["f.npz", "site.stl", "-o", "out", "--strength", "2"], "Strength"),
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
