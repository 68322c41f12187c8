# SPDX-License-Identifier: GPL-3.0-or-later
"""What cannot be freed of overclosure in Blender: one line, or the best state, and the file as it was."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from body_cases import ball, base, findings, form, refused, remove

# --- bad input ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("check", [False, True])
def test_names_and_numbers_that_make_no_sense(balls, tools, check):
    operator = bpy.ops.femors.check_overclosure if check else bpy.ops.femors.remove_overclosure
    refused("no object named 'Hip'", tools, operator, bodies="Ball;Hip")
    refused("at least two", tools, operator, bodies="Ball")
    refused("at least two", tools, operator, bodies="")
    refused("'Ball' is named twice", tools, operator, bodies="Ball;Cup;Ball")
    refused("no collection named 'Leg'", tools, operator, bodies="", collection="Leg")
    refused("Rigid: there is no body 'Far'", tools, operator, rigid="Far")
    refused("Shares: 'Ball' is not a name", tools, operator, shares="Ball")
    refused("Shares: there is no body 'Hip'", tools, operator, shares="Hip=0.5")
    refused("its share is 1.5", tools, operator, shares="Ball=1.5")
    refused("Exclude: 'Ball' is not a pair", tools, operator, exclude="Ball")
    refused("Gaps: 'Ball,Far' is not a pair", tools, operator, gaps="Ball,Far=1")
    refused("Gaps: .* number", tools, operator, gaps="Ball,Cup=wide")
    refused("must be from 0 to", tools, operator, gaps="Ball,Cup=-1")
    refused("Minimum gap: -0.5 is outside", tools, operator, gap=-0.5)
    refused("Minimum gap: nan is outside", tools, operator, gap=float("nan"))


def test_meshes_that_are_no_bodies(balls, tools):
    tools.add_object("Empty", [], [])
    refused("'Empty' has no faces", tools, bodies="Ball;Empty")
    vertices, faces = tools.sphere()
    vertices[3, 1] = np.nan
    tools.add_object("Broken", vertices, faces)
    refused("'Broken': 1 of .* not finite", tools, bodies="Ball;Broken")
    bpy.data.objects.remove(bpy.data.objects["Broken"])
    flat = bpy.data.objects["Far"]
    flat.scale.x = 0
    bpy.context.view_layer.update()
    refused("scaled to zero", tools, bodies="Ball;Far")


def test_everything_rigid(balls, tools):
    refused("every body is rigid", tools, rigid="Ball;Cup")
    assert bpy.ops.femors.check_overclosure(bodies="Ball;Cup", rigid="Ball;Cup") == {"FINISHED"}


def test_two_copies_in_one_place(balls, tools):
    copy = balls[0].copy()
    bpy.context.scene.collection.objects.link(copy)
    refused("copies of one surface", tools, bodies="Ball;Ball.001")


def test_in_place_is_refused_where_there_are_shape_keys(balls, tools):
    balls[0].shape_key_add(name="Basis")
    refused("'Ball' has shape keys", tools, result="IN_PLACE")
    balls[0].data.shape_keys.use_relative = False
    refused("'Ball' has absolute shape keys", tools)


def test_no_overlap_at_all_is_said_and_nothing_moves(balls, tools):
    before = base(balls[0])
    figures = remove(bodies="Ball;Far")
    assert figures["certified"] and "nothing had to be moved" in figures["certificate"]
    assert base(balls[0]) == before and balls[0].data.shape_keys is None
    assert len(form().pairs) == 0


def test_a_body_inside_a_body_is_a_reason_not_an_error(balls, tools, capfd):
    item = ball(tools, "Stone", 0.2, (0, 0, 0.1))
    before = base(item)
    figures = remove(bodies="Ball;Stone")
    assert not figures["certified"] and "'Stone' lies inside" in figures["reasons"][0]
    assert base(item) == before and item.data.shape_keys is None
    assert form().pairs[0].state == "contained"
    assert "NOT CERTIFIED" in capfd.readouterr().out


def test_what_cannot_be_reached_is_a_warning_with_the_best_state(balls, tools, capfd):
    """A soft ball between two rigid ones that leave no room for it."""
    ball(tools, "Left", 1.0, (-1.02, 0, 0))
    ball(tools, "Right", 1.0, (1.02, 0, 0))
    ball(tools, "Soft", 0.5, (0, 0, 0))
    figures = remove(bodies="Left;Right;Soft", rigid="Left;Right", gap=0.2, iterations=8)
    assert not figures["certified"] and figures["reasons"]
    said = capfd.readouterr().out
    assert "Warning: NOT CERTIFIED" in said and "Soft" in said and "Traceback" not in said


def test_an_open_surface_and_an_inverted_one(balls, tools, core, capfd):
    balls[0].data.flip_normals()
    figures = remove()
    assert figures["certified"] and findings(core, *balls)[0].clear
    assert any("Ball" in warning for warning in figures["warnings"])
    assert "Warning: CERTIFIED" in capfd.readouterr().out
    vertices, faces = tools.sphere(16, 24)
    faces = [face for face in faces if vertices[face].mean(axis=0)[0] > -0.7]
    tools.add_object("Bowl", vertices, faces)
    figures = remove(bodies="Bowl;Cup")
    assert any("Bowl" in warning and "open" in warning for warning in figures["warnings"])
    assert "Bowl: the surface is open" in capfd.readouterr().out


def test_a_body_that_crosses_itself_ends_in_words(balls, tools):
    vertices, faces = tools.sphere(16, 24)
    more = [[i + len(vertices) for i in face] for face in faces]
    tools.add_object("Peanut", np.concatenate((vertices, vertices + [0, 0.8, 0])), [*faces, *more])
    figures = remove(bodies="Peanut;Cup")
    assert figures["certified"] or figures["reasons"]


def test_edited_meanwhile(balls, part):
    operator = part("operators.overclosure").FEMORS_OT_remove_overclosure
    shots = [part("operators.bodies").shot(bpy.context, item, 0.5) for item in balls]
    error = part("femors_addon.progress").FemorsError
    read = part("operators.bodies").unchanged
    assert operator.title == "Overclosure"
    assert read(bpy.context, shots[0]) == balls[0]
    balls[0].data.vertices[0].co.x += 1e-3
    with pytest.raises(error, match="edited or moved"):
        read(bpy.context, shots[0])
    key = balls[1].shape_key_add(name="Basis") and balls[1].shape_key_add(name="Flat")
    key.data[0].co.x += 1
    key.value = 0.5
    with pytest.raises(error, match="shape keys of 'Cup' were changed"):
        read(bpy.context, shots[1])
    bpy.data.objects.remove(balls[1])
    with pytest.raises(error, match="deleted or renamed"):
        read(bpy.context, shots[1])
