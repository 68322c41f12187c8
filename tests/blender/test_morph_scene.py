# SPDX-License-Identifier: GPL-3.0-or-later
"""`bpy.ops.femors.morph` in a scene with more in it: modifiers, keys, animation, links, other scenes."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from morph_cases import morph, off_target


def test_modifiers_are_kept_or_used(pair, tools):
    source, target = pair
    source.modifiers.new("Subdivision", "SUBSURF").levels = 1
    plain = morph()
    assert [m.type for m in plain.modifiers] == ["SUBSURF"]
    assert len(plain.data.vertices) == len(source.data.vertices)
    used = morph(use_evaluated=True)
    assert not used.modifiers
    assert len(used.data.vertices) > 3 * len(source.data.vertices)
    assert np.median(off_target(tools.world(used), target)) < 0.01


def test_modifiers_of_the_target_count_for_every_result(pair, tools):
    source, target = pair
    target.modifiers.new("Cast", "CAST").factor = 0.5
    bpy.context.view_layer.update()
    morph(result="IN_PLACE", use_evaluated=True)
    seen = target.evaluated_get(bpy.context.evaluated_depsgraph_get())
    assert np.median(off_target(tools.world(source), seen)) < 0.01


def test_shape_keys_of_the_source_do_not_come_along(pair, tools):
    source, _ = pair
    expected = tools.world(morph())
    source.shape_key_add(name="Basis")
    other = source.shape_key_add(name="Other")
    for point in other.data:
        point.co.x += 5
    other.value = 1.0
    item = morph()
    assert item.data.shape_keys is None
    assert len(source.data.shape_keys.key_blocks) == 2
    np.testing.assert_allclose(tools.world(item), expected, atol=1e-6)
    seen = morph(use_evaluated=True, alignment="none")
    assert seen.data.shape_keys is None


def test_what_is_on_the_source_survives(pair):
    source, _ = pair
    mesh = source.data
    mesh.materials.append(bpy.data.materials.new("Bone"))
    mesh.materials.append(bpy.data.materials.new("Cartilage"))
    for polygon in mesh.polygons:
        polygon.material_index = polygon.index % 2
    layer = mesh.uv_layers.new(name="UVMap")
    layer.data.foreach_set("uv", np.linspace(0, 1, 2 * len(mesh.loops), dtype=np.float32))
    mesh.attributes.new("node_id", "INT", "POINT").data.foreach_set(
        "value", np.arange(len(mesh.vertices)) * 7
    )
    source.vertex_groups.new(name="Head").add([1, 2, 3], 0.25, "REPLACE")
    source["tag"] = "left"
    for use_evaluated in (False, True):
        item = morph(use_evaluated=use_evaluated)
        new = item.data
        assert [m.name for m in new.materials] == ["Bone", "Cartilage"]
        assert [p.material_index for p in new.polygons] == [p.index % 2 for p in new.polygons]
        uv = np.empty(2 * len(new.loops), dtype=np.float32)
        new.uv_layers["UVMap"].data.foreach_get("uv", uv)
        np.testing.assert_allclose(uv, np.linspace(0, 1, len(uv)), atol=1e-6)
        assert [a.value for a in new.attributes["node_id"].data] == [7 * i for i in range(len(new.vertices))]
        assert item.vertex_groups["Head"].weight(2) == pytest.approx(0.25)
        assert item["tag"] == "left"


@pytest.mark.parametrize("result", ["SHAPE_KEY", "IN_PLACE"])
def test_a_shared_mesh_is_not_changed_for_the_others(pair, tools, result):
    source, _ = pair
    other = bpy.data.objects.new("Other", source.data)
    bpy.context.scene.collection.objects.link(other)
    before = tools.world(other)
    morph(result=result)
    assert other.data is not source.data
    assert other.data.shape_keys is None
    np.testing.assert_array_equal(tools.world(other), before)
    assert not [a for a in other.data.attributes if a.name.startswith("femors")]


@pytest.mark.parametrize("broken", ["point_attribute", "_show", "_own_animation"])
def test_a_failure_while_writing_leaves_no_object_behind(pair, tools, part, monkeypatch, broken):
    def fails(*args):
        raise KeyError(broken)

    monkeypatch.setattr(part("operators.result"), broken, fails)
    before = tools.census()
    with pytest.raises(RuntimeError, match="failed unexpectedly"):
        morph()
    assert tools.census() == before


def test_the_target_is_hidden_where_the_user_ticks_it(pair):
    _, target = pair
    morph()
    assert not target.hide_get()
    assert bpy.context.scene.femors.hide_target
    morph(hide_target=True)
    assert target.hide_get() and not target.hide_viewport
    morph(hide_target=True)  # a hidden target is a target still


def test_a_target_outside_the_view_layer_need_not_be_hidden(pair):
    _, target = pair
    bpy.context.scene.collection.objects.unlink(target)
    bpy.data.scenes.new("Other").collection.objects.link(target)
    morph(hide_target=True)


def test_the_result_has_its_own_animation(pair):
    source, _ = pair
    source.keyframe_insert("location", frame=1)
    source.data["part"] = 1.0
    source.data.keyframe_insert('["part"]', frame=1)
    strip = source.animation_data.nla_tracks.new().strips.new("old", 1, bpy.data.actions.new("Old"))
    item = morph()
    for ours, theirs in ((item, source), (item.data, source.data)):
        mine, yours = ours.animation_data, theirs.animation_data
        assert mine.action is not None and mine.action != yours.action
        if hasattr(mine, "action_slot"):
            assert mine.action_slot is not None
            assert mine.action_slot.identifier == yours.action_slot.identifier
    assert item.animation_data.nla_tracks[0].strips[0].action != strip.action
    item.location.x = 5.0
    item.keyframe_insert("location", frame=1)
    bpy.context.scene.frame_set(1)
    assert (source.location.x, item.location.x) == (0.0, 5.0)


def test_a_linked_source_becomes_a_local_result(pair, tools, tmp_path):
    path = tmp_path / "library.blend"
    bpy.data.libraries.write(str(path), {bpy.data.objects["Femur"]})
    bpy.data.objects.remove(bpy.data.objects["Femur"])
    with bpy.data.libraries.load(str(path), link=True) as (_, into):
        into.objects = ["Femur"]
    bpy.context.scene.collection.objects.link(into.objects[0])
    item = morph()
    assert item.library is None and item.data.library is None
    for result in ("SHAPE_KEY", "IN_PLACE"):
        with pytest.raises(RuntimeError, match="linked from another file"):
            morph(result=result)


def test_several_scenes(pair, tools):
    other = bpy.data.scenes.new("Other")
    _, target = pair
    bpy.context.scene.collection.objects.unlink(target)
    other.collection.objects.link(target)
    item = morph()
    other.collection.objects.unlink(target)
    bpy.context.scene.collection.objects.link(target)
    bpy.context.view_layer.update()
    assert np.median(off_target(tools.world(item), target)) < 0.01


@pytest.mark.parametrize("where", ["another scene", "left out", "another file"])
def test_a_result_is_seen_wherever_its_source_is(pair, tools, tmp_path, where):
    """In the collections of the source, and in the scene where those do not show it."""
    source, _ = pair
    group = bpy.data.collections.new("Bones")
    top = bpy.context.scene.collection
    top.objects.unlink(source)
    if where == "another file":
        path = str(tmp_path / "library.blend")
        group.objects.link(source)
        bpy.data.libraries.write(path, {group})
        bpy.data.objects.remove(source)
        bpy.data.collections.remove(group)
        with bpy.data.libraries.load(path, link=True) as (_, there):
            there.collections = ["Bones"]
        group = bpy.data.collections["Bones"]
        assert group.library is not None
        top.children.link(group)
    else:
        group.objects.link(source)
        parent = top if where == "left out" else bpy.data.scenes.new("Another").collection
        parent.children.link(group)
        if where == "left out":
            bpy.context.view_layer.layer_collection.children["Bones"].exclude = True
    item = morph()
    assert item is not None and item.name == "Femur morphed to Scan" and item.visible_get()
    assert list(item.users_collection) == ([top] if where == "another file" else [group, top])


def test_a_linked_object_of_the_results_name_does_not_hide_it(pair, tools, tmp_path):
    """The source stands in no collection of this file, and what is looked for is the object, not a name."""
    source, _ = pair
    path, group = str(tmp_path / "library.blend"), bpy.data.collections.new("Bones")
    namesake = source.copy()
    namesake.name = "Femur morphed to Scan"
    bpy.context.scene.collection.objects.unlink(source)
    for one in (source, namesake):
        group.objects.link(one)
    bpy.data.libraries.write(path, {group})
    for one in (source, namesake):
        bpy.data.objects.remove(one)
    bpy.data.collections.remove(group)
    with bpy.data.libraries.load(path, link=True) as (_, there):
        there.collections = ["Bones"]
    bpy.context.scene.collection.children.link(bpy.data.collections["Bones"])
    morph()
    item = bpy.data.objects["Femur morphed to Scan", None]
    assert list(item.users_collection) == [bpy.context.scene.collection]
    assert item.visible_get() and item.select_get()
