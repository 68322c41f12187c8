# SPDX-License-Identifier: GPL-3.0-or-later
"""FE decks in Blender: in, morphed, saved, opened again, and out."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest
from deck_cases import (
    assembly,
    export,
    febio,
    grid,
    halves,
    ids,
    local,
    plain,
    refused,
    target_of,
)
from mathutils import Matrix


# --- in -------------------------------------------------------------------------------------------------
def test_a_part_becomes_an_object(deck):
    _, (item,) = deck(plain())
    nodes, hexes = grid()
    assert item.name == "BLOCK" and [c.name for c in item.users_collection] == ["model"]
    assert bpy.context.object == item and item.select_get()
    np.testing.assert_array_equal(local(item), nodes.astype(np.float32))
    np.testing.assert_array_equal(ids(item), 1001 + np.arange(len(nodes)))
    assert {len(p.vertices) for p in item.data.polygons} == {4}
    assert len(item.data.polygons) == 2 * (6 * 5 + 6 * 3 + 5 * 3)
    on_faces = {v for p in item.data.polygons for v in p.vertices}
    assert 0 < len(on_faces) < len(nodes), "interior nodes are loose vertices"
    centre = nodes.mean(axis=0)
    for polygon in item.data.polygons:
        assert np.array(polygon.normal) @ (np.array(polygon.center) - centre) > 0, "faces point outward"
    groups = {
        g.name: {v.index for v in item.data.vertices if g.index in [m.group for m in v.groups]}
        for g in item.vertex_groups
    }
    assert groups["TIP"] == {0} and groups["END"] == set(range(24)) and len(groups["EVERY"]) == len(nodes)
    assert groups["HALF"] == set(np.unique(hexes[:45]).tolist())
    assert "BLOCK" not in groups


def test_endings_are_those_of_the_core(part, core):
    assert set(part("operators.decks").ENDINGS) == set(core("deckfiles").READERS)


def test_an_assembly_places_its_parts(deck):
    _, items = deck(assembly())
    assert sorted(item.name for item in items) == ["Brick-1", "Brick-2"]
    one, two = sorted(items, key=lambda item: item.name)
    assert one.data == two.data and one.data.name == "Brick"
    np.testing.assert_allclose(np.array(one.matrix_world), np.eye(4))
    turned = Matrix.Translation((100, 0, 0)) @ Matrix.Rotation(np.pi / 2, 4, "Z")
    np.testing.assert_allclose(np.array(two.matrix_world), np.array(turned), atol=1e-5)


def test_several_files_at_once(tmp_path, empty):
    for name in ("one.inp", "two.inp"):
        (tmp_path / name).write_text(plain())
    assert bpy.ops.femors.import_deck(
        directory=str(tmp_path), files=[{"name": "one.inp"}, {"name": "two.inp"}]
    ) == {"FINISHED"}
    assert {c.name for c in bpy.context.scene.collection.children} == {"one", "two"}


@pytest.mark.parametrize("text", [plain, halves, assembly, febio])
def test_untouched_it_comes_out_byte_for_byte(deck, tmp_path, text):
    path, items = deck(text(), "model.feb" if text is febio else "model.inp")
    assert export(tmp_path / f"out{path.suffix}", object=items[0].name) == path.read_bytes()


def test_vtu_in_and_out(deck, tmp_path):
    pytest.importorskip("meshio")
    _, (item,) = deck(plain())
    export(tmp_path / "as.vtu", object=item.name)  # another format: made afresh
    assert bpy.ops.femors.import_deck(filepath=str(tmp_path / "as.vtu")) == {"FINISHED"}
    again = bpy.context.object
    assert again != item
    np.testing.assert_array_equal(local(again), local(item))
    assert export(tmp_path / "out.vtu", object=again.name) == (tmp_path / "as.vtu").read_bytes()


# --- nodes that move ----------------------------------------------------------------------------------
def test_what_moves_is_the_node_plus_its_displacement(deck, tmp_path, core):
    path, (item,) = deck(plain())
    before = core("deckfiles").read_deck(path).coordinates
    item.data.vertices[7].co.x += 0.5
    lines = export(tmp_path / "out.inp", object=item.name).decode().splitlines()
    original = path.read_text().splitlines()
    changed = [i for i, pair in enumerate(zip(lines, original, strict=True)) if len(set(pair)) > 1]
    assert [original[i].split(",")[0] for i in changed] == ["1008"]
    assert lines[changed[0]].split(",")[2:] == original[changed[0]].split(",")[2:]
    after = core("deckfiles").read_deck(tmp_path / "out.inp").coordinates
    assert after[7, 0] - before[7, 0] == pytest.approx(0.5, abs=4e-6)


def test_the_order_of_vertices_does_not_matter(deck, tmp_path, tools):
    path, (item,) = deck(plain())
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.sort_elements(type="REVERSE", elements={"VERT"})
    refused("Edit Mode", bpy.ops.femors.export_deck, tools, filepath=str(tmp_path / "x.inp"), object="BLOCK")
    bpy.ops.object.mode_set(mode="OBJECT")
    assert ids(item)[0] != 1001
    assert export(tmp_path / "out.inp", object=item.name) == path.read_bytes()


def test_parts_together_and_shared_nodes(deck, tmp_path, core, tools):
    path, items = deck(halves())
    left, right = sorted(items, key=lambda item: item.name)
    for item in items:
        for vertex in item.data.vertices:
            vertex.co.z += 1.0
    export(tmp_path / "out.inp", object=left.name)  # the other part comes along as the scene has it
    read = core("deckfiles").read_deck
    moved = read(tmp_path / "out.inp").coordinates - read(path).coordinates
    np.testing.assert_allclose(moved, np.tile([0, 0, 1.0], (len(moved), 1)), atol=4e-6)
    for vertex in right.data.vertices:
        vertex.co.z += 1.0
    refused(
        "share .* nodes", bpy.ops.femors.export_deck, tools, filepath=str(tmp_path / "x.inp"), object="LEFT"
    )
    assert not (tmp_path / "x.inp").exists()


def test_an_object_that_was_moved_is_told(deck, tmp_path, part):
    path, (item,) = deck(plain())
    item.location.x = 3
    bpy.context.view_layer.update()
    level, line = part("operators.deck_export").write(bpy.context, [item], str(tmp_path / "out.inp"))
    assert level == "WARNING" and "Ctrl+A" in line
    assert (tmp_path / "out.inp").read_bytes() == path.read_bytes()


# --- the life of a .blend -----------------------------------------------------------------------------
def test_appended_and_copied(deck, tmp_path, tools, core):
    path, (item,) = deck(plain())
    target_of(tools, core, path)
    bpy.ops.femors.morph(source=item.name, target="Target")
    name = bpy.context.object.name
    expected = export(tmp_path / "first.inp")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "a.blend")) as (_, wanted):
        wanted.objects = [name]
    appended = bpy.data.objects[name]
    bpy.context.scene.collection.objects.link(appended)
    assert export(tmp_path / "appended.inp", object=name) == expected
    bpy.context.view_layer.objects.active = appended
    appended.select_set(True)
    bpy.ops.object.duplicate()
    copied = bpy.context.object
    assert copied != appended
    copied.data.vertices[0].co.z -= 1
    assert export(tmp_path / "copied.inp") != expected
    assert export(tmp_path / "appended.inp", object=name) == expected
    appended.select_set(True)
    refused("both part 'BLOCK'", bpy.ops.femors.export_deck, tools, filepath=str(tmp_path / "x.inp"))


def test_the_deck_goes_with_its_last_mesh(deck, tmp_path):
    _, (item,) = deck(plain())
    assert [t.name for t in bpy.data.texts] == ["model.inp"]
    mesh = item.data
    bpy.data.objects.remove(item)
    bpy.data.meshes.remove(mesh)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert not len(bpy.data.texts)


def test_undo_takes_the_import_back(tmp_path, empty):
    (tmp_path / "model.inp").write_text(plain())
    bpy.ops.ed.undo_push(message="start")
    bpy.ops.femors.import_deck(filepath=str(tmp_path / "model.inp"))
    bpy.ops.ed.undo_push(message="imported")
    bpy.data.objects["BLOCK"].data.vertices[0].co.x += 1
    bpy.ops.ed.undo_push(message="moved")
    bpy.ops.ed.undo()
    assert export(tmp_path / "out.inp", object="BLOCK") == (tmp_path / "model.inp").read_bytes()
    bpy.ops.ed.undo()
    assert not len(bpy.data.objects) and not len(bpy.data.meshes)
    bpy.ops.ed.redo()
    assert export(tmp_path / "out.inp", object="BLOCK") == (tmp_path / "model.inp").read_bytes()


def test_includes_are_kept_too(tmp_path, empty, tools):
    folder = tmp_path / "model"
    (folder / "mesh").mkdir(parents=True)
    head, _, rest = plain().partition("*ELEMENT")
    (folder / "mesh" / "nodes.inc").write_text(head)
    (folder / "main.inp").write_text("*INCLUDE, INPUT=mesh/nodes.inc\n*ELEMENT" + rest)
    before = {p.name: p.read_bytes() for p in (folder / "main.inp", folder / "mesh" / "nodes.inc")}
    bpy.ops.femors.import_deck(filepath=str(folder / "main.inp"))
    item = bpy.context.object
    item.data.vertices[0].co.x += 1
    refused(
        "would change the include",
        bpy.ops.femors.export_deck,
        tools,
        filepath=str(folder / "new.inp"),
        object=item.name,
    )
    folder.rename(tmp_path / "elsewhere")
    out = tmp_path / "out"
    (out / "mesh").mkdir(parents=True)
    assert export(out / "main.inp", object=item.name) == before["main.inp"]
    item.data.vertices[0].co.x = np.float32(1 / 3)
    export(out / "main.inp", object=item.name)
    assert (out / "mesh" / "nodes.inc").read_bytes() == before["nodes.inc"]


# --- what cannot be done ----------------------------------------------------------------------------------
def test_files_that_are_refused(tmp_path, empty, tools):
    call = bpy.ops.femors.import_deck
    refused("No file named", call, tools)
    refused("cannot be read", call, tools, filepath=str(tmp_path / "none.inp"))
    (tmp_path / "empty.inp").write_text("")
    refused("is empty", call, tools, filepath=str(tmp_path / "empty.inp"))
    (tmp_path / "a.txt").write_text("hello")
    refused("not a known kind", call, tools, filepath=str(tmp_path / "a.txt"))
    (tmp_path / "bad.inp").write_text("*NODE\n1, 0, 0, 0\n2, 1, zero, 0\n")
    assert "line 3" in refused("not a number", call, tools, filepath=str(tmp_path / "bad.inp"))
    (tmp_path / "good.inp").write_text(plain())
    refused(
        "is empty", call, tools, directory=str(tmp_path), files=[{"name": "good.inp"}, {"name": "empty.inp"}]
    )


def test_exports_that_are_refused(deck, tmp_path, tools):
    call = bpy.ops.femors.export_deck
    out = str(tmp_path / "out.inp")
    refused("Nothing to export", call, tools, filepath=out)
    _, (item,) = deck(plain())
    refused("No file named", call, tools)
    refused("no object named", call, tools, filepath=out, object="Tibia")
    refused("there is no folder", call, tools, filepath=str(tmp_path / "no" / "out.inp"))
    refused("not a known kind", call, tools, filepath=str(tmp_path / "out.xyz"))
    other = tools.add_object("Plain", *tools.sphere())
    refused("not a part of an FE model", call, tools, filepath=out, object=other.name)
    deck(plain(), "second.inp")
    item.select_set(True)
    refused("different decks", call, tools, filepath=out)
    assert not Path(out).exists()


def test_meshes_that_lost_their_nodes(deck, tmp_path, tools):
    _, (item,) = deck(plain())
    out = str(tmp_path / "out.inp")
    whole = item.data.copy()

    def edited(change):
        item.data = whole.copy()
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.select_all(action="DESELECT")
        bpy.ops.object.mode_set(mode="OBJECT")
        item.data.vertices[3].select = True
        bpy.ops.object.mode_set(mode="EDIT")
        change()
        bpy.ops.object.mode_set(mode="OBJECT")

    edited(lambda: bpy.ops.mesh.delete(type="VERT"))
    refused("lacks 1 of the 168 nodes", bpy.ops.femors.export_deck, tools, filepath=out, object="BLOCK")
    tools.add_object("Target", *tools.sphere())
    refused("lacks 1 of the 168 nodes", bpy.ops.femors.morph, tools, source="BLOCK", target="Target")
    edited(bpy.ops.mesh.duplicate)
    refused("1 vertex that is no node", bpy.ops.femors.export_deck, tools, filepath=out, object="BLOCK")
    item.data = whole.copy()
    item.data.attributes.remove(item.data.attributes["node_id"])
    refused("lost its attribute", bpy.ops.femors.export_deck, tools, filepath=out, object="BLOCK")
    item.data = whole
    bpy.data.texts.remove(bpy.data.texts["model.inp"])
    refused("import it again", bpy.ops.femors.export_deck, tools, filepath=out, object="BLOCK")
    refused("import it again", bpy.ops.femors.morph, tools, source="BLOCK", target="Target")


def test_modifiers_do_not_make_a_deck(deck, tools, core):
    path, _ = deck(plain())
    target_of(tools, core, path)
    refused(
        "untick Use Modifiers",
        bpy.ops.femors.morph,
        tools,
        source="BLOCK",
        target="Target",
        use_evaluated=True,
    )


# --- window -----------------------------------------------------------------------------------------------
def test_menus_and_drag_and_drop_come_and_go(extension):
    def seen():
        drawn = [
            f.__module__
            for menu in (bpy.types.TOPBAR_MT_file_import, bpy.types.TOPBAR_MT_file_export)
            for f in menu._dyn_ui_initialize()
            if "femors" in f.__module__
        ]
        handlers = [cls.__name__ for cls in bpy.types.FileHandler.__subclasses__() if cls.is_registered]
        handlers = [name for name in handlers if name.startswith("FEMORS")]
        return len(drawn), handlers, hasattr(bpy.types.Mesh, "femors")

    assert seen() == (2, ["FEMORS_FH_deck"], True)
    assert bpy.types.FEMORS_FH_deck.bl_import_operator == "femors.import_deck"
    extension.unregister()
    assert seen() == (0, [], False)
    extension.register()
    assert seen() == (2, ["FEMORS_FH_deck"], True)
