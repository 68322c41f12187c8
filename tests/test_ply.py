# SPDX-License-Identifier: GPL-3.0-or-later
"""PLY: what is kept when written again, and what is refused in one line."""

from __future__ import annotations

import numpy as np
import pytest
from meshtexts import BINARY, CUBE, CUBE_QUADS, FACE, XYZ, header, ply_bytes, refused, saved

from femors_addon import meshfiles


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("position", ["float", "double", "int"])
def test_ply_keeps_everything_else(tmp_path, order, position):
    data = ply_bytes(order, position)
    mesh = meshfiles.read(saved(tmp_path / "in.ply", data))
    assert np.array_equal(mesh.vertices, CUBE)
    assert mesh.sizes.tolist() == [4] * 6 + [3]
    assert mesh.corners.tolist() == [*CUBE_QUADS.ravel().tolist(), 0, 1, 2]
    moved = CUBE * [1.5, 1, 1]
    meshfiles.write(tmp_path / "out.ply", mesh.with_vertices(moved))
    out = (tmp_path / "out.ply").read_bytes()
    again = meshfiles.read(tmp_path / "out.ply")
    assert np.array_equal(again.vertices, moved)
    assert np.array_equal(again.corners, mesh.corners)
    assert again.template.after == mesh.template.after
    assert again.template.before == mesh.template.before.replace(
        b"property int x", b"property float x"
    ).replace(b"property int y", b"property float y").replace(b"property int z", b"property float z")
    reds = [again.template.rows.split(b"\n")[i].split()[0] for i in range(8)] if order == "ascii" else None
    assert reds is None or reds == [str(i).encode() for i in range(8)]
    assert len(out) == len(data) + 2 * (position == "int") * 3 or order == "ascii"


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_that_did_not_move_is_written_as_it_was(tmp_path, order):
    data = ply_bytes(order, normals=False)
    mesh = meshfiles.read(saved(tmp_path / "in.ply", data))
    meshfiles.write(tmp_path / "out.ply", mesh)
    assert (tmp_path / "out.ply").read_bytes() == data


def test_ply_vertex_normals_follow_the_surface(tmp_path):
    mesh = meshfiles.read(saved(tmp_path / "in.ply", ply_bytes("binary_little_endian")))
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], dtype=float)
    meshfiles.write(tmp_path / "out.ply", mesh.with_vertices(CUBE @ turn.T))
    normals = meshfiles.read(tmp_path / "out.ply").template.normals
    diagonal = (CUBE - 0.5) @ turn.T
    # the odd triangle weighs on three corners; the other five are exact
    assert np.allclose(normals[3:], diagonal[3:] / np.linalg.norm(diagonal[0]), atol=1e-6)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"plywood\n", ["first line is 'ply'"]),
        (b"ply\nformat ascii 1.0\nelement vertex 3\n", ["end_header"]),
        (header("element vertex 0", *XYZ), ["format"]),
        (header("format ascii 1.0", "element vertex many", *XYZ), ["line 3", "element vertex many"]),
        (header("format ascii 1.0", "element vertex 1", "property quad x"), ["line 4", "quad"]),
        (header("format ascii 1.0", "element face 0", FACE), ["'vertex'"]),
        (header("format ascii 1.0", "element vertex 0", *XYZ[:2]), ["x, y, z"]),
        (header("format ascii 1.0", "element vertex 0", *XYZ, "element face 1"), ["'face' has no"]),
        (header("format ascii 1.0", "element vertex 0", *XYZ, "element face 0", "property int a"), ["list"]),
        (header("format ascii 1.0", "element vertex 0", *XYZ, "element tristrips 1", FACE), ["strips"]),
        (header("format ascii 1.0", "element vertex 2", *XYZ, body="0 0 0\n"), ["2 rows 'vertex'", "has 1"]),
        (header("format ascii 1.0", "element vertex 1", *XYZ, body="0 0\n"), ["line 8", "3 numbers"]),
        (header("format ascii 1.0", "element vertex 2", *XYZ, body="0 0 0\n\n0 y 0\n"), ["line 10", "'y'"]),
        (header(BINARY, "element vertex 4000000000", *XYZ, body=b"\0" * 24), ["4000000000 rows", "has 2"]),
        (header(BINARY, f"element vertex {10**18 - 1}", *XYZ, body=b"\0" * 24), ["has 2"]),
        (
            header(
                BINARY, "element vertex 1", *XYZ, "element face 2", FACE, body=bytes(12) + b"\3" + bytes(12)
            ),
            ["2 rows 'face'", "has 1"],
        ),
        (
            header(
                *(BINARY, "element vertex 1", *XYZ, "element face 1", "property list int int vertex_indices"),
                body=bytes(12) + b"\xff\xff\xff\xff",
            ),
            ["negative"],
        ),
        (
            header(
                "format ascii 1.0", "element vertex 1", *XYZ, "element face 1", FACE, body="0 0 0\n3 0 0 1\n"
            ),
            ["face 0", "vertex 1", "has 1"],
        ),
        (
            header(
                "format ascii 1.0", "element vertex 1", *XYZ, "element face 1", FACE, body="0 0 0\n3 0 0\n"
            ),
            ["line 11", "4 numbers"],
        ),
        (header("format ascii 1.0", "element vertex 1", *XYZ, body="0 0 nan\n"), ["not finite", "vertex 0"]),
    ],
)
def test_ply_that_is_refused(tmp_path, content, words):
    refused(saved(tmp_path / "bad.ply", content), *words)
