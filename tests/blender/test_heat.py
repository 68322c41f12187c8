# SPDX-License-Identifier: GPL-3.0-or-later
"""Heat maps and the quality panel: what is written on a mesh, and that all of it goes away."""

from __future__ import annotations

import json

import bpy
import numpy as np
import pytest


def select(*items):
    for other in bpy.context.view_layer.objects:
        other.select_set(other in items)
    bpy.context.view_layer.objects.active = items[0]


def colours(item) -> np.ndarray:
    layer = item.data.color_attributes["femors_heat"]
    out = np.empty(4 * len(layer.data), dtype=np.float32)
    layer.data.foreach_get("color", out)
    return out.reshape(-1, 4)


def marks(item) -> tuple:
    mesh = item.data
    active = mesh.color_attributes.active_color
    return sorted(a.name for a in mesh.attributes), sorted(mesh.keys()), active and active.name


def test_choices_are_the_quantities(part):
    quantities = part("femors_addon.quantities").QUANTITIES
    assert [key for key, _, _ in part("operators.heat").CHOICES] == list(quantities)


@pytest.mark.parametrize(
    "quantity", ["surface_distance", "displacement", "aspect", "skewness", "scaled_jacobian"]
)
def test_a_result_is_coloured_by_each_quantity_and_back(pair, part, quantity):
    bpy.ops.femors.morph(source="Femur", target="Scan")
    item = bpy.context.object
    mine = item.data.color_attributes.new("Mine", "BYTE_COLOR", "CORNER")
    item.data.color_attributes.active_color = mine
    before = marks(item)
    assert bpy.ops.femors.show_heat(quantity=quantity) == {"FINISHED"}
    heat, table = part("operators.heat"), part("femors_addon.colours")
    note = heat.shown(item)
    assert note["quantity"] == quantity and note["high"] > note["low"]
    values = heat.values_of(item, quantity)
    expected = table.linear(table.painted(values, note["low"], note["high"], "lagoon"))
    if len(values) == len(item.data.polygons):
        expected = np.repeat(expected, [p.loop_total for p in item.data.polygons], axis=0)
    np.testing.assert_allclose(colours(item)[:, :3], expected, atol=1e-5)
    assert item.data.color_attributes.active_color.name == "femors_heat"
    assert bpy.ops.femors.hide_heat() == {"FINISHED"}
    assert marks(item) == before
    with pytest.raises(RuntimeError, match="No heat map is shown"):
        bpy.ops.femors.hide_heat()


def test_the_range_can_be_set_and_changes_what_is_shown(pair):
    item = pair[0]
    select(item)
    form = bpy.context.scene.femors_heat
    form.automatic, form.low, form.high = False, 1.0, 3.0
    bpy.ops.femors.show_heat(quantity="aspect")
    assert (item.data["femors_heat"]["low"], item.data["femors_heat"]["high"]) == (1.0, 3.0)
    first = colours(item)
    form.high = 1.5
    assert item.data["femors_heat"]["high"] == 1.5 and not np.array_equal(colours(item), first)
    form.quantity = "skewness"
    assert item.data["femors_heat"]["quantity"] == "skewness"
    form.high = 0.5
    with pytest.raises(RuntimeError, match="make To larger than From"):
        bpy.ops.femors.show_heat()


def test_the_gap_is_signed(empty, tools):
    ball = tools.add_object("Ball", *tools.sphere(20, 24, (1.0, 1.0, 1.0)))
    socket = tools.add_object("Socket", *tools.sphere(20, 24, (1.0, 1.0, 1.0)))
    socket.location = (1.5, 0, 0)
    bpy.context.view_layer.update()
    select(ball)
    with pytest.raises(RuntimeError, match="choose another mesh under Compare with"):
        bpy.ops.femors.show_heat(quantity="gap")
    bpy.context.scene.femors_heat.other = socket
    bpy.ops.femors.show_heat(quantity="gap")
    note = ball.data["femors_heat"]
    assert note["map"] == "balance" and note["low"] == -note["high"]
    most = int(np.argmax(tools.world(ball)[:, 0]))
    red, blue = colours(ball)[most, [0, 2]]
    assert red > 1.5 * blue  # the overlap
    far = int(np.argmin(tools.world(ball)[:, 0]))
    red, blue = colours(ball)[far, [0, 2]]
    assert blue > 2 * red


def test_what_is_missing_is_a_sentence_and_nothing_is_painted(pair):
    select(*pair)
    before = [marks(item) for item in pair]
    with pytest.raises(RuntimeError, match="has no displacement to be shown: it comes with a morph"):
        bpy.ops.femors.show_heat(quantity="displacement")
    assert [marks(item) for item in pair] == before
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(RuntimeError, match="Object Mode"):
        bpy.ops.femors.show_heat(quantity="aspect")
    bpy.ops.object.mode_set(mode="OBJECT")


def test_quality_is_measured_and_kept(pair):
    source, _ = pair
    assert bpy.ops.femors.quality(mesh="Femur", other="Scan") == {"FINISHED"}
    found = json.loads(source.femors.quality)
    assert found["faults"] == {"self_intersecting": 0, "folded": 0, "degenerate": 0, "slender": 0}
    assert found["mesh"]["vertices"] == len(source.data.vertices)
    assert found["against"]["overlap"]["xor"] > 0 and found["against"]["movement"] is None
    with pytest.raises(RuntimeError, match="cannot be compared with itself"):
        bpy.ops.femors.quality(mesh="Femur", other="Femur")
    with pytest.raises(RuntimeError, match="No mesh chosen"):
        bpy.ops.femors.quality()


def test_bad_faces_are_selected(pair, tools):
    source, _ = pair
    select(source)
    with pytest.raises(RuntimeError, match="Measure the quality"):
        bpy.ops.femors.select_bad_faces()
    bpy.ops.femors.quality(mesh="Femur")
    assert bpy.ops.femors.select_bad_faces() == {"CANCELLED"}  # there are none
    face = source.data.polygons[120]
    moved = source.data.vertices[face.vertices[0]]
    moved.co = -1.3 * moved.co  # a spike through the other side
    source.data.update()
    bpy.ops.femors.quality(mesh="Femur")
    bad = [a.value for a in source.data.attributes["femors_bad"].data]
    assert bad[120] and 4 <= sum(bad) < 40
    assert bpy.ops.femors.select_bad_faces() == {"FINISHED"}
    assert bpy.context.mode == "EDIT_MESH"
    bpy.ops.object.mode_set(mode="OBJECT")
    assert [p.select for p in source.data.polygons] == bad


def test_one_undo_takes_the_colours_away_and_one_brings_them_back(pair):
    select(pair[0])
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.femors.show_heat("EXEC_DEFAULT", True, quantity="aspect")
    assert "femors_heat" in bpy.data.objects["Femur"].data.color_attributes
    bpy.ops.ed.undo()
    mesh = bpy.data.objects["Femur"].data
    assert "femors_heat" not in mesh.color_attributes and "femors_heat" not in mesh


def test_a_linked_mesh_is_refused_and_measured_without_marks(pair, tmp_path):
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {pair[0]})
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.objects = ["Femur"]
    item = bpy.data.objects["Femur"]
    bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.update()
    select(item)
    with pytest.raises(RuntimeError, match="is linked from another file: make it local"):
        bpy.ops.femors.show_heat(quantity="aspect")
    assert bpy.ops.femors.quality(mesh="Femur") == {"FINISHED"}
    assert "femors_bad" not in item.data.attributes


def test_a_colour_map_from_a_file_is_still_there_and_goes(pair, tmp_path):
    select(pair[0])
    bpy.ops.femors.show_heat(quantity="skewness")
    path = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    item = bpy.data.objects["Femur"]
    assert item.data["femors_heat"]["quantity"] == "skewness"
    assert bpy.ops.femors.hide_heat() == {"FINISHED"}
    assert "femors_heat" not in item.data.color_attributes


def test_the_legend_says_how_far_values_go_beyond_its_ends(pair, part):
    item = pair[0]
    select(item)
    heat, legend, number = part("operators.heat"), part("ui.legend"), part("ui.figures").number
    values = heat.values_of(item, "aspect")
    form = bpy.context.scene.femors_heat
    form.automatic, (form.low, form.high) = False, np.percentile(values, (30, 60)).tolist()
    bpy.ops.femors.show_heat(quantity="aspect")
    note = heat.shown(item)
    assert (note["least"], note["most"]) == pytest.approx((values.min(), values.max()))
    first, *_, last = legend.labels(note)
    assert first == f"{number(form.low)}, down to {number(values.min())}"
    assert last == f"{number(form.high)}, up to {number(values.max())}"
    form.low, form.high = 0.0, 1e3
    assert not any("to" in label for label in legend.labels(heat.shown(item)))


def test_what_is_shown_first_is_no_distance_from_what_vertices_were_laid_on(pair):
    bpy.ops.femors.morph(source="Femur", target="Scan")
    bpy.ops.femors.show_heat()
    assert bpy.context.object.data["femors_heat"]["quantity"] == "displacement"
