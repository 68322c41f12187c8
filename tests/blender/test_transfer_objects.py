# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that a field carries in Blender, and that all routes give the same."""

from __future__ import annotations

import json

import bpy
import numpy as np
import pytest
from field_cases import FIELD, put_group, weights_of
from mathutils import Vector


# --- objects --------------------------------------------------------------------------------------
def moved(name: str, **options):
    """Carry an object and return its copy."""
    assert bpy.ops.femors.transfer(field=FIELD, what="OBJECTS", objects=name, **options) == {"FINISHED"}
    return bpy.data.objects[f"{name} carried"]


@pytest.fixture()
def truth(morphed, part):
    """What the core says of points."""
    keptfield, carry = part("femors_addon.keptfield"), part("femors_addon.carry")
    carrier = carry.Carrier(keptfield.decoded(bpy.data.texts[FIELD]["femors_field"], "x"))
    return lambda points, **options: carrier.carry(points, **options).points


def test_a_mesh_is_copied_and_carried_from_wherever_it_stands(morphed, tools, truth):
    item = tools.add_object("Site", *tools.sphere(6, 8, (0.2, 0.2, 0.2)))
    item.location, item.rotation_euler, item.scale = (0.9, 0.1, 0.2), (0.3, 0.2, 0.1), (1.0, 2.0, 0.5)
    item.shape_key_add(name="Basis")
    bpy.context.view_layer.update()
    before = tools.world(item).copy()
    copy = moved("Site")
    np.testing.assert_allclose(tools.world(copy), truth(before), atol=1e-5)
    np.testing.assert_array_equal(tools.world(item), before)
    moved("Site", strength=0.5)
    half = bpy.data.objects["Site carried.001"]
    np.testing.assert_allclose(tools.world(half), (before + truth(before)) / 2, atol=1e-5)
    assert bpy.ops.femors.transfer(field=FIELD, what="OBJECTS", objects="Site", result="SHAPE_KEY") == {
        "FINISHED"
    }
    key = item.data.shape_keys.key_blocks[-1]
    assert key.value == 1.0 and key.name == f"Carried by {FIELD}"


def test_what_cannot_be_carried_is_refused_with_what_can_be_done(morphed):
    """Of the grease pencil, Blender 4.2 makes a curve, later ones a mesh."""
    pencil, made = ("gpencil_add", "a curve") if bpy.app.version < (4, 3) else ("grease_pencil_add", "a mesh")
    for add, options, remedy in (
        ("text_add", {}, "convert it to a mesh"),
        ("metaball_add", {}, "convert it to a mesh"),
        (pencil, {"type": "STROKE"}, f"convert it to {made}"),
        ("light_add", {}, "carry an empty in its place"),
    ):
        getattr(bpy.ops.object, add)(**options)
        name = bpy.context.object.name
        with pytest.raises(RuntimeError, match=f"'{name}' is of type .*: {remedy}"):
            bpy.ops.femors.transfer(field=FIELD, what="OBJECTS", objects=name)


def test_inverse_takes_the_result_back(morphed, tools):
    source, _, result = morphed
    back = moved(result.name, inverse=True)
    np.testing.assert_allclose(tools.world(back), tools.world(source), atol=2e-3)


def test_projected_onto_the_target(morphed, tools):
    _, target, _ = morphed
    tools.add_object("Site", tools.sphere(6, 8, (0.1, 0.1, 0.1))[0] + [1.0, 0, 0], tools.sphere(6, 8)[1])
    copy = moved("Site", project=True)
    for point in tools.world(copy):
        _, near, _, _ = target.closest_point_on_mesh(Vector(point))
        assert (near - Vector(point)).length < 1e-4


def test_empties_curves_and_bones_go_where_points_go(morphed, truth):
    empty = bpy.data.objects.new("Mark", None)
    empty.location = (1.0, 0.0, 0.3)
    curve = bpy.data.curves.new("Muscle", "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new("POLY")
    spline.points.add(2)
    path = np.array([[1.0, 0, 0.3], [1.2, 0.1, 0.5], [1.4, 0, 1.0]])
    for point, place in zip(spline.points, path, strict=True):
        point.co = (*place, 1.0)
    round_one = curve.splines.new("BEZIER")
    round_one.bezier_points[0].co = (1.1, 0, 0)
    round_one.bezier_points[0].handle_left = (1.1, -0.1, 0)
    round_one.bezier_points[0].handle_right = (1.1, 0.1, 0)
    muscle = bpy.data.objects.new("Muscle", curve)
    armature = bpy.data.armatures.new("Rig")
    rig = bpy.data.objects.new("Rig", armature)
    for item in (empty, muscle, rig):
        bpy.context.scene.collection.objects.link(item)
    rig.location = (0.1, 0.0, 0.0)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    bone = armature.edit_bones.new("Shaft")
    bone.head, bone.tail = (0.0, 0.0, -1.5), (0.0, 0.0, 1.5)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()

    np.testing.assert_allclose(moved("Mark").matrix_world.translation, truth([[1.0, 0, 0.3]])[0], atol=1e-5)
    copy = moved("Muscle")
    got = np.array([tuple(p.co)[:3] for p in copy.data.splines[0].points])
    np.testing.assert_allclose(got, truth(path), atol=1e-5)
    knot = copy.data.splines[1].bezier_points[0]
    for end, place in (("handle_left", (1.1, -0.1, 0)), ("co", (1.1, 0, 0)), ("handle_right", (1.1, 0.1, 0))):
        np.testing.assert_allclose(getattr(knot, end), truth([place])[0], atol=1e-5)
    bones = moved("Rig").data.bones["Shaft"]
    ends = truth([[0.1, 0, -1.5], [0.1, 0, 1.5]])
    np.testing.assert_allclose(np.array(bones.head_local) + [0.1, 0, 0], ends[0], atol=1e-4)
    np.testing.assert_allclose(np.array(bones.tail_local) + [0.1, 0, 0], ends[1], atol=1e-4)
    np.testing.assert_allclose(armature.bones["Shaft"].head_local, (0, 0, -1.5), atol=1e-6)


@pytest.mark.parametrize("kind", ["EMPTY", "MESH"])
def test_a_copy_is_not_held_back_by_constraints(morphed, tools, truth, kind):
    anchor = bpy.data.objects.new("Anchor", None)
    anchor.location = (0.9, 0.1, 0.4)
    if kind == "EMPTY":
        item = bpy.data.objects.new("Held", None)
        bpy.context.scene.collection.objects.link(item)
    else:
        item = tools.add_object("Held", *tools.sphere(6, 8, (0.1, 0.1, 0.1)))
    bpy.context.scene.collection.objects.link(anchor)
    item.constraints.new("COPY_LOCATION").target = anchor
    bpy.context.view_layer.update()
    before = np.array([item.matrix_world.translation]) if kind == "EMPTY" else tools.world(item)
    assert np.linalg.norm(before[0]) > 0.5
    copy = moved("Held")
    bpy.context.view_layer.update()
    after = np.array([copy.matrix_world.translation]) if kind == "EMPTY" else tools.world(copy)
    np.testing.assert_allclose(after, truth(before), atol=1e-5)
    assert len(item.constraints) == 1


def test_empties_that_are_carried_are_landmarks(morphed, tools, truth):
    """They keep their names, get their figures, and stand in the table; one far away is told."""
    source = morphed[0]
    for name, point in (("a", tools.world(source)[100]), ("b", (0.5, 0.0, 40.0))):
        empty = bpy.data.objects.new(name, None)
        empty["femors_landmark"], empty.location = name, point
        bpy.context.scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    assert bpy.ops.femors.transfer(field=FIELD, what="OBJECTS", objects="a;b") == {"FINISHED"}
    marks = bpy.context.scene.femors_transfer.marks
    assert [mark.name for mark in marks] == ["a", "b"]
    assert marks["b"].distance > 30 and abs(marks["a"].distance) < 1e-4
    copy = bpy.data.objects["a carried"]
    (group,) = copy.users_collection
    assert [item.name for item in group.objects] == ["a carried", "b carried"]
    assert copy["femors_landmark"] == "a" and copy["femors_stretch"] == pytest.approx(marks["a"].stretch)


def test_landmarks_in_another_unit_are_told_with_it(morphed, tools):
    for number, point in enumerate(tools.world(morphed[0])[::40] * 0.001):
        empty = bpy.data.objects.new(f"m{number}", None)
        empty["femors_landmark"], empty.location = empty.name, point
        bpy.context.scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    names = ";".join(item.name for item in bpy.data.objects if item.type == "EMPTY")
    assert bpy.ops.femors.transfer(field=FIELD, what="OBJECTS", objects=names) == {"FINISHED"}
    notes = " ".join(json.loads(bpy.context.scene.femors_transfer.report)["notes"])
    assert "were they 1000 times larger" in notes and "(metres)?" not in notes


def test_a_landmark_that_is_there_twice_is_told(morphed):
    source = morphed[0]
    empty = bpy.data.objects.new("tip", None)
    empty.parent = source
    bpy.context.scene.collection.objects.link(empty)
    with pytest.raises(RuntimeError, match="'tip' twice"):
        bpy.ops.femors.morph(source="Femur", target="Scan", use_landmarks=True)


def test_carried_landmarks_are_none_of_the_source(morphed, part):
    source = morphed[0]
    names = ("tip", "pole", "sites", "low", "below")
    tip, pole, group, low, below = (bpy.data.objects.new(name, None) for name in names)
    for empty, parent in ((group, None), (tip, source), (pole, group), (low, source), (below, low)):
        empty.parent = parent
        bpy.context.scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    assert bpy.ops.femors.transfer(field=FIELD, what="OBJECTS", objects="tip;pole;below") == {"FINISHED"}
    copies = [bpy.data.objects[f"{item.name} carried"] for item in (tip, pole, below)]
    assert [item.parent for item in copies] == [None, group, None]
    before = [item.matrix_world.translation.copy() for item in copies]
    source.location.x += 10.0
    bpy.context.view_layer.update()
    for item, place in zip(copies, before, strict=True):
        assert (item.matrix_world.translation - place).length < 1e-5
    assert set(part("operators.marks").children(source)) == {"tip", "low"}  # nothing stands twice


def test_selected_objects_are_taken_where_none_is_named(morphed, tools):
    for item in bpy.context.selected_objects:
        item.select_set(False)
    tools.add_object("Site", *tools.sphere(6, 8)).select_set(True)
    assert bpy.ops.femors.transfer(what="OBJECTS") == {"FINISHED"}
    assert [item.name for item in bpy.context.selected_objects] == ["Site carried"]


# --- routes ---------------------------------------------------------------------------------------
def test_groups_empties_and_the_command_line_agree(morphed, tools, tmp_path, part):
    source, _, _ = morphed
    bpy.ops.femors.transfer(field=FIELD, use_empties=True)
    (tmp_path / "f.npz").write_bytes(bytes(bpy.data.texts[FIELD]["femors_field"]))
    before = tools.world(source)[[100, len(source.data.vertices) - 1]]
    np.savetxt(tmp_path / "marks.csv", before, delimiter=",", fmt="%.17g")
    cli = part("femors_addon.cli")
    out = tmp_path / "out"
    assert cli.main(["transfer", str(tmp_path / "f.npz"), str(tmp_path / "marks.csv"), "-o", str(out)]) == 0
    line = np.loadtxt(out / "marks.csv", delimiter=",")
    empties = {item["femors_landmark"]: item for item in bpy.data.objects if item.type == "EMPTY"}
    seen = [tuple(empties[name].matrix_world.translation) for name in ("tip", "pole")]
    np.testing.assert_allclose(seen, line, atol=5e-7)
    table = [tuple(mark.point) for mark in bpy.context.scene.femors_transfer.marks]
    np.testing.assert_allclose(table, line, atol=5e-7)


def test_the_routes_agree_at_the_scale_of_a_bone(empty, tools, tmp_path, part):
    """Blender's numbers are single precision: 2e-5 mm at 400 mm, and some roundings of them."""
    shapes = part("femors_addon.shapes")
    bone, other = shapes.bone(700), shapes.bone(700, lattice=1)
    goal = shapes.warp(other.vertices, ("bend", 0.15), ("twist", 0.1)) + [90.0, 0, 0]
    source = tools.add_object("Femur", bone.vertices, bone.faces.tolist())
    target = tools.add_object("Scan", goal, other.faces.tolist())
    bpy.context.view_layer.update()
    rows = list(range(0, 700, 100))
    before = tools.world(source)
    for row in rows:
        put_group(source, f"v{row}", {row: 1.0})
        mark = bpy.data.objects.new(f"e{row}", None)
        mark.location = before[row]
        bpy.context.scene.collection.objects.link(mark)
    near = np.linalg.norm(before - before[300], axis=1) < 25
    faces = bone.faces[near[bone.faces].all(axis=1)]
    tools.add_object("Site", before[np.unique(faces)], np.searchsorted(np.unique(faces), faces).tolist())
    bpy.context.view_layer.update()
    bpy.ops.femors.morph(source="Femur", target="Scan")
    bpy.ops.femors.transfer(field=FIELD, use_empties=True)
    names = ";".join(["Site", *(f"e{row}" for row in rows)])
    bpy.ops.femors.transfer(field=FIELD, what="OBJECTS", objects=names)
    (tmp_path / "f.npz").write_bytes(bytes(bpy.data.texts[FIELD]["femors_field"]))
    np.savetxt(tmp_path / "marks.csv", before[rows], delimiter=",", fmt="%.17g")
    site = bpy.data.objects["Site"]
    lines = ["v {:.17g} {:.17g} {:.17g}".format(*point) for point in tools.world(site)]
    lines += ["f " + " ".join(str(v + 1) for v in face.vertices) for face in site.data.polygons]
    (tmp_path / "site.obj").write_text("\n".join([*lines, ""]))
    args = [str(tmp_path / name) for name in ("f.npz", "marks.csv", "site.obj")]
    assert part("femors_addon.cli").main(["transfer", *args, "-o", str(tmp_path / "out"), "--quiet"]) == 0
    line = np.loadtxt(tmp_path / "out" / "marks.csv", delimiter=",")
    empties = list(bpy.data.collections[f"{FIELD} landmarks"].objects)
    seen = [tuple(item.matrix_world.translation) for item in empties]
    np.testing.assert_allclose(seen, line, atol=1e-4)
    carried = [tuple(bpy.data.objects[f"e{row} carried"].matrix_world.translation) for row in rows]
    np.testing.assert_allclose(carried, line, atol=1e-4)
    points = tools.world(target)
    for row, place in zip(rows, line, strict=True):
        nearest = np.argmin(np.linalg.norm(points - place, axis=1))
        assert weights_of(target, f"v{row}")[nearest] == 1.0
    written = [
        row.split()[1:] for row in (tmp_path / "out" / "site.obj").read_text().splitlines() if row[:2] == "v "
    ]
    np.testing.assert_allclose(
        tools.world(bpy.data.objects["Site carried"]), np.array(written, float), atol=1e-4
    )
