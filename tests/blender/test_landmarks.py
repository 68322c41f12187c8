# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks in and out, the table, and what undo, FE parts and point clouds do with a field."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Euler

MARKS = np.array([[1.0, 2.0, 3.0], [-4.5, 5.25, 6.0], [7.0, -8.0, 9.5]])
NAMES = ("head", "lat dist", "Ä")


@pytest.fixture()
def core(part):
    """A function that imports a module of the core."""
    return lambda name: part(f"femors_addon.{name}")


def written(core, path: Path, points=MARKS, names=NAMES, space="LPS") -> str:
    files = core("landmarkfiles")
    path.write_bytes(files.encoded(path, files.Landmarks(points, names, space=space)))
    return str(path)


def places(collection: str) -> dict[str, np.ndarray]:
    return {
        item["femors_landmark"]: np.array(item.matrix_world.translation)
        for item in bpy.data.collections[collection].objects
    }


# --- in and out -----------------------------------------------------------------------------------
@pytest.mark.parametrize("ending", [".csv", ".fcsv", ".mrk.json"])
def test_landmarks_come_in_as_empties_and_go_out_again(empty, core, tmp_path, ending):
    path = written(core, tmp_path / f"marks{ending}")
    assert bpy.ops.femors.import_landmarks(filepath=path) == {"FINISHED"}
    got = places("marks")
    assert tuple(got) == NAMES
    np.testing.assert_allclose(list(got.values()), MARKS, atol=1e-6)
    out = tmp_path / f"out{ending}"
    assert bpy.ops.femors.export_landmarks(filepath=str(out), collection="marks") == {"FINISHED"}
    back = core("landmarkfiles").read(out)
    assert back.names == NAMES
    np.testing.assert_allclose(back.points, MARKS, atol=1e-6)


def test_axes_are_turned_where_the_file_has_others(empty, core, tmp_path):
    path = written(core, tmp_path / "ras.fcsv", space="RAS")
    bpy.ops.femors.import_landmarks(filepath=path)
    np.testing.assert_allclose(list(places("ras").values()), MARKS * [-1, -1, 1], atol=1e-6)
    bpy.ops.femors.import_landmarks(filepath=path, space="RAS", collection="meshes in RAS")
    np.testing.assert_allclose(list(places("meshes in RAS").values()), MARKS, atol=1e-6)


def test_nothing_comes_in_while_a_mesh_is_edited(pair, core, tmp_path):
    path = written(core, tmp_path / "marks.csv")
    bpy.context.view_layer.objects.active = pair[0]
    for operator in (bpy.ops.femors.import_landmarks, bpy.ops.femors.import_deck):
        assert operator.poll()
        bpy.ops.object.mode_set(mode="EDIT")
        try:
            assert not operator.poll()
            with pytest.raises(RuntimeError, match="Leave Edit Mode or painting first"):
                operator(filepath=path)
        finally:
            bpy.ops.object.mode_set(mode="OBJECT")


def test_landmarks_of_a_mesh_stay_where_they_are_however_it_stands(pair, core, tmp_path):
    source, _ = pair
    source.location, source.rotation_euler, source.scale = (5, 6, 7), Euler((0.3, 0.2, 1.0)), (2, 1, 0.5)
    bpy.context.view_layer.update()
    path = written(core, tmp_path / "marks.csv")
    bpy.ops.femors.import_landmarks(filepath=path, object="Femur")
    np.testing.assert_allclose(list(places("marks").values()), MARKS, atol=1e-5)
    assert {item.parent for item in bpy.data.collections["marks"].objects} == {source}


def test_two_files_of_equal_names_pair_by_their_meshes(pair, tools, core, tmp_path):
    """Blender numbers the second "head"; the landmark's name stays."""
    source = pair[0]
    rows = [0, 60, 130, 200]
    ours = tools.world(source)[rows]
    theirs = ours * [1.2, 0.9 / 0.8, 1.1]
    for name, points in (("Femur", ours), ("Scan", theirs)):
        path = written(core, tmp_path / f"{name}.csv", points, ("a", "b", "c", "d"))
        bpy.ops.femors.import_landmarks(filepath=path, object=name)
    assert bpy.ops.femors.morph(source="Femur", target="Scan", steer=True) == {"FINISHED"}
    report = json.loads(bpy.context.view_layer.objects.active.femors.report)
    assert report["landmarks"]["names"] == ["a", "b", "c", "d"]
    assert report["landmarks"]["pulled"] is True
    page = tmp_path / "report.html"
    assert bpy.ops.femors.report(filepath=str(page)) == {"FINISHED"}
    text = page.read_text(encoding="utf-8")
    assert all(f">{name}<" in text for name in "abcd")


def test_the_table_goes_out_with_its_figures(pair, tmp_path):
    source, _ = pair
    for name, row in (("tip", 100), ("side", 30)):
        source.vertex_groups.new(name=name).add([row], 1.0, "REPLACE")
    bpy.ops.femors.morph(source="Femur", target="Scan")
    bpy.ops.femors.transfer(use_empties=True)
    out = tmp_path / "table.csv"
    assert bpy.ops.femors.export_landmarks(filepath=str(out), use_table=True, use_figures=True) == {
        "FINISHED"
    }
    lines = out.read_text().splitlines()
    assert lines[0] == "name,x,y,z,distance,residual,stretch,projected,spread,templates"
    assert [line.split(",")[0] for line in lines[1:]] == ["tip", "side"]
    assert lines[1].endswith(",1") and ",," in lines[1]  # one template has no spread
    again = tmp_path / "empties.csv"
    bpy.ops.femors.export_landmarks(
        filepath=str(again), collection="Femur to Scan landmarks", use_figures=True
    )
    table, empties = (np.genfromtxt(path, delimiter=",", skip_header=1)[:, 1:7] for path in (out, again))
    np.testing.assert_allclose(empties, table, atol=1e-6)


def test_the_table_is_sorted_by_what_is_worst(empty, part):
    form = bpy.context.scene.femors_transfer
    for name, distance, stretch in (("b", -3.0, 0.5), ("a", 1.0, 1.2), ("c", 2.0, 1.0)):
        mark = form.marks.add()
        mark.name, mark.distance, mark.stretch = name, distance, stretch
    rows = part("ui.transfer").sorted_rows
    marks = list(form.marks)
    assert [marks[row].name for row in rows(marks, "ORDER")] == ["b", "a", "c"]
    assert [marks[row].name for row in rows(marks, "NAME")] == ["a", "b", "c"]
    assert [marks[row].name for row in rows(marks, "distance")] == ["b", "c", "a"]
    assert [marks[row].name for row in rows(marks, "stretch")] == ["b", "a", "c"]


def test_endings_are_those_of_the_core(part, core):
    assert set(part("operators.landmarks").ENDINGS) == set(core("landmarkfiles").FORMATS)


# --- refused --------------------------------------------------------------------------------------
def test_what_cannot_be_read_is_told_and_nothing_is_made(empty, tools, tmp_path):
    (tmp_path / "twice.csv").write_text("a,1,2,3\na,4,5,6\n")
    (tmp_path / "marks.csv").write_text("a,1,2,3\n")
    before = tools.census()
    for options, words in (
        ({"filepath": str(tmp_path / "gone.csv")}, "gone.csv"),
        ({"filepath": str(tmp_path / "twice.csv")}, "'a' stands twice"),
        ({"filepath": str(tmp_path / "x.stl")}, "no kind of landmark file"),
        ({"filepath": str(tmp_path / "marks.csv"), "object": "gone"}, "no object named 'gone'"),
        ({}, "No file named"),
    ):
        with pytest.raises(RuntimeError, match=words):
            bpy.ops.femors.import_landmarks(**options)
    assert tools.census() == before


def test_what_cannot_be_written_is_told(empty, core, tmp_path):
    out = str(tmp_path / "out.csv")
    with pytest.raises(RuntimeError, match="no empties in the selection"):
        bpy.ops.femors.export_landmarks(filepath=out)
    with pytest.raises(RuntimeError, match="no collection named 'gone'"):
        bpy.ops.femors.export_landmarks(filepath=out, collection="gone")
    with pytest.raises(RuntimeError, match="table has no landmarks"):
        bpy.ops.femors.export_landmarks(filepath=out, use_table=True)
    bpy.ops.femors.import_landmarks(filepath=written(core, tmp_path / "marks.csv"))
    with pytest.raises(RuntimeError, match="no room for figures"):
        bpy.ops.femors.export_landmarks(
            filepath=str(tmp_path / "o.fcsv"), collection="marks", use_figures=True
        )
    bpy.data.collections["marks"].objects[1]["femors_landmark"] = "head"
    with pytest.raises(RuntimeError, match="'head' stands twice"):
        bpy.ops.femors.export_landmarks(filepath=out, collection="marks")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["marks.csv"]


# --- undo -----------------------------------------------------------------------------------------
def test_a_transfer_is_one_undo_step_and_the_field_outlives_it(pair):
    source, _ = pair
    source.vertex_groups.new(name="tip").add([100], 1.0, "REPLACE")
    bpy.ops.ed.undo_push(message="start")
    bpy.ops.femors.morph(source="Femur", target="Scan")
    data = bytes(bpy.data.texts["Femur to Scan"]["femors_field"])
    bpy.ops.ed.undo_push(message="morphed")
    bpy.ops.femors.transfer(use_empties=True)
    bpy.ops.ed.undo_push(message="transferred")
    bpy.ops.ed.undo()
    assert "tip" not in bpy.data.objects["Scan"].vertex_groups
    assert "Femur to Scan landmarks" not in bpy.data.collections
    assert bytes(bpy.data.texts["Femur to Scan"]["femors_field"]) == data
    bpy.ops.femors.transfer()
    assert "tip" in bpy.data.objects["Scan"].vertex_groups
    bpy.ops.ed.undo()
    assert "Femur to Scan" not in bpy.data.texts


def test_a_field_is_chosen_and_deleted_in_the_panel(pair):
    bpy.ops.femors.morph(source="Femur", target="Scan")
    bpy.ops.femors.choose_field(name="Femur to Scan")
    assert bpy.context.scene.femors_transfer.field == bpy.data.texts["Femur to Scan"]
    bpy.ops.femors.remove_field(name="Femur to Scan")
    assert not bpy.data.texts and bpy.context.scene.femors_transfer.field is None


# --- other kinds of objects -----------------------------------------------------------------------
def test_a_part_of_a_deck_goes_as_the_command_line_has_it(pair, core, tmp_path):
    """In double precision, with the nodes inside, and out again as a deck."""
    bpy.ops.femors.morph(source="Femur", target="Scan")
    nodes = np.stack(np.meshgrid([0.9, 1.0, 1.1], [-0.1, 0.0, 0.1], [-0.2, 0.0, 0.2], indexing="ij"), -1)
    nodes = nodes.reshape(-1, 3)
    lines = ["*NODE", *(f"{n}, {x!r}, {y!r}, {z!r}" for n, (x, y, z) in enumerate(nodes.tolist(), 1))]
    lines.append("*ELEMENT, TYPE=C3D8, ELSET=PAD")
    for count, (i, j, k) in enumerate(np.ndindex(2, 2, 2), 1):
        at = lambda a, b, c: 1 + 9 * (i + a) + 3 * (j + b) + (k + c)  # noqa: B023, E731
        ring = [at(0, 0, 0), at(1, 0, 0), at(1, 1, 0), at(0, 1, 0)]
        lines.append(", ".join(map(str, [count, *ring, *(n + 1 for n in ring)])))
    deck = tmp_path / "pad.inp"
    deck.write_text("\n".join([*lines, ""]))
    (tmp_path / "f.npz").write_bytes(bytes(bpy.data.texts["Femur to Scan"]["femors_field"]))
    bpy.ops.femors.import_deck(filepath=str(deck))
    assert bpy.ops.femors.transfer(what="OBJECTS", objects="PAD") == {"FINISHED"}
    out = tmp_path / "blender.inp"
    bpy.ops.femors.export_deck(filepath=str(out), object="PAD carried")
    args = ["transfer", str(tmp_path / "f.npz"), str(deck), "-o", str(tmp_path / "line"), "--quiet"]
    assert core("cli").main(args) == 0
    assert out.read_bytes() == (tmp_path / "line" / "pad.inp").read_bytes()


def test_point_clouds_are_carried(pair, tools, core):
    kinds = bpy.ops.object.convert.get_rna_type().properties["target"].enum_items
    if "POINTCLOUD" not in kinds:
        pytest.skip("this Blender makes no point cloud of a mesh")
    bpy.ops.femors.morph(source="Femur", target="Scan")
    item = tools.add_object("Cloud", *tools.sphere(6, 8))
    points = tools.world(item)
    for other in bpy.context.selected_objects:
        other.select_set(False)
    item.select_set(True)
    bpy.context.view_layer.objects.active = item
    bpy.ops.object.convert(target="POINTCLOUD")
    name = bpy.context.object.name
    assert bpy.ops.femors.transfer(what="OBJECTS", objects=name) == {"FINISHED"}
    carrier = core("carry").Carrier(
        core("keptfield").decoded(bpy.data.texts["Femur to Scan"]["femors_field"], "x")
    )
    out = np.empty(3 * len(points), dtype=np.float32)
    bpy.data.objects[f"{name} carried"].data.attributes["position"].data.foreach_get("vector", out)
    np.testing.assert_allclose(out.reshape(-1, 3), carrier.carry(points).points, atol=1e-5)


def test_a_flat_parent_is_told_and_nothing_is_left(pair, tmp_path, tools):
    pair[0].scale.z = 0.0
    bpy.context.view_layer.update()
    (tmp_path / "m.csv").write_text("a,1,2,3\n")
    before = tools.census()
    with pytest.raises(RuntimeError, match="'Femur' is scaled to zero"):
        bpy.ops.femors.import_landmarks(filepath=str(tmp_path / "m.csv"), object="Femur")
    assert tools.census() == before
