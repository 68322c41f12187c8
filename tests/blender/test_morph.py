# SPDX-License-Identifier: GPL-3.0-or-later
"""`bpy.ops.femors.morph` from a script: results, transforms, settings, and what is told."""

from __future__ import annotations

import dataclasses
import json

import bpy
import numpy as np
import pytest
from mathutils import Matrix
from morph_cases import RESULTS, key_positions, morph, off_target, values


def test_a_new_object_by_default(pair, tools):
    source, target = pair
    before = tools.world(source).copy(), tools.world(target).copy()
    item = morph()
    assert item.name == "Femur morphed to Scan"
    assert item not in (source, target) and item.data is not source.data
    assert list(item.users_collection) == list(source.users_collection)
    assert list(bpy.context.selected_objects) == [item]
    np.testing.assert_array_equal(tools.world(source), before[0])
    np.testing.assert_array_equal(tools.world(target), before[1])
    assert [len(p.vertices) for p in item.data.polygons] == [len(p.vertices) for p in source.data.polygons]
    assert [tuple(p.vertices) for p in item.data.polygons] == [
        tuple(p.vertices) for p in source.data.polygons
    ]
    off = off_target(tools.world(item), target)
    assert np.median(off) < 0.01 and off.max() < 0.1
    np.testing.assert_allclose(values(item.data, "femors_surface_distance"), off, atol=2e-3)
    assert values(item.data, "femors_displacement").max() > 0


def test_the_figures_stay_with_the_result(pair):
    item = morph()
    report = json.loads(item.femors.report)
    assert (report["source"], report["target"]) == ("Femur", "Scan")
    assert report["after"]["surface_to_target"]["median"] < report["before"]["surface_to_target"]["median"]
    assert isinstance(report["stop_reason"], str) and isinstance(report["warnings"], list)
    assert not bpy.data.objects["Femur"].femors.report


@pytest.mark.parametrize("result", RESULTS)
def test_each_kind_of_result_has_the_same_shape(pair, tools, result):
    source, _ = pair
    expected = tools.world(morph())
    bpy.context.view_layer.objects.active = None
    item = morph(result=result)
    if result == "NEW":
        found = tools.world(item)
    elif result == "IN_PLACE":
        found = tools.world(source)
    else:
        key = source.data.shape_keys.key_blocks["Morphed to Scan"]
        assert key.value == 1.0 and key.relative_key.name == "Basis"
        found = key_positions(key)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    holder = item if result == "NEW" else source
    assert holder.femors.report
    assert "femors_surface_distance" in holder.data.attributes


def test_the_slider_blends_from_source_to_morphed(pair, tools):
    source, _ = pair
    start = tools.world(source)
    morph(result="SHAPE_KEY")
    key = source.data.shape_keys.key_blocks["Morphed to Scan"]
    end = key_positions(key)
    for value in (0.0, 0.5, 1.0):
        key.value = value
        seen = source.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        positions = np.array([v.co for v in seen.vertices])
        np.testing.assert_allclose(positions, start + value * (end - start), atol=1e-5)


def test_a_second_shape_key_starts_again_from_the_basis(pair):
    source, _ = pair
    morph(result="SHAPE_KEY")
    morph(result="SHAPE_KEY")
    keys = source.data.shape_keys.key_blocks
    assert [round(k.value, 3) for k in keys[1:]] == [0.0, 1.0]
    np.testing.assert_allclose(key_positions(keys[1]), key_positions(keys[2]), atol=1e-6)


MATRICES = {
    "scaled": Matrix.Diagonal((2.0, 0.5, 1.5, 1.0)),
    "turned": Matrix.Translation((3, -1, 2)) @ Matrix.Rotation(0.7, 4, (1, 2, 3)),
    "mirrored": Matrix.Diagonal((-1.0, 1.0, 1.0, 1.0)),
    "sheared": Matrix(((1, 0.3, 0, 1), (0, 1, 0.2, 0), (0, 0, 1, 0), (0, 0, 0, 1))),
}


def put(item, matrix: Matrix) -> None:
    """Change the object's transform by its parent, leaving its shape in the world as it is."""
    parent = bpy.data.objects.new("Parent", None)
    bpy.context.scene.collection.objects.link(parent)
    item.data.transform(matrix.inverted())
    item.parent = parent
    item.matrix_parent_inverse = matrix
    bpy.context.view_layer.update()


@pytest.mark.parametrize("result", RESULTS)
@pytest.mark.parametrize("transform", MATRICES)
def test_transforms_do_not_change_the_result(pair, tools, transform, result):
    source, _ = pair
    expected = tools.world(morph(alignment="none"))  # an ellipsoid could be turned over
    put(source, MATRICES[transform])
    item = morph(result=result, alignment="none")
    bpy.context.view_layer.update()
    if result == "SHAPE_KEY":
        matrix = np.array(source.matrix_world)
        local = key_positions(source.data.shape_keys.key_blocks[-1])
        found = local @ matrix[:3, :3].T + matrix[:3, 3]
    else:
        found = tools.world(item if result == "NEW" else source)
    # single-precision coordinates in another frame: not the same to the last bit, which reduction feels
    off = np.linalg.norm(found - expected, axis=1)
    assert np.median(off) < 1e-3 and off.max() < 0.05
    if result == "NEW":
        assert item.parent is source.parent


def test_a_mirrored_object_is_not_taken_for_one_turned_inside_out(pair):
    """Blender shows the outside of a mirrored object; so does what is said of it."""
    pair[0].scale = (-1.0, 2.0, 0.5)
    report = json.loads(morph().femors.report)
    assert report["warnings"] == []
    assert bpy.ops.femors.quality(mesh="Femur", other="") == {"FINISHED"}
    assert json.loads(pair[0].femors.quality)["notes"] == []


def test_a_moved_target_counts_where_it_is(pair, tools):
    _, target = pair
    target.location = (10, 0, 0)
    target.scale = (1.5, 1.5, 1.5)
    item = morph()  # the operator itself brings matrix_world up to date
    assert np.median(off_target(tools.world(item), target)) < 0.01


def test_objects_that_blender_does_not_evaluate_count_where_they_are(pair, tools):
    _, target = pair
    for item in pair:
        item.hide_viewport = True
    target.location = (10, 0, 0)
    item = morph()
    assert not item.hide_viewport
    assert tools.world(item)[:, 0].mean() == pytest.approx(10, abs=0.5)


def test_weights_say_where_the_source_may_move(pair, tools):
    source, _ = pair
    start = tools.world(source)
    lower = start[:, 2] < 0
    source.vertex_groups.new(name="Upper").add([int(i) for i in np.flatnonzero(~lower)], 1.0, "REPLACE")
    item = morph(vertex_group="Upper", alignment="none")
    moved = np.linalg.norm(tools.world(item) - start, axis=1)
    assert moved[lower].max() < 1e-6
    assert moved[~lower].max() > 0.05


def test_landmarks_align(pair, tools):
    source, target = pair
    turn = Matrix.Rotation(np.pi / 2, 4, "X") @ Matrix.Rotation(np.pi, 4, "Z")
    near = {}
    for name, axis in {"top": (0, 0, 1), "front": (1, 0, 0), "side": (0, 1, 0), "back": (-1, 0, 0)}.items():
        for item in pair:
            index = int(np.argmax(tools.world(item) @ axis))
            item.vertex_groups.new(name=name).add([index], 1.0, "REPLACE")
            near[item.name, name] = index
    source.vertex_groups.new(name="many").add([0, 1, 2], 1.0, "REPLACE")
    source.data.transform(turn)
    item = morph(use_landmarks=True)
    found, wanted = tools.world(item), tools.world(target)
    for name in ("top", "front", "side", "back"):
        gap = np.linalg.norm(found[near["Femur", name]] - wanted[near["Scan", name]])
        assert gap < 0.4, name


def test_polygons_with_many_sides(empty, tools):
    vertices, faces = tools.sphere(10, 12, (1, 1, 1.5))
    caps = [f for f in faces if len(f) == 4] + [list(range(11, -1, -1)), list(range(96, 108))]
    source = tools.add_object("Femur", vertices[:-2], [f[::-1] for f in caps])
    tools.add_object("Scan", *tools.sphere(12, 14, (1.2, 1, 1.5)))
    item = morph()
    assert sorted({len(p.vertices) for p in item.data.polygons}) == [4, 12]
    assert len(item.data.vertices) == len(source.data.vertices)


def test_a_mirrored_source_is_mirrored_where_the_user_ticks_it(empty, tools):
    vertices, faces = tools.sphere(16, 20, (1.0, 0.7, 2.0))
    vertices[:, 0] += 0.35 * vertices[:, 2] ** 2 / 4
    vertices[:, 1] += 0.5 * np.maximum(vertices[:, 2], 0) * np.maximum(vertices[:, 0], 0)
    tools.add_object("Scan", vertices, faces)
    tools.add_object("Femur", vertices * (1, -1, 1), [f[::-1] for f in faces])
    item = morph(fix_mirror=True)
    mesh = item.data
    mesh.calc_loop_triangles()
    volume = sum(
        np.dot(
            mesh.vertices[t.vertices[0]].co,
            np.cross(mesh.vertices[t.vertices[1]].co, mesh.vertices[t.vertices[2]].co),
        )
        for t in mesh.loop_triangles
    )
    assert volume > 0, "the faces point inward"
    assert off_target(tools.world(item), bpy.data.objects["Scan"]).max() < 0.2


def test_a_mirrored_shape_key_is_refused(pair, tools, part, monkeypatch):
    source, _ = pair
    core = part("femors_addon.morph")
    real = core.morph

    def mirrored(*args, **options):
        return dataclasses.replace(real(*args, **options), transform=np.diag([-1.0, 1.0, 1.0, 1.0]))

    monkeypatch.setattr(core, "morph", mirrored)
    before = tools.census()
    with pytest.raises(RuntimeError, match="choose New Object or In Place"):
        morph(result="SHAPE_KEY")
    assert tools.census() == before
    assert source.data.shape_keys is None and not source.femors.report
    assert not [a for a in source.data.attributes if a.name.startswith("femors")]


def test_the_line_tells_the_distance_from_the_target(pair, part, monkeypatch):
    told = []
    operator = part("operators.job").JobOperator
    monkeypatch.setattr(operator, "tell", lambda self, level, line: told.append(line))
    after = json.loads(morph().femors.report)["after"]["target_to_surface"]
    start = f": distance from 'Scan': median {after['median']:.3g}, 99 % {after['p99']:.3g}, "
    assert f"{start}max {after['maximum']:.3g}; " in told[-1]
    morph(partial="source")  # its nodes lie on the target: the target's nodes around them are told
    start = ": distance from 'Scan' around it: median "
    assert start in told[-1]
    median = float(told[-1].split(start)[1].split(",")[0])
    assert median > 1e-3
    assert f"half of the result's nodes are within {median:.3g} of the target's nodes around them" in told[-1]


def test_invoked_without_a_window_it_runs_at_once(pair):
    if not bpy.app.background:
        pytest.skip("tests/window does this in a window")
    assert bpy.ops.femors.morph("INVOKE_DEFAULT", source="Femur", target="Scan") == {"FINISHED"}


def test_settings_reach_the_core(pair, part, monkeypatch):
    core = part("femors_addon.morph")
    seen = {}
    real = core.morph

    def spy(source, target, settings, progress, **options):
        seen.update(settings=settings, options=options)
        return real(source, target, settings, progress, **options)

    monkeypatch.setattr(core, "morph", spy)
    morph(preset="gross", iterations=3, tolerance=0.002)
    assert seen["settings"].preset == "gross"
    assert seen["settings"].iterations == 3
    assert seen["settings"].tolerance == 0.002
    assert (
        seen["settings"].dense_iterations
        == part("femors_addon.morph_settings").PRESETS["gross"].dense_iterations
    )


def test_new_folds_are_told_once_not_once_more_by_kind(empty, tools, capfd):
    """Two balls through each other, laid onto a plate."""
    ball, faces = tools.sphere(14, 20, (10.0, 10.0, 10.0))
    two = np.concatenate((ball, ball + (7.0, 0.0, 0.0)))
    tools.add_object("Femur", two, [*faces, *([c + len(ball) for c in face] for face in faces)])
    tools.add_object("Scan", *tools.sphere(20, 24, (12.0, 12.0, 0.6)))
    bpy.context.view_layer.update()
    item = morph(alignment="none")
    after = json.loads(item.femors.report)["after"]
    said = capfd.readouterr().out
    assert after["self_intersecting"] and said.count("did not in the source") == 1
    assert "self-intersecting face" not in said
