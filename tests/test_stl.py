# SPDX-License-Identifier: GPL-3.0-or-later
"""STL: what is read, what is kept when written again, and what is refused in one line."""

from __future__ import annotations

import numpy as np
import pytest
from growth import calls
from meshtexts import ASCII, TETRA, TETRA_FACES, refused, saved, stl_bytes

from femors_addon import meshfiles
from femors_addon.meshfiles import MeshFile


def test_binary_stl_keeps_order_header_and_attributes(tmp_path):
    attributes = np.array([7, 0, 65535, 31])
    path = saved(tmp_path / "in.stl", stl_bytes(TETRA[TETRA_FACES], b"COLOR=abc", attributes))
    mesh = meshfiles.read(path)
    assert np.array_equal(mesh.vertices, TETRA[TETRA_FACES].reshape(-1, 3))
    assert np.array_equal(mesh.surface().faces, np.arange(12).reshape(4, 3))
    meshfiles.write(tmp_path / "out.stl", mesh.with_vertices(2 * mesh.vertices))
    out = (tmp_path / "out.stl").read_bytes()
    assert out[:80] == b"COLOR=abc".ljust(80, b"\0")
    records = np.frombuffer(out, meshfiles.stl.RECORD, offset=84)
    assert np.array_equal(records["attribute"], attributes)
    assert np.array_equal(records["corners"], 2 * TETRA[TETRA_FACES])
    expected = [[0, 0, -1], [0, -1, 0], [-1, 0, 0], np.ones(3) / np.sqrt(3)]
    assert np.allclose(records["normal"], expected)


def test_a_binary_stl_may_begin_with_the_word_solid_but_none_is_written_so(tmp_path):
    path = saved(tmp_path / "in.stl", stl_bytes(TETRA[TETRA_FACES], b"solid by some program"))
    mesh = meshfiles.read(path)
    assert len(mesh.vertices) == 12
    meshfiles.write(tmp_path / "out.stl", mesh)
    out = (tmp_path / "out.stl").read_bytes()
    assert not out.lower().startswith(b"solid")
    assert np.array_equal(meshfiles.read(tmp_path / "out.stl").vertices, mesh.vertices)


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("case", [str, str.upper])
def test_ascii_stl_with_two_solids(tmp_path, newline, case):
    mesh = meshfiles.read(saved(tmp_path / "in.stl", case(ASCII).replace("\n", newline)))
    expected = [[0, 0, 0], [1.5, 0, 0], [0, 1, 0], [0, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert np.array_equal(mesh.vertices, expected)
    meshfiles.write(tmp_path / "out.stl", mesh)
    text = (tmp_path / "out.stl").read_text()
    assert text.startswith(case("solid left femur")[:5].lower())
    assert [line for line in text.lower().splitlines() if "solid" in line] == [
        *("solid left femur", "endsolid left femur"),
        *("solid second facet vertex", "endsolid second facet vertex"),
    ]
    assert "facet normal 1 0 0" in text
    assert np.array_equal(meshfiles.read(tmp_path / "out.stl").vertices, expected)


def test_ascii_stl_coordinates_survive_to_ten_digits(tmp_path):
    mesh = meshfiles.read(saved(tmp_path / "in.stl", ASCII))
    moved = mesh.with_vertices(np.random.default_rng(0).normal(scale=300, size=mesh.vertices.shape))
    meshfiles.write(tmp_path / "out.stl", moved)
    assert np.allclose(meshfiles.read(tmp_path / "out.stl").vertices, moved.vertices, rtol=1e-9, atol=0)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("hello, this is not a mesh\n" * 20, ["text", "'solid'"]),
        ("short", ["text"]),
        (b"ply\nformat binary_little_endian 1.0\n" + bytes(100), ["PLY file", "give it the ending .ply"]),
        (b"ply\r\nformat ascii 1.0\r\n" + b" " * 100, ["PLY file"]),
        (b"\0\1", ["84"]),
        (stl_bytes(TETRA[TETRA_FACES])[:-20], ["truncated", "4 triangles", "284 bytes", "264"]),
        (stl_bytes(TETRA[TETRA_FACES]) + b"\0", ["4 triangles", "285"]),
        (stl_bytes(TETRA[:0, None]), ["no triangles"]),
        ("solid empty\nendsolid empty\n", ["no triangles"]),
        (ASCII.replace("1.5e0", "1,5"), ["line 5", "'1,5' is not a number"]),
        (ASCII.replace("1.5e0", "1_5"), ["line 5", "'1_5' is not a number"]),
        (ASCII.replace("      vertex 0 1 0\n", "", 1), ["line 6", "'vertex' was expected, not 'endloop'"]),
        (ASCII.replace("endsolid left femur\n", ""), ["line 9", "'facet' was expected", "'solid'"]),
        (ASCII[: ASCII.index("endloop")], ["line 7", "ends where 'endloop'"]),
        (ASCII.replace("1.5e0", "nan"), ["not finite", "corner 2 of triangle 1"]),
        (stl_bytes(np.full((1, 3, 3), np.inf)), ["3 of 3", "not finite"]),
    ],
)
def test_stl_that_is_refused(tmp_path, content, words):
    refused(saved(tmp_path / "bad.stl", content), *words)


def test_binary_stl_is_read_by_whole_arrays():
    def soup(count: int) -> tuple[np.ndarray, bytes]:
        corners = np.random.default_rng(0).normal(size=(3 * count, 3))
        mesh = MeshFile(corners, np.full(count, 3), np.arange(3 * count))
        return corners, meshfiles.encoded("x.stl", mesh)

    corners, data = soup(400_000)
    assert calls(meshfiles.stl.parse, data) == calls(meshfiles.stl.parse, soup(500)[1]) > 0
    assert np.array_equal(meshfiles.stl.parse(data)[0], corners.astype(np.float32))
