# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of FE decks that are morphed, measured and coloured in Blender."""

from __future__ import annotations

import json
import os
from pathlib import Path

import bpy
import numpy as np
import pytest
from deck_cases import (
    assembly,
    export,
    grid,
    plain,
    still,
    target_of,
    warp,
)
from drawn import Layout, sidebar

DATA = Path(os.environ.get("FEMORS_DATA") or Path(__file__).resolve().parents[3] / "shared" / "data")
KNEE = DATA / "knee"


# --- morph ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["NEW", "SHAPE_KEY", "IN_PLACE"])
def test_morph_save_open_export_is_the_core(deck, tmp_path, tools, core, kind):
    path, (item,) = deck(plain())
    _, surface = target_of(tools, core, path)
    read = core("deckfiles").read_deck(path)
    expected, _ = core("deck_morph").morph_part(read, read.part(None), surface, still(core))
    options = {"target": "Target", "alignment": "none", "result": kind}
    assert bpy.ops.femors.morph(source=item.name, **options) == {"FINISHED"}
    made = bpy.context.object
    assert made.name == ("BLOCK morphed to Target" if kind == "NEW" else "BLOCK")
    elements = json.loads(made.femors.report)["volume"]
    assert elements["newly_inverted"] == [] and elements["after"]["minimum"] > 0.2
    name = made.name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    path.unlink()  # the original has moved
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert export(tmp_path / "out.inp", object=name) == expected.encoded()
    inner = np.setdiff1d(np.arange(len(expected.coordinates)), read.mesh.surface()[1])
    goal = warp(read.coordinates[inner])
    assert np.abs(expected.coordinates[inner] - goal).max() < 1.0, "the interior has followed"
    # and an edit of one vertex afterwards adds to the exact position
    made = bpy.data.objects[name]
    block = made.data.shape_keys.key_blocks[-1].data if kind == "SHAPE_KEY" else made.data.vertices
    block[5].co.y += 0.25
    export(tmp_path / "edited.inp", object=name)
    moved = core("deckfiles").read_deck(tmp_path / "edited.inp").coordinates - expected.coordinates
    assert moved[5, 1] == pytest.approx(0.25, abs=4e-6)
    assert np.count_nonzero(moved) == 1


def test_the_slider_counts(deck, tmp_path, tools, core):
    path, (item,) = deck(plain())
    target_of(tools, core, path)
    read = core("deckfiles").read_deck
    bpy.ops.femors.morph(source=item.name, target="Target", result="SHAPE_KEY")
    export(tmp_path / "1.inp", object=item.name)
    key = item.data.shape_keys.key_blocks[-1]
    key.value = 0.5
    export(tmp_path / "half.inp", object=item.name)
    middle = 0.5 * (read(path).coordinates + read(tmp_path / "1.inp").coordinates)
    np.testing.assert_allclose(read(tmp_path / "half.inp").coordinates, middle, atol=1e-12)
    key.value = 0.0
    assert export(tmp_path / "0.inp", object=item.name) == path.read_bytes()


def test_two_morphs_one_after_the_other(deck, tmp_path, tools, core):
    path, (item,) = deck(plain())
    read = core("deckfiles").read_deck(path)
    _, surface = target_of(tools, core, path)
    bpy.ops.femors.morph(source=item.name, target="Target")
    made = bpy.context.object
    bpy.ops.femors.morph(source=made.name, target="Target")
    again = bpy.context.object
    once, _ = core("deck_morph").morph_part(read, read.part(None), surface)
    twice, _ = core("deck_morph").morph_part(once, once.part(None), surface)
    expected = read.with_coordinates(twice.coordinates).encoded()
    assert export(tmp_path / "out.inp", object=again.name) == expected


def test_weights_and_a_deck_as_target(deck, tmp_path, tools, core):
    path, (item,) = deck(plain())
    target, _ = target_of(tools, core, path)
    second = tmp_path / "goal.inp"
    read = core("deckfiles").read_deck(path)
    read.with_coordinates(warp(read.coordinates)).write(second)
    bpy.data.objects.remove(target)
    bpy.ops.femors.import_deck(filepath=str(second))
    goal = bpy.context.object
    bpy.ops.femors.morph(source=item.name, target=goal.name, vertex_group="HALF", alignment="none")
    export(tmp_path / "out.inp", object=bpy.context.object.name)
    after = core("deckfiles").read_deck(tmp_path / "out.inp").coordinates
    moved = np.linalg.norm(after - read.coordinates, axis=1)
    surface = np.intersect1d(read.mesh.surface()[1], np.setdiff1d(np.arange(len(after)), grid()[1][:45]))
    assert moved[surface].max() == 0.0 and moved.max() > 1.0


def test_instances_are_morphed_where_they_stand(deck, tmp_path, tools, core):
    path, items = deck(assembly())
    two = next(item for item in items if item.name == "Brick-2")
    read = core("deckfiles").read_deck(path)
    surface, _ = read.submesh(read.part("Brick"))[0].surface()
    vertices = surface.vertices * [1.2, 1.1, 1.0]
    goal = tools.add_object("Target", vertices, surface.faces.tolist())
    goal.matrix_world = two.matrix_world
    bpy.context.view_layer.update()
    bpy.ops.femors.morph(source="Brick-2", target="Target")
    export(tmp_path / "out.inp", object=bpy.context.object.name)
    after = core("deckfiles").read_deck(tmp_path / "out.inp").coordinates
    np.testing.assert_allclose(np.ptp(after, axis=0), np.ptp(vertices, axis=0), atol=0.02)
    assert after.max() < 20, "in the part's own coordinates"


# --- a real cartilage ---------------------------------------------------------------------------------------
def test_a_femoral_cartilage(empty, tmp_path, tools, core):
    path = KNEE / "cartilage_femur_hex.inp"
    if not path.is_file():
        pytest.skip(f"needs {path}")
    bpy.ops.femors.import_deck(filepath=str(path))
    item = bpy.context.object
    assert export(tmp_path / "same.inp") == path.read_bytes()
    read = core("deckfiles").read_deck(path)
    surface, _ = read.mesh.surface()
    x, y, z = ((surface.vertices - surface.vertices.mean(axis=0)) / surface.diagonal).T
    bend = np.stack([6 * np.sin(4 * y), 6 * np.cos(4 * z), 5 * np.sin(4 * x + 1)], axis=1)
    vertices = (surface.vertices + bend).astype(np.float32).astype(float)
    tools.add_object("Target", vertices, surface.faces.tolist())
    assert bpy.ops.femors.morph(source=item.name, target="Target") == {"FINISHED"}
    name = bpy.context.object.name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    got = export(tmp_path / "out.inp", object=name)
    aim = core("mesh").Surface(vertices, surface.faces)
    expected, result = core("deck_morph").morph_part(read, read.part(None), aim)
    assert got == expected.encoded()
    assert not len(result.inverted_new)


def test_elements_that_a_morph_has_repaired_are_not_drawn_as_inverted(deck, tools, core, part):
    path, (item,) = deck(plain())
    target_of(tools, core, path)
    assert bpy.ops.femors.morph(source=item.name, target="Target", alignment="none") == {"FINISHED"}
    report = json.loads(bpy.context.object.femors.report)
    elements = report["volume"]
    elements["inverted_on_input"] = [1, 2, 3]
    elements["before"]["inverted"], elements["after"]["inverted"] = 3, 1
    layout = Layout()
    part("ui.figures").draw_figures(layout, report, sidebar(280))
    row = layout.said.index("Inverted elements")
    assert layout.said[row + 1 : row + 3] == ["3", "1"]


# --- figures and colours -------------------------------------------------------------------------------
def test_elements_are_measured_and_coloured(deck, part, core):
    _, (item,) = deck(plain())
    bpy.context.view_layer.objects.active = item
    item.select_set(True)
    assert bpy.ops.femors.quality(mesh=item.name) == {"FINISHED"}
    found = json.loads(item.femors.quality)
    assert found["elements"]["inverted"] == 0
    assert found["elements"]["volume"] == pytest.approx(found["mesh"]["volume"], rel=1e-6)
    item.data.vertices[40].co.x += 25.0  # past its neighbours
    item.data.update()
    assert bpy.ops.femors.quality(mesh=item.name) == {"FINISHED"}
    found = json.loads(item.femors.quality)
    assert found["elements"]["inverted"] > 0
    assert bpy.ops.femors.show_heat(quantity="scaled_jacobian") == {"FINISHED"}
    values = part("operators.heat_values").values_of(item, "scaled_jacobian")
    assert values.shape == (len(item.data.vertices),)
    assert values[40] == values.min() == pytest.approx(found["elements"]["minimum"])
    assert values.max() == pytest.approx(1.0)
