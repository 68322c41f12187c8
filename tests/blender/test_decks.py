# SPDX-License-Identifier: GPL-3.0-or-later
"""FE decks in Blender: in, morphed, saved, opened again, and out."""

from __future__ import annotations

import json
import os
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

DATA = Path(os.environ.get("FEMORS_DATA") or Path(__file__).resolve().parents[3] / "shared" / "data")
KNEE = DATA / "knee"


# --- small decks --------------------------------------------------------------------------------------
def grid(counts=(6, 5, 3), size=(30.0, 20.0, 9.0)):
    """Return nodes (n, 3), with more digits than single precision has, and hexes (e, 8)."""
    x, y, z = (np.linspace(0, length, k + 1) for length, k in zip(size, counts, strict=True))
    nodes = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3) + 1 / 3
    strides = np.array([(counts[1] + 1) * (counts[2] + 1), counts[2] + 1, 1])
    at = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
    offsets = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    return nodes, np.stack([(at + offset) @ strides for offset in offsets], axis=1)


def node_lines(nodes, first=1) -> str:
    return "".join(f"{first + i}, {x!r}, {y!r}, {z!r}\n" for i, (x, y, z) in enumerate(nodes.tolist()))


def element_lines(elements, first=1, offset=1) -> str:
    rows = (elements + offset).tolist()
    return "".join(f"{first + i}, {', '.join(map(str, row))}\n" for i, row in enumerate(rows))


def plain() -> str:
    """Return a deck of one block, ids from 1001, with sets of nodes and elements."""
    nodes, hexes = grid()
    return (
        "** a block\n*NODE, NSET=EVERY\n"
        + node_lines(nodes, 1001)
        + "*ELEMENT, TYPE=C3D8R, ELSET=BLOCK\n"
        + element_lines(hexes, 1, 1001)
        + "*NSET, NSET=TIP\n1001\n*NSET, NSET=END, GENERATE\n1001, 1024, 1\n"
        + "*ELSET, ELSET=HALF, GENERATE\n1, 45, 1\n"
        + "*MATERIAL, NAME=TISSUE\n*ELASTIC\n 12.0, 0.45\n"
    )


def halves() -> str:
    """Return a deck of two element sets that share the nodes between them."""
    nodes, hexes = grid()
    return (
        "*NODE\n"
        + node_lines(nodes)
        + "*ELEMENT, TYPE=C3D8, ELSET=LEFT\n"
        + element_lines(hexes[:45])
        + "*ELEMENT, TYPE=C3D8, ELSET=RIGHT\n"
        + element_lines(hexes[45:], 46)
    )


def assembly() -> str:
    """Return a deck with a part that stands in two places."""
    nodes, hexes = grid((3, 2, 2), (6, 4, 4))
    return (
        "*PART, NAME=Brick\n*NODE\n"
        + node_lines(nodes)
        + "*ELEMENT, TYPE=C3D8\n"
        + element_lines(hexes)
        + "*END PART\n*ASSEMBLY, NAME=All\n*INSTANCE, NAME=Brick-1, PART=Brick\n*END INSTANCE\n"
        + "*INSTANCE, NAME=Brick-2, PART=Brick\n 100., 0., 0.\n"
        + " 100., 0., 0., 100., 0., 1., 90.\n*END INSTANCE\n"
        + "*END ASSEMBLY\n"
    )


def febio() -> str:
    nodes, hexes = grid((3, 2, 2))
    rows = "".join(
        f'<node id="{i + 1}">{x!r},{y!r},{z!r}</node>\n' for i, (x, y, z) in enumerate(nodes.tolist())
    )
    elements = "".join(
        f'<elem id="{i + 1}">{",".join(map(str, row))}</elem>\n' for i, row in enumerate((hexes + 1).tolist())
    )
    return (
        '<?xml version="1.0"?>\n<febio_spec version="4.0">\n<Mesh>\n'
        f'<Nodes name="all">\n{rows}</Nodes>\n<Elements type="hex8" name="Soft">\n{elements}</Elements>\n'
        "</Mesh>\n</febio_spec>\n"
    )


SPANS = np.array([30.0, 20.0, 9.0])


def warp(points):
    """A smooth known warp of a few mm."""
    x, y, _ = (np.asarray(points) / SPANS).T
    return points + 2.0 * np.stack(
        [0.6 * np.sin(3 * y), 0.8 * np.sin(2.5 * x), np.sin(3 * x) + 0.3 * y], axis=-1
    )


@pytest.fixture()
def deck(tmp_path, empty):
    """A function that writes a deck, imports it, and returns its path and the objects."""

    def make(text: str, name: str = "model.inp"):
        path = tmp_path / name
        path.write_text(text)
        before = set(bpy.data.objects)
        assert bpy.ops.femors.import_deck(filepath=str(path)) == {"FINISHED"}
        return path, [item for item in bpy.data.objects if item not in before]

    return make


@pytest.fixture()
def core(part):
    """The core's modules by name."""
    return lambda name: part(f"femors_addon.{name}")


def export(path: Path, **options) -> bytes:
    assert bpy.ops.femors.export_deck(filepath=str(path), **options) == {"FINISHED"}
    return path.read_bytes()


def local(item) -> np.ndarray:
    out = np.empty(3 * len(item.data.vertices), np.float32)
    item.data.vertices.foreach_get("co", out)
    return out.reshape(-1, 3)


def ids(item) -> np.ndarray:
    out = np.empty(len(item.data.vertices), np.int32)
    item.data.attributes["node_id"].data.foreach_get("value", out)
    return out


def target_of(tools, core, path, name="Target", part=None):
    """Make the object of a part's warped outer surface; return it and the same as a core Surface."""
    read = core("deckfiles").read_deck(path)
    surface, _ = read.submesh(read.part(part))[0].surface()
    vertices = warp(surface.vertices).astype(np.float32).astype(float)
    return tools.add_object(name, vertices, surface.faces.tolist()), core("mesh").Surface(
        vertices, surface.faces
    )


def still(core):
    """Settings without an alignment, which could turn a block by half a turn."""
    return core("morph_settings").MorphSettings(alignment="none")


def refused(match: str, operator, tools, **options) -> str:
    before = tools.census()
    with pytest.raises(RuntimeError, match=match) as caught:
        operator(**options)
    line = str(caught.value).removeprefix("Error: ").strip()
    assert "\n" not in line and "Traceback" not in line and "unexpected" not in line, line
    assert tools.census() == before
    return line


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
