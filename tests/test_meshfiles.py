# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh files: what is read, what is kept when written again, and what is refused in one line."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import pytest
from growth import LINEAR, growth
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from femors_addon import files, meshfiles
from femors_addon.mesh import Surface
from femors_addon.meshfiles import MeshFile
from femors_addon.progress import FemorsError

TETRA = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
TETRA_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
CUBE = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
CUBE_QUADS = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])


def stl_bytes(corners: np.ndarray, header: bytes = b"", attributes: np.ndarray | None = None) -> bytes:
    """Return a binary STL written record by record, independently of the code under test."""
    out = header.ljust(80, b"\0") + struct.pack("<I", len(corners))
    for i, triangle in enumerate(corners):
        attribute = 0 if attributes is None else int(attributes[i])
        out += struct.pack("<3f9fH", 0, 0, 0, *np.asarray(triangle).ravel(), attribute)
    return out


def saved(path: Path, content: bytes | str) -> Path:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refused(path: Path, *words: str) -> str:
    """Assert that reading fails in one line that names the file and says the words."""
    with pytest.raises(FemorsError) as caught:
        meshfiles.read(path)
    text = str(caught.value)
    assert text.startswith(str(path)), text
    assert "\n" not in text
    for word in words:
        assert word in text
    return text


# --- STL ------------------------------------------------------------------------------------------
ASCII = """solid left femur
  facet normal 0 0 1
    outer loop
      vertex 0 0 0
      vertex 1.5e0 0 0
      vertex 0 1 0
    endloop
  endfacet
endsolid left femur
solid second facet vertex
facet normal 0 0 0
outer loop
vertex 0 0 0
vertex 0 1 0
vertex 0 0 1
endloop
endfacet
endsolid
"""


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


def test_binary_stl_is_read_at_the_pace_of_its_bytes():
    def soup(count: int) -> tuple[np.ndarray, bytes]:
        corners = np.random.default_rng(0).normal(size=(3 * count, 3))
        mesh = MeshFile(corners, np.full(count, 3), np.arange(3 * count))
        return corners, meshfiles.encoded("x.stl", mesh)

    corners, data = soup(400_000)
    assert growth(meshfiles.stl.parse, soup(50_000)[1], data) < LINEAR
    assert np.array_equal(meshfiles.stl.parse(data)[0], corners.astype(np.float32))


# --- OBJ ------------------------------------------------------------------------------------------
OBJ = b"""# a cube, partly
mtllib skin.mtl\r
o Bone
v 0 0 0 0.5 0.25 1 # coloured
v  1.0\t0 0
v 1 1 0
vn 0 0 1
vt 0.1 0.2
v 0 1 0 1.0
v 0 0 1
g head
usemtl bone
s 1
f 1/1/1 2/1/1 3/1/1 4/1/1
f -5//1 -4//1 -1//1
f 1 2 \\
  5
f 1/1 3/1 5/1
l 1 2
"""


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


# --- PLY ------------------------------------------------------------------------------------------
def ply_bytes(order: str, position: str = "float", normals: bool = True) -> bytes:
    """Return a PLY cube of quads and a triangle with colours, normals, face flags and edges."""
    code = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[order]
    head = [
        *("ply", f"format {order} 1.0", "comment made by hand", "obj_info more", "element vertex 8"),
        *("property uchar red", f"property {position} x", f"property {position} y", f"property {position} z"),
        *([f"property float {n}" for n in ("nx", "ny", "nz")] if normals else []),
        *("element face 7", "property uchar flags", "property list uchar int vertex_indices"),
        *("element edge 1", "property int vertex1", "property list uchar double extra", "end_header"),
    ]
    out = ("\n".join(head) + "\n").encode()
    polygons = [*CUBE_QUADS.tolist(), [0, 1, 2]]
    number = {"float": "f", "double": "d", "int": "i"}[position]

    def row(codes: str, *values: float) -> bytes:
        if not code:
            return " ".join(f"{v:g}" for v in values).encode() + b"\n"
        return struct.pack(
            code + codes, *(int(v) if c in "Bi" else v for c, v in zip(codes, values, strict=True))
        )

    for i, (x, y, z) in enumerate(CUBE):
        normal = ([x - 0.5, y - 0.5, z - 0.5]) if normals else []
        out += row("B" + 3 * number + len(normal) * "f", i, x, y, z, *normal)
    for i, polygon in enumerate(polygons):
        out += row("BB" + len(polygon) * "i", i, len(polygon), *polygon)
    return out + row("iBdd", 7, 2, 0.5, 0.25)


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


def header(*lines: str, body: str | bytes = "") -> bytes:
    text = "\n".join(["ply", *lines, "end_header", ""]).encode()
    return text + (body.encode() if isinstance(body, str) else body)


XYZ = ("property float x", "property float y", "property float z")
FACE = "property list uchar int vertex_indices"
BINARY = "format binary_little_endian 1.0"


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


# --- every format ---------------------------------------------------------------------------------
@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
@pytest.mark.parametrize("origin", [".stl", ".ply", ".obj", ".OBJ"])
def test_any_format_becomes_any_other(tmp_path, origin, suffix):
    sizes, corners = [4] * 6 + [5], [*CUBE_QUADS.ravel(), 0, 1, 3, 2, 4]
    first = MeshFile(CUBE, np.array(sizes), np.array(corners))
    meshfiles.write(tmp_path / f"a{origin}", first)
    read = meshfiles.read(tmp_path / f"a{origin}")
    meshfiles.write(tmp_path / f"b{suffix}", read)
    again = meshfiles.read(tmp_path / f"b{suffix}")
    shape, expected = again.surface(), first.surface()
    assert np.array_equal(shape.vertices[shape.faces], expected.vertices[expected.faces])
    if ".stl" not in (origin, suffix):
        assert again.sizes.tolist() == sizes
        assert np.array_equal(again.vertices, CUBE)


def test_of_surface_and_wrong_shape():
    mesh = MeshFile.of(Surface(TETRA, TETRA_FACES))
    assert np.array_equal(mesh.surface().faces, TETRA_FACES)
    with pytest.raises(ValueError, match=r"\(4, 3\)"):
        mesh.with_vertices(TETRA[:3])


def test_polygons_of_more_corners_than_a_byte_counts(tmp_path):
    angle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    disc = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(300))).astype(np.float32)
    meshfiles.write(tmp_path / "disc.ply", MeshFile(disc, np.array([300]), np.arange(300)))
    again = meshfiles.read(tmp_path / "disc.ply")
    assert again.sizes.tolist() == [300]
    assert np.array_equal(again.vertices, disc)


@pytest.mark.parametrize("suffix", [".stl", ".ply"])
def test_coordinates_beyond_single_precision_are_refused(tmp_path, suffix):
    mesh = MeshFile.of(Surface(1e300 * TETRA, TETRA_FACES))
    with pytest.raises(FemorsError, match="too large"):
        meshfiles.write(tmp_path / f"big{suffix}", mesh)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_missing_folder_empty_and_unknown(tmp_path, suffix):
    refused(tmp_path / f"missing{suffix}", "no such file")
    (tmp_path / f"folder{suffix}").mkdir()
    refused(tmp_path / f"folder{suffix}", "folder")
    refused(saved(tmp_path / f"empty{suffix}", b""), "empty")
    refused(tmp_path / "mesh.step", "'.step'", ".stl, .ply, .obj")
    refused(tmp_path / "noending", "''")


PREFIXES = [
    *(b"", b"solid x\n", ASCII.encode()[:150], b"v 0 0 0\nf 1 ", OBJ, b"ply\n"),
    *(ply_bytes(order)[:-30] for order in ("ascii", "binary_little_endian", "binary_big_endian")),
    header(BINARY, "element vertex 1", *XYZ, "element face 3", FACE, body=bytes(12)),
    stl_bytes(TETRA[TETRA_FACES])[:-50],
]
WORDS = [b"facet normal 0 0 1", b"outer loop", b"vertex", b"solid", b"endsolid", b"\n", b" ", b"v", b"f"]
WORDS += [
    b"1/1/1",
    b"-1",
    b"\\\n",
    b"element vertex 99999999999",
    b"end_header\n",
    b"1e999",
    b"nan",
    b"#",
    b"3",
]


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
@settings(
    max_examples=150,
    deadline=2000,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    prefix=st.sampled_from(PREFIXES),
    tail=st.one_of(st.binary(max_size=200), st.lists(st.sampled_from(WORDS), max_size=25).map(b" ".join)),
)
@example(prefix=b"v 0 0 0\n", tail=b"f 1" + b"/" * 10)
@example(prefix=b"ply\r\n", tail=b"format ascii 1.0\r\nend_header\r\n")
def test_no_bytes_give_anything_but_a_mesh_or_one_line(tmp_path, suffix, prefix, tail):
    path = saved(tmp_path / f"fuzz{suffix}", prefix + tail)
    try:
        mesh = meshfiles.read(path)
        meshfiles.encoded(path, mesh.with_vertices(mesh.vertices + 1.0))
    except FemorsError as error:
        assert len(str(error).splitlines()) == 1


# --- writing --------------------------------------------------------------------------------------
def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = saved(tmp_path / "result.stl", b"precious")
    other = tmp_path / "report.json"
    with pytest.raises(RuntimeError), files.replacing(path, other) as (one, two):
        one.write_bytes(b"half")
        two.write_bytes(b"half")
        raise RuntimeError
    assert [p.name for p in tmp_path.iterdir()] == ["result.stl"]
    assert path.read_bytes() == b"precious"
    with files.replacing(path, other) as (one, two):
        one.write_bytes(b"whole")
        two.write_bytes(b"too")
    assert (path.read_bytes(), other.read_bytes()) == (b"whole", b"too")
    assert len(list(tmp_path.iterdir())) == 2


def test_folders_that_were_made_go_again_where_the_work_fails(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    for folder in ("mine/a/b/c", tmp_path / "x" / "y", "mine/new/../other"):
        with pytest.raises(RuntimeError), files.folder_for(folder):
            assert os.path.isdir(folder)
            raise RuntimeError
        assert [path.name for path in tmp_path.rglob("*")] == ["mine"]
    too_long = "n" * 300
    with pytest.raises(FemorsError, match=f"{too_long}: cannot be made"), files.folder_for(f"a/b/{too_long}"):
        raise AssertionError
    assert [path.name for path in tmp_path.rglob("*")] == ["mine"]
    with pytest.raises(RuntimeError), files.folder_for("a/b"):
        (tmp_path / "a" / "note.txt").write_text("of somebody else")
        raise RuntimeError
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a", "mine", "note.txt"]
    with files.folder_for("a/b/c"), files.folder_for("mine"):
        pass
    assert (tmp_path / "a" / "b" / "c").is_dir()


def test_writing_through_a_link_and_with_the_usual_permissions(tmp_path):
    (tmp_path / "real").mkdir()
    link = tmp_path / "link.stl"
    link.symlink_to(tmp_path / "real" / "x.stl")
    files.write_bytes(link, b"abc")
    assert link.is_symlink()
    assert (tmp_path / "real" / "x.stl").read_bytes() == b"abc"
    plain = saved(tmp_path / "plain", b"")
    assert (tmp_path / "real" / "x.stl").stat().st_mode == plain.stat().st_mode


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("nowhere/x.stl", "no folder"),
        ("", "folder"),
        ("/proc/x.stl", "cannot be written"),
        ("/dev/null", "regular"),
    ],
)
def test_places_that_cannot_be_written(tmp_path, name, word):
    if name.startswith("/") and not Path(name).parent.is_dir():
        pytest.skip(f"no {name} here")
    path = tmp_path / name
    for attempt in (lambda: files.check_writable(path), lambda: files.write_bytes(path, b"x")):
        with pytest.raises(FemorsError, match=word) as caught:
            attempt()
        assert str(path) in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_write_permission(tmp_path, monkeypatch):
    def denied(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "touch", denied)  # root may write anywhere, so the real thing would not fail
    with pytest.raises(FemorsError, match="permission denied"):
        files.check_writable(tmp_path / "x.stl")


def test_a_device_is_not_read():
    if not os.path.exists("/dev/zero"):
        pytest.skip("no /dev/zero here")
    with pytest.raises(FemorsError, match="regular"):
        files.read_bytes("/dev/zero")
