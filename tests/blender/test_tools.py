# SPDX-License-Identifier: GPL-3.0-or-later
"""Report, film, presets and preferences."""

from __future__ import annotations

import json

import bpy
import pytest


def test_a_report_has_pictures_figures_and_versions(pair, tmp_path):
    bpy.ops.femors.morph(source="Femur", target="Scan")
    bpy.ops.femors.quality(mesh="Femur morphed to Scan", other="Scan")
    path = tmp_path / "r.html"
    assert bpy.ops.femors.report(filepath=str(path)) == {"FINISHED"}
    text = path.read_text(encoding="utf-8")
    assert text.count("data:image/png") >= 6 and text.count("<svg") >= 6
    for words in ("Source, aligned", "Target", "Result", bpy.app.version_string, "Quality", "Settings"):
        assert words in text, words
    assert bpy.ops.femors.report(filepath=str(tmp_path / "r.json")) == {"FINISHED"}
    data = json.loads((tmp_path / "r.json").read_text())
    assert data["source"] == "Femur" and data["quality"]["against"]["overlap"]["xor"] >= 0
    assert bpy.ops.femors.report(filepath=str(tmp_path / "r.csv")) == {"FINISHED"}
    assert sorted(one.name for one in tmp_path.iterdir()) == ["r.csv", "r.html", "r.json"]


@pytest.mark.filterwarnings(
    "ignore:.*blend relative:RuntimeWarning"
)  # of Blender 5.2, which takes it even so
def test_a_report_beside_an_unsaved_file_says_where_it_is(pair, tmp_path, monkeypatch, capfd):
    """ "//" is the folder of the .blend, and there is none."""
    monkeypatch.chdir(tmp_path)
    bpy.ops.femors.morph(source="Femur", target="Scan")
    assert bpy.ops.femors.report(filepath="//r.json") == {"FINISHED"}
    assert str(tmp_path / "r.json") in "".join(capfd.readouterr()) and (tmp_path / "r.json").exists()


@pytest.mark.parametrize("gone", ["Femur", "Scan"])
def test_a_report_does_without_what_is_gone(pair, tmp_path, gone):
    bpy.ops.femors.morph(source="Femur", target="Scan")
    bpy.data.objects.remove(bpy.data.objects[gone])
    bpy.context.view_layer.objects.active = bpy.data.objects["Femur morphed to Scan"]
    assert bpy.ops.femors.report(filepath=str(tmp_path / "r.html")) == {"FINISHED"}


def test_a_shape_key_that_reports_shows_the_morphed_shape(pair, tmp_path):
    bpy.ops.femors.morph(source="Femur", target="Scan", result="SHAPE_KEY")
    bpy.context.view_layer.objects.active = pair[0]
    assert bpy.ops.femors.report(filepath=str(tmp_path / "r.html")) == {"FINISHED"}


def test_what_cannot_be_reported_is_a_sentence(pair, tmp_path):
    bpy.context.view_layer.objects.active = pair[0]
    with pytest.raises(RuntimeError, match="nothing to report of 'Femur'"):
        bpy.ops.femors.report(filepath=str(tmp_path / "r.html"))
    bpy.ops.femors.quality(mesh="Femur")
    with pytest.raises(RuntimeError, match="a report ends in"):
        bpy.ops.femors.report(filepath=str(tmp_path / "r.pdf"))
    with pytest.raises(RuntimeError, match="No file named"):
        bpy.ops.femors.report()
    with pytest.raises(RuntimeError, match="nowhere"):
        bpy.ops.femors.report(filepath=str(tmp_path / "nowhere" / "r.html"))
    assert list(tmp_path.iterdir()) == []


def values(item) -> dict[int, float]:
    key = item.data.shape_keys.key_blocks["Morphed to Scan"]
    out = {}
    for frame in (1, 31, 61):
        bpy.context.scene.frame_set(frame)
        out[frame] = round(key.value, 3)
    return out


def test_the_shape_key_becomes_a_film(pair):
    source, _ = pair
    bpy.context.view_layer.objects.active = source
    with pytest.raises(RuntimeError, match="morph with Result set to Shape Key"):
        bpy.ops.femors.animate()
    bpy.ops.femors.morph(source="Femur", target="Scan", result="SHAPE_KEY")
    bpy.context.view_layer.objects.active = source
    assert bpy.ops.femors.animate() == {"FINISHED"}
    assert bpy.context.scene.frame_current == 1
    assert values(source) == {1: 0.0, 31: 0.5, 61: 1.0}
    assert bpy.ops.femors.animate(start=11, frames=20) == {"FINISHED"}  # in place of the other
    assert values(source) == {1: 0.0, 31: 1.0, 61: 1.0}


def test_presets_are_saved_and_loaded_as_blender_does(empty, part, tmp_path, monkeypatch):
    module = part("operators.presets")
    form = bpy.context.scene.femors
    form.preset, form.spread_end, form.result = "published", 3.5, "SHAPE_KEY"
    assert bpy.ops.femors.preset_add(name="Knee") == {"FINISHED"}
    found = [
        p
        for folder in bpy.utils.preset_paths(module.FOLDER)
        for p in __import__("pathlib").Path(folder).glob("*.py")
    ]
    knee = next(p for p in found if p.stem == "Knee")
    form.preset, form.result = "standard", "NEW"
    assert bpy.ops.script.execute_preset(filepath=str(knee), menu_idname="FEMORS_MT_presets") == {"FINISHED"}
    assert (form.preset, round(form.spread_end, 3), form.result) == ("published", 3.5, "SHAPE_KEY")
    assert form.spread_start == pytest.approx(10.0) or form.spread_start > 0
    assert bpy.ops.femors.preset_add(name="Knee", remove_name=True) == {"FINISHED"}
    assert not knee.exists()


def test_preferences_hold(pair, part):
    preferences = bpy.context.preferences.addons[part("ui.preferences").PACKAGE].preferences
    limits, colours = part("femors_addon.limits").Limits, part("femors_addon.colours")
    assert part("ui.preferences").MAPS == colours.SEQUENTIAL
    try:
        preferences.threads, preferences.memory = 2, 20
        assert (limits.threads, limits.memory) == (2, 20e6)
        with pytest.raises(RuntimeError, match="limit in the preferences is 20 MB"):
            bpy.ops.femors.morph(source="Femur", target="Scan")
        preferences.memory = 0
        bpy.ops.femors.morph(source="Femur", target="Scan")
        pair[0].vertex_groups.new(name="tip").add([100], 1.0, "REPLACE")
        objects, report = set(bpy.data.objects), bpy.context.scene.femors_transfer.report
        preferences.memory = 5
        for refused in (
            lambda: bpy.ops.femors.quality(mesh="Femur", other="Scan"),
            bpy.ops.femors.transfer,
            lambda: bpy.ops.femors.transfer(what="OBJECTS", objects="Femur"),
            lambda: bpy.ops.femors.remove_overclosure(bodies="Femur;Scan"),
            lambda: bpy.ops.femors.check_overclosure(bodies="Femur;Scan"),
        ):
            with pytest.raises(RuntimeError, match="limit in the preferences is 5 MB"):
                refused()
        assert set(bpy.data.objects) == objects and not pair[1].vertex_groups
        assert (bpy.context.scene.femors_transfer.report, pair[0].femors.quality) == (report, "")
        preferences.memory = 0
        preferences.unit = "MILLIMETERS"
        figures = part("ui.figures")
        assert figures.length_unit(bpy.context.scene.unit_settings) == (1.0, "mm")
        item = pair[0]
        item.select_set(True)
        bpy.context.view_layer.objects.active = item
        bpy.ops.femors.show_heat(quantity="aspect")
        preferences.colour_map = "ember"
        assert item.data["femors_heat"]["map"] == "ember"
    finally:
        preferences.threads, preferences.memory, preferences.unit = 1, 0, "NONE"
        preferences.colour_map = "lagoon"
