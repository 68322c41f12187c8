# SPDX-License-Identifier: GPL-3.0-or-later
"""How things are counted in what FEMORS says: one face has no area, two faces have none."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import numpy as np
import pytest

from docs.make import messages
from femors_addon.cleaning import clean
from femors_addon.findings import Finding
from femors_addon.progress import counted
from femors_addon.shapes import pair

ROOT = Path(__file__).resolve().parent.parent


def test_one_is_singular_and_all_else_plural():
    assert [counted(n, "face") for n in (0, 1, 2)] == ["0 faces", "1 face", "2 faces"]
    assert [counted(n, "vertex is", "vertices are") for n in (1, 30)] == ["1 vertex is", "30 vertices are"]


@pytest.mark.parametrize("folder", ["femors_addon", "operators", "ui"])
def test_no_message_leaves_the_plural_to_the_reader(folder):
    for path in sorted((ROOT / folder).glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                assert not re.search(r"[a-z]\((s|es)\)", node.value), (path, node.lineno)


@pytest.mark.parametrize(
    ("copies", "words"),
    [
        (1, ["1 vertex belongs to no face", "1 face has no area and", "1 face stands twice and was"]),
        (2, ["2 vertices belong to no face", "2 faces have no area and", "2 faces stand twice and were"]),
    ],
)
def test_notes_on_a_mesh_that_was_mended(copies, words):
    bone = pair(200, 200).source
    loose = bone.vertices[:copies] + 1e3
    faces = np.concatenate((bone.faces, bone.faces[:copies], np.repeat(bone.faces[:copies, :1], 3, axis=1)))
    said = "; ".join(clean(np.concatenate((bone.vertices, loose)), faces, "mesh").notes)
    assert all(word in said for word in words), said


def test_a_pair_of_bodies_that_just_touch():
    one = Finding("a", "b", 0.1, -0.2, (1, 0), 1, "", (0.0, 0.0, 0.0), None, "overlap")
    assert "1 node closer than 0.1, 1 crossing pair of triangles, at" in str(one)


def test_the_manual_lists_counted_messages_in_the_plural():
    text = "f\"{counted(n, 'polygon has', 'polygons have')} corners; {counted(m, 'node')} of {name}\""
    assert messages._text(ast.parse(text).body[0].value) == "… polygons have corners; … nodes of …"
