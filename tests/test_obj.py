# SPDX-License-Identifier: GPL-3.0-or-later
"""OBJ: what is kept when written again, and what is refused in one line."""

from __future__ import annotations

import numpy as np
import pytest
from meshtexts import CUBE, CUBE_QUADS, OBJ, refused, saved

from femors_addon import meshfiles


def test_obj_changes_only_the_coordinates_that_moved(tmp_path):
    path = saved(tmp_path / "in.obj", OBJ)
    mesh = meshfiles.read(path)
    assert mesh.sizes.tolist() == [4, 3, 3, 3]
    assert mesh.corners.tolist() == [0, 1, 2, 3, 0, 1, 4, 0, 1, 4, 0, 2, 4]
    meshfiles.write(tmp_path / "same.obj", mesh)
    assert (tmp_path / "same.obj").read_bytes() == OBJ
    moved = mesh.vertices.copy()
    moved[:4] += [0, 0, 0.125]
    meshfiles.write(tmp_path / "out.obj", mesh.with_vertices(moved))
    before, after = OBJ.split(b"\n"), (tmp_path / "out.obj").read_bytes().split(b"\n")
    changed = [(a, b) for a, b in zip(before, after, strict=True) if a != b]
    assert changed[0] == (b"v 0 0 0 0.5 0.25 1 # coloured", b"v 0 0 0.125 0.5 0.25 1 # coloured")
    assert changed[1] == (b"v  1.0\t0 0", b"v  1 0 0.125")
    assert [a.split()[0] for a, _ in changed] == [b"v", b"v", b"v", b"vn", b"v"]
    assert np.array_equal(meshfiles.read(tmp_path / "out.obj").vertices, moved)


def test_obj_normals_follow_the_surface_on_their_own_side(tmp_path):
    quads = "".join(
        "f " + " ".join(f"{i + 1}//{k + 1}" for i in quad) + "\n" for k, quad in enumerate(CUBE_QUADS)
    )
    inward = [-np.cross(CUBE[q[1]] - CUBE[q[0]], CUBE[q[2]] - CUBE[q[0]]) for q in CUBE_QUADS]
    text = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in CUBE)
    text += "".join(f"vn {x:g} {y:g} {z:g}\n" for x, y, z in inward) + "vn 0.6 0.8 0\n" + quads
    mesh = meshfiles.read(saved(tmp_path / "in.obj", text))
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], dtype=float)
    meshfiles.write(tmp_path / "out.obj", mesh.with_vertices(mesh.vertices @ turn.T))
    again = meshfiles.read(tmp_path / "out.obj")
    assert np.allclose(again.template.normals[:6], np.array(inward) @ turn.T)
    assert np.array_equal(again.template.normals[6], [0.6, 0.8, 0])  # used by no face


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("f 1 2 3\n", ["no 'v' line"]),
        ("v 0 0 0\nv 1 0 zero\n", ["line 2", "'zero' is not a number"]),
        ("v 0 0 0\nv 1 0\n", ["line 2", "three numbers"]),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", ["line 4", "vertex 4", "has 3"]),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n", ["line 4", "vertex 0"]),
        ("v 0 0 0\nv 1 0 0\nf -1 -2 -3\nv 0 1 0\n", ["line 3", "vertex -3"]),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf a b c\n", ["line 4", "'a' is not a number"]),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1//1 2 3\n", ["line 4", "normal 1", "has 0"]),
        ("v 0 0 0\nv 1 0 0\nv 0 1 \\\n0\nf 1 \\\n 2 99999999999999999999\n", ["line 5", "not a number"]),
        ("v 0 0 0\nv 1 inf 0\n", ["not finite", "vertex 2"]),
    ],
)
def test_obj_that_is_refused(tmp_path, content, words):
    refused(saved(tmp_path / "bad.obj", content), *words)
