# SPDX-License-Identifier: GPL-3.0-or-later
"""`bpy.ops.femors.transfer`: what is carried, where it arrives, what is kept, and what is refused."""

from __future__ import annotations

import json
import re

import bpy
import numpy as np
import pytest
from field_cases import FIELD, area, put_group, weights_of


# --- the field ------------------------------------------------------------------------------------
def test_a_morph_keeps_its_field(morphed, part):
    text = bpy.data.texts[FIELD]
    assert morphed[2].femors.field == text
    assert text.use_fake_user
    head = part("operators.fields").head_of(text)
    assert (head["source"], head["target"]) == ("Femur", "Scan")
    assert head["date"][:2] == "20"
    assert head["figures"]["target_to_surface"]["median"] >= 0
    field = part("femors_addon.keptfield").decoded(text["femors_field"], "x")
    assert field.centres.dtype == np.float64
    assert part("operators.fields").all_fields() == [text]


def test_the_field_survives_saving_and_appending(morphed, tmp_path, part, extension):
    data = bytes(bpy.data.texts[FIELD]["femors_field"])
    path = str(tmp_path / "kept.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    assert bytes(bpy.data.texts[FIELD]["femors_field"]) == data
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
    with bpy.data.libraries.load(path) as (_, here):
        here.objects = ["Femur morphed to Scan"]
    text = here.objects[0].femors.field
    assert text is not None and bytes(text["femors_field"]) == data
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
    with bpy.data.libraries.load(path) as (_, here):
        here.texts = [FIELD]
    assert bytes(here.texts[0]["femors_field"]) == data
    assert part("operators.fields").all_fields() == here.texts


# --- groups ---------------------------------------------------------------------------------------
def test_groups_arrive_on_the_targets_own_mesh(morphed, tools):
    source, target, result = morphed
    before = tools.world(target).copy()
    assert bpy.ops.femors.transfer(field=FIELD, use_empties=True) == {"FINISHED"}
    np.testing.assert_array_equal(tools.world(target), before)
    assert {group.name for group in target.vertex_groups} == {"site", "tip", "pole"}
    truth = tools.world(result)
    tip = weights_of(target, "tip")
    assert (tip > 0).sum() == 1 and tip.max() == 1.0
    nearest = np.argmin(np.linalg.norm(before - truth[100], axis=1))
    assert tip[nearest] == 1.0
    empties = {item["femors_landmark"]: item for item in bpy.data.objects if item.type == "EMPTY"}
    assert set(empties) == {"tip", "pole"}
    np.testing.assert_allclose(empties["tip"].matrix_world.translation, truth[100], atol=1e-5)
    assert [c.name for c in empties["tip"].users_collection] == [f"{FIELD} landmarks"]
    assert 0 <= empties["tip"]["femors_residual"] < 0.05
    site = weights_of(target, "site")
    assert 0.0 < np.unique(site)[1] < 0.9  # partial weights
    carried = area(source, truth, weights_of(source, "site"))
    assert area(target, before, site) == pytest.approx(carried, rel=0.05)


def test_the_table_lists_the_landmarks(morphed):
    bpy.ops.femors.transfer(field=FIELD)
    marks = bpy.context.scene.femors_transfer.marks
    assert [mark.name for mark in marks] == ["tip", "pole"]
    assert all(abs(mark.distance) < 1e-5 and mark.residual < 0.05 and mark.stretch > 0 for mark in marks)
    assert all(mark.spread == -1.0 for mark in marks)


def test_groups_have_a_report(morphed, tools, tmp_path):
    with pytest.raises(RuntimeError, match="Nothing was transferred in this scene"):
        bpy.ops.femors.report(filepath=str(tmp_path / "r.html"), transfer=True)
    assert list(tmp_path.iterdir()) == []
    bpy.ops.femors.transfer(field=FIELD, project=True)
    for name in ("r.json", "r.csv", "r.html"):
        assert bpy.ops.femors.report(filepath=str(tmp_path / name), transfer=True) == {"FINISHED"}
    got = json.loads((tmp_path / "r.json").read_text())
    rows = {row["landmark"]: row for row in got["landmarks"]}
    np.testing.assert_allclose(rows["tip"]["before"], tools.world(morphed[0])[100], atol=1e-6)
    marks = {mark.name: mark for mark in bpy.context.scene.femors_transfer.marks}
    for name, row in rows.items():
        np.testing.assert_allclose(row["after"], marks[name].point, atol=1e-6)
        assert row["distance_after"] == 0.0 and row["in_range"] == "yes"  # it was projected
        assert row["residual"] == pytest.approx(marks[name].residual, abs=1e-6)
    (site,) = got["regions"]
    assert site["region"] == "site" and site["area"] > 0
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 4 and "<th>tip</th>" in page and bpy.app.version_string in page
    painted = re.findall(r"data:image/png;base64,([^\"]+)", page)
    for item in morphed[:2]:
        for group in item.vertex_groups:  # no vertex is in a group any more
            group.remove(list(range(len(item.data.vertices))))
    assert bpy.ops.femors.report(filepath=str(tmp_path / "r.html"), transfer=True) == {"FINISHED"}
    plain = re.findall(r"data:image/png;base64,([^\"]+)", (tmp_path / "r.html").read_text(encoding="utf-8"))
    assert len(plain) == 4 and any(one != two for one, two in zip(painted, plain, strict=True))
    assert "landmarks.0.before.0" in (tmp_path / "r.csv").read_text()


@pytest.mark.parametrize("result", ["COPY", "SHAPE_KEY"])
@pytest.mark.parametrize("gone", [False, True])
def test_objects_have_a_report(morphed, tools, tmp_path, result, gone):
    thing = morphed[0].copy()
    thing.name = "Thing"
    thing.data = thing.data.copy()
    bpy.context.scene.collection.objects.link(thing)
    bpy.context.view_layer.update()
    bpy.ops.femors.transfer(what="OBJECTS", objects="Thing", result=result)
    if gone:
        bpy.data.objects.remove(thing)
        bpy.data.texts.remove(bpy.data.texts[FIELD])
    path = tmp_path / "r.html"
    assert bpy.ops.femors.report(filepath=str(path), transfer=True) == {"FINISHED"}
    page = path.read_text(encoding="utf-8")
    assert "<th>Thing</th>" in page and page.count("data:image/png") == (0 if gone else 4)
    bpy.ops.femors.report(filepath=str(tmp_path / "r.json"), transfer=True)
    (row,) = json.loads((tmp_path / "r.json").read_text())["carried"]
    assert row["points"] == len(morphed[2].data.vertices)
    assert row["distance_before"]["maximum"] < 1e-5 and row["in_range"] == "100 %"


def test_empties_have_a_report(morphed, tmp_path):
    item = bpy.data.objects.new("tip", None)
    item.location = (0.1, 0.2, 0.3)
    bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.update()
    bpy.ops.femors.transfer(what="OBJECTS", objects="tip", strength=0.5)
    bpy.ops.femors.report(filepath=str(tmp_path / "r.json"), transfer=True)
    (row,) = json.loads((tmp_path / "r.json").read_text())["landmarks"]
    assert row["before"] == pytest.approx([0.1, 0.2, 0.3]) and row["distance_before"] < 0
    assert row["distance_after"] is None, "half way it is on no surface"
    after = bpy.data.objects["tip carried"].matrix_world.translation
    assert row["after"] == pytest.approx(list(after), abs=1e-6)


def test_a_second_transfer_moves_the_empties_of_the_first(morphed):
    title = f"{FIELD} landmarks"
    bpy.ops.femors.transfer(field=FIELD, use_empties=True)
    collection = bpy.data.collections[title]
    where = {item.name: tuple(item.matrix_world.translation) for item in collection.objects}
    collection.objects[0].location = (9.0, 9.0, 9.0)
    bpy.ops.femors.transfer(field=FIELD, use_empties=True)
    assert [c.name for c in bpy.data.collections if c.name.startswith(title)] == [title]
    assert {item.name: tuple(item.matrix_world.translation) for item in collection.objects} == where


def test_a_landmark_keeps_the_weight_of_its_group(morphed):
    source, target, _ = morphed
    put_group(source, "weak", {50: 0.25})
    bpy.ops.femors.transfer(field=FIELD, groups="weak;tip")
    assert weights_of(target, "weak").max() == 0.25 and weights_of(target, "tip").max() == 1.0


def test_a_second_transfer_writes_its_groups_anew_and_touches_no_other(morphed):
    _, target, _ = morphed
    put_group(target, "tip", {0: 0.5})
    bpy.ops.femors.transfer(field=FIELD)
    names = [g.name for g in target.vertex_groups]
    assert weights_of(target, "tip")[0] == 0.5 and "tip.001" in names
    bpy.ops.femors.transfer(field=FIELD)
    assert [g.name for g in target.vertex_groups] == names


def test_a_region_between_the_targets_vertices_gets_the_nearest(morphed, tools):
    source = morphed[0]
    target = tools.add_object("Coarse", *tools.sphere(5, 6, (1.2, 0.9, 2.2)))
    points = tools.world(source)
    far = np.linalg.norm(points - points[105], axis=1)
    put_group(source, "small", {int(i): 1.0 for i in np.argsort(far)[:3]})
    assert bpy.ops.femors.transfer(field=FIELD, target="Coarse", groups="small") == {"FINISHED"}
    got = weights_of(target, "small")
    assert 1 <= (got > 0).sum() <= 9
    carried = area(source, tools.world(morphed[2]), weights_of(source, "small"))
    assert area(target, tools.world(target), got) == pytest.approx(carried, rel=0.05)
    centre = tools.world(bpy.data.objects["Femur morphed to Scan"])[np.argsort(far)[:3]].mean(axis=0)
    heaviest = tools.world(target)[np.argmax(got)]
    assert np.linalg.norm(heaviest - centre) < 1.0


def test_the_median_of_several_templates(morphed, tools):
    source = morphed[0]
    other = tools.add_object("Other", *tools.sphere(12, 18, (0.9, 0.85, 2.1)))
    tip = tools.world(source)[100] * [0.9, 0.85 / 0.8, 1.05]
    near = int(np.argmin(np.linalg.norm(tools.world(other) - tip, axis=1)))
    put_group(other, "tip", {near: 1.0})
    bpy.ops.femors.morph(source="Other", target="Scan")
    assert bpy.ops.femors.transfer(field=FIELD, groups="tip", use_templates=True) == {"FINISHED"}
    mark = bpy.context.scene.femors_transfer.marks["tip"]
    assert mark.templates == 2
    one, two = (
        np.array(tools.world(bpy.data.objects[f"{name} morphed to Scan"])[row])
        for name, row in (("Femur", 100), ("Other", near))
    )
    np.testing.assert_allclose(mark.point, (one + two) / 2, atol=1e-4)
    assert mark.spread == pytest.approx(np.linalg.norm(one - two) / 2, abs=1e-4)


def test_a_source_counts_once_and_one_that_is_gone_is_passed_over(morphed, tools):
    """Its two fields would agree with each other, and the spread be nothing."""
    bpy.ops.femors.morph(source="Femur", target="Scan")
    other = tools.add_object("Other", *tools.sphere(12, 18, (0.9, 0.85, 2.1)))
    put_group(other, "tip", {40: 1.0})
    bpy.ops.femors.morph(source="Other", target="Scan")
    marks = bpy.context.scene.femors_transfer.marks
    assert bpy.ops.femors.transfer(field=FIELD, groups="tip", use_templates=True) == {"FINISHED"}
    assert marks["tip"].templates == 2 and marks["tip"].spread > 0
    bpy.data.objects.remove(other)
    assert bpy.ops.femors.transfer(field=FIELD, groups="tip", use_templates=True) == {"FINISHED"}
    assert marks["tip"].templates == 1 and marks["tip"].spread == -1.0


# --- refused --------------------------------------------------------------------------------------
def state(tools) -> tuple:
    groups = {
        item.name: [g.name for g in item.vertex_groups] for item in bpy.data.objects if item.type == "MESH"
    }
    return tools.census(), groups, sorted(bpy.data.objects.keys())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"field": "nothing"}, "no field named 'nothing'.*Femur to Scan"),
        ({"groups": "tibia"}, "no vertex group named 'tibia'"),
        ({"target": "Femur"}, "same object"),
        ({"source": "Other"}, "made for another object"),
        ({"source": "Femur morphed to Scan"}, "lies on the target already"),
        ({"target": "gone"}, "no object named 'gone'"),
        ({"strength": 0.5}, "all the way"),
        ({"use_groups": False}, "Nothing is to be made"),
        ({"what": "OBJECTS", "objects": "gone"}, "no object named 'gone'"),
        ({"what": "OBJECTS", "objects": "Femur, Scan"}, "to be carried: semicolons stand between names"),
        ({"what": "OBJECTS", "objects": "Lamp"}, "type light"),
        ({"what": "OBJECTS", "objects": "Mark", "result": "SHAPE_KEY"}, "choose Copies"),
        ({"what": "OBJECTS", "objects": "Femur", "project": True, "strength": 0.5}, "strength 1"),
        ({"what": "OBJECTS", "objects": "Hollow"}, "no points"),
    ],
)
def test_what_cannot_be_done_is_told_and_nothing_is_lost(morphed, tools, options, words):
    other = tools.add_object("Other", tools.sphere(6, 8)[0] * 3, tools.sphere(6, 8)[1])
    put_group(other, "tip", {0: 1.0})
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    mark = bpy.data.objects.new("Mark", None)
    hollow = bpy.data.objects.new("Hollow", bpy.data.meshes.new("Hollow"))
    for item in (lamp, mark, hollow):
        bpy.context.scene.collection.objects.link(item)
    before = state(tools)
    with pytest.raises(RuntimeError, match=words):
        bpy.ops.femors.transfer(**options)
    assert state(tools) == before


def test_an_empty_group_is_named(morphed, capfd):
    source, target, _ = morphed
    source.vertex_groups.new(name="hollow")
    assert bpy.ops.femors.transfer() == {"FINISHED"}
    assert "hollow" not in target.vertex_groups
    with pytest.raises(RuntimeError, match="'hollow' is empty"):
        bpy.ops.femors.transfer(groups="hollow")


def test_without_a_field_it_says_to_morph_first(pair):
    with pytest.raises(RuntimeError, match=r"Morph first|poll"):
        bpy.ops.femors.transfer()


def test_a_damaged_field_is_told(morphed):
    text = bpy.data.texts[FIELD]
    data = bytes(text["femors_field"])
    del text["femors_field"]
    text["femors_field"] = data[: len(data) // 2]
    with pytest.raises(RuntimeError, match="cut short"):
        bpy.ops.femors.transfer()


@pytest.mark.parametrize("moved", [True, False])
def test_a_source_that_was_moved_is_told_so(morphed, moved):
    source = morphed[0]
    if moved:
        source.location.x += 5.0
    else:
        source.scale = (1.3, 1.3, 1.3)
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match=r"'Femur' was moved since" if moved else r"moved or edited since"):
        bpy.ops.femors.transfer()


@pytest.mark.parametrize("options", [{}, {"what": "OBJECTS", "objects": "Site", "project": True}])
@pytest.mark.parametrize("edited", [False, True])
def test_a_target_that_was_moved_or_edited_is_told_so(morphed, tools, edited, options):
    target = morphed[1]
    tools.add_object("Site", *tools.sphere(6, 8, (0.1, 0.1, 0.1)))
    if edited:
        for vertex in target.data.vertices:
            vertex.co.z *= 1.1
    else:
        target.location.z += 0.2
    bpy.context.view_layer.update()
    before = state(tools)
    with pytest.raises(RuntimeError, match=r"'Scan' was moved or edited since the morph \(it is"):
        bpy.ops.femors.transfer(**options)
    assert state(tools) == before


# --- steering -------------------------------------------------------------------------------------
def test_empties_of_equal_names_steer_the_morph(pair, tools):
    source, target = pair
    turn = 0.35  # about the long axis, which two ellipsoids of revolution would not tell
    ours = tools.world(source)[[0, 45, 100, 150, 210]]
    theirs = ours * [1.2, 0.9 / 0.8, 1.1]
    theirs[:, 0] += 0.15 * theirs[:, 2] ** 2 / 4
    cos, sin = np.cos(turn), np.sin(turn)
    theirs[:, :2] = theirs[:, :2] @ np.array([[cos, sin], [-sin, cos]])
    for item, points in ((source, ours), (target, theirs)):
        for number, point in enumerate(points):
            empty = bpy.data.objects.new(f"M{number}", None)
            empty.parent, empty.location = item, point
            bpy.context.scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    left = {}
    for steer in (False, True):
        bpy.ops.femors.morph(source="Femur", target="Scan", use_landmarks=True, steer=steer)
        report = json.loads(bpy.context.view_layer.objects.active.femors.report)
        assert report["landmarks"]["names"] == [f"M{n}" for n in range(5)]
        left[steer] = np.mean(report["landmarks"]["residual"])
    assert left[True] < 0.5 * left[False]
