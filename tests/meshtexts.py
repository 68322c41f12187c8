# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh files of every format for tests, written independently of the code under test."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from femors_addon import meshfiles
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


def header(*lines: str, body: str | bytes = "") -> bytes:
    text = "\n".join(["ply", *lines, "end_header", ""]).encode()
    return text + (body.encode() if isinstance(body, str) else body)


XYZ = ("property float x", "property float y", "property float z")
FACE = "property list uchar int vertex_indices"
BINARY = "format binary_little_endian 1.0"
