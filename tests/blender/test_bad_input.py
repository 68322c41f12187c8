# SPDX-License-Identifier: GPL-3.0-or-later
"""What cannot be worked with: one line, and the file is as it was."""

from __future__ import annotations

import bpy
import numpy as np
import pytest


@pytest.fixture()
def refused(pair, tools):
    """A function that calls the morph, expects one line about `match`, and an unchanged file."""

    def call(match: str, **options) -> str:
        arguments = {"source": "Femur", "target": "Scan"} | options
        before = tools.census(), tools.world(pair[0]).tobytes(), tools.world(pair[1]).tobytes()
        attributes = [a.name for a in pair[0].data.attributes]
        with pytest.raises(RuntimeError, match=match) as caught:
            bpy.ops.femors.morph(**arguments)
        line = str(caught.value).removeprefix("Error: ").strip()
        assert "\n" not in line and "Traceback" not in line and "unexpected" not in line, line
        assert (tools.census(), tools.world(pair[0]).tobytes(), tools.world(pair[1]).tobytes()) == before
        assert [a.name for a in pair[0].data.attributes] == attributes
        assert bpy.context.mode == "OBJECT"
        return line

    return call


def test_nothing_named(refused):
    refused("No source chosen", source="")
    refused("No target chosen", target="")


def test_no_such_object(refused):
    refused("no object named 'Tibia'", target="Tibia")


def test_the_same_object(refused):
    refused("same object", target="Femur")


def test_not_a_mesh(refused):
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    bpy.context.scene.collection.objects.link(lamp)
    refused("is of type light", source="Lamp")


def test_an_object_in_no_scene(refused, pair):
    bpy.context.scene.collection.objects.unlink(pair[1])
    refused("no object named 'Scan'")


BAD = {
    "empty": ([], [], "no faces"),
    "points": ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], "no faces"),
    "triangle": ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)], "face"),
    "flat": ([(x, y, 0) for x in range(4) for y in range(4)], None, "plane"),
    "one point": ([(1, 1, 1)] * 16, None, "."),
}


@pytest.mark.parametrize("role", ["source", "target"])
@pytest.mark.parametrize("name", BAD)
def test_no_surface(refused, tools, name, role):
    vertices, faces, match = BAD[name]
    if faces is None:
        faces = [(4 * i + j, 4 * i + j + 4, 4 * i + j + 5, 4 * i + j + 1) for i in range(3) for j in range(3)]
    tools.add_object("Bad", vertices, faces)
    refused(match, **{role: "Bad"})


@pytest.mark.parametrize("role", ["source", "target"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_coordinates_that_are_not_finite(refused, tools, value, role):
    vertices, faces = tools.sphere()
    vertices[5, 1] = value
    tools.add_object("Bad", vertices, faces)
    line = refused("not finite", **{role: "Bad"})
    assert "'Bad'" in line


def test_a_scale_of_zero(refused, pair):
    pair[0].scale = (1, 0, 1)
    bpy.context.view_layer.update()
    refused("scaled to zero")


def test_edit_mode(pair):
    bpy.context.view_layer.objects.active = pair[0]
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        with pytest.raises(RuntimeError, match="Object Mode"):
            bpy.ops.femors.morph(source="Femur", target="Scan")
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")


def test_vertex_groups(refused, pair):
    refused("no vertex group named 'Head'", vertex_group="Head")
    group = pair[0].vertex_groups.new(name="Head")
    refused("no vertex with a weight", vertex_group="Head")
    group.add([0, 1], 0.0, "REPLACE")
    refused("no vertex with a weight", vertex_group="Head")


def test_landmarks(refused, pair):
    for item in pair:
        for i, name in enumerate(("a", "b")):
            item.vertex_groups.new(name=name).add([i], 1.0, "REPLACE")
    pair[0].vertex_groups.new(name="only here").add([3], 1.0, "REPLACE")
    refused("2 landmark pair", use_landmarks=True)


def test_in_place_with_shape_keys(refused, pair):
    pair[0].shape_key_add(name="Basis")
    refused("has shape keys", result="IN_PLACE")


def test_absolute_shape_keys(refused, pair):
    pair[0].shape_key_add(name="Basis")
    pair[0].data.shape_keys.use_relative = False
    refused("absolute shape keys", result="SHAPE_KEY")


@pytest.mark.parametrize("result", ["SHAPE_KEY", "IN_PLACE"])
def test_evaluated_geometry_only_into_a_new_object(refused, pair, result):
    pair[0].modifiers.new("Subdivision", "SUBSURF")
    refused("has modifiers", result=result, use_evaluated=True)


def test_evaluated_geometry_of_a_disabled_object(refused, pair):
    pair[1].hide_viewport = True
    bpy.context.view_layer.update()
    refused("does not evaluate its modifiers", use_evaluated=True)


def test_settings_out_of_range_are_held_within(pair):
    """Blender itself clamps numbers; a wrong choice is refused by Blender with the choices."""
    with pytest.raises(TypeError, match="standard"):
        bpy.ops.femors.morph(source="Femur", target="Scan", preset="perfect")


def edited(pair):
    pair[0].data.vertices[3].co.x += 0.1


def turned(pair):
    """A face is of other vertices, and nothing has moved."""
    mesh = pair[1].data
    mesh.polygons[3].vertices = list(mesh.polygons[3].vertices)[::-1]


def moved(pair):
    pair[1].location.x += 1


def deleted(pair):
    bpy.data.objects.remove(pair[1])


def taken_away(pair):
    bpy.context.scene.collection.objects.unlink(pair[0])


def renamed(pair):
    pair[0].name = "Tibia"


def emptied(pair):
    pair[0].data.clear_geometry()


CHANGES = {
    edited: "edited",
    turned: "edited",
    moved: "moved",
    deleted: "deleted",
    taken_away: "deleted",
    renamed: "renamed",
    emptied: "edited",
}


@pytest.mark.parametrize("change", CHANGES, ids=lambda f: f.__name__)
@pytest.mark.parametrize("result", ["NEW", "SHAPE_KEY", "IN_PLACE"])
def test_changes_while_it_runs(pair, tools, part, monkeypatch, change, result):
    core = part("femors_addon.morph")
    real = core.morph
    seen = {}

    def meanwhile(*args, **options):
        done = real(*args, **options)
        change(pair)
        bpy.context.view_layer.update()
        seen["census"] = tools.census()
        return done

    monkeypatch.setattr(core, "morph", meanwhile)
    with pytest.raises(RuntimeError, match=f"{CHANGES[change]}.*while the job ran") as caught:
        bpy.ops.femors.morph(source="Femur", target="Scan", result=result)
    assert str(caught.value).strip().count("\n") == 0
    assert tools.census() == seen["census"]


def test_a_failure_while_writing_leaves_no_half_result(pair, tools, part, monkeypatch):
    def full(*args):
        raise MemoryError

    monkeypatch.setattr(part("operators.result"), "_write_positions", full)
    before = tools.census()
    with pytest.raises(RuntimeError, match="Not enough memory"):
        bpy.ops.femors.morph(source="Femur", target="Scan")
    assert tools.census() == before
