# SPDX-License-Identifier: GPL-3.0-or-later
"""Wavefront OBJ: bytes to arrays and back.

When written again, a file keeps every byte (groups, materials, texture coordinates, comments) except
the coordinates of the `v` lines that moved and the normals of the `vn` lines, which follow the surface.
"""

from __future__ import annotations

import dataclasses
import re
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from .files import BadNumber, floats, integers
from .mesh import Float, Int
from .normals import carried
from .progress import FemorsError


@dataclasses.dataclass(frozen=True, eq=False)
class Template:
    """An OBJ file's lines and where its geometry stands in them.

    Attributes
    ----------
    lines : tuple of bytes
        Every line without its end; a statement continued by a backslash counts as one line.
    vertex_lines, normal_lines : (n,), (k,) int
        The lines of `v` and `vn`.
    vertices, normals : (n, 3), (k, 3) float64
        As read.
    corner_normals : (c,) int64
        The normal at each polygon corner, -1 where the file names none.
    """

    lines: tuple[bytes, ...]
    vertex_lines: NDArray[np.int64]
    normal_lines: NDArray[np.int64]
    vertices: Float
    normals: Float
    corner_normals: NDArray[np.int64]


def parse(data: bytes) -> tuple[Float, Int, Int, Template]:
    """Return (vertices (n, 3), sizes (p,), corners (sum(sizes),), template) of an OBJ file's bytes.

    Raises
    ------
    FemorsError
        No vertices, a malformed number, a face that names a vertex that is not there.
    """
    lines = _statements(data)
    where: dict[bytes, list[int]] = {b"v": [], b"vn": [], b"f": []}
    words: dict[bytes, list[tuple[bytes, ...]]] = {key: [] for key in where}
    for number, line in enumerate(lines):
        if line[:1] in b"vf \t":  # an empty line is in it too, and splits into nothing
            tokens = _joined(line).partition(b"#")[0].split()
            if tokens and tokens[0] in where:
                where[tokens[0]].append(number)
                words[tokens[0]].append(tuple(tokens[1:]))
    vertices = _positions(lines, where[b"v"], words[b"v"])
    if len(vertices) == 0:
        raise FemorsError("is not an OBJ file with a mesh: it has no 'v' line")
    normals = _positions(lines, where[b"vn"], words[b"vn"])
    sizes = np.fromiter(map(len, words[b"f"]), np.int64, len(words[b"f"]))
    tokens = list(chain.from_iterable(words[b"f"]))
    face_lines = np.repeat(np.array(where[b"f"], dtype=np.int64), sizes)
    vertex_lines, normal_lines = (np.array(where[key], dtype=np.int64) for key in (b"v", b"vn"))
    corners = _indices(lines, tokens, 0, face_lines, vertex_lines, "vertex")
    corner_normals = _indices(lines, tokens, 2, face_lines, normal_lines, "normal")
    template = Template(tuple(lines), vertex_lines, normal_lines, vertices, normals, corner_normals)
    return vertices, sizes.astype(np.int32), corners.astype(np.int32), template


def called(index: int) -> str:
    """Return what an OBJ file calls a vertex: faces count from 1."""
    return f"vertex {index + 1}, counted from 1"


def _statements(data: bytes) -> list[bytes]:
    lines = data.split(b"\n")
    if b"\\\n" not in data and b"\\\r\n" not in data:
        return lines
    out: list[bytes] = []
    for line in lines:
        if out and out[-1].rstrip(b"\r").endswith(b"\\"):
            out[-1] += b"\n" + line
        else:
            out.append(line)
    return out


def _positions(lines: list[bytes], where: list[int], words: list[tuple[bytes, ...]]) -> Float:
    """Return (k, 3) the first three numbers of each statement."""
    for number, tokens in zip(where, words, strict=True):
        if len(tokens) < 3:
            raise FemorsError(f"line {_line(lines, number)}: three numbers are needed, not {len(tokens)}")
    try:
        return floats(list(chain.from_iterable(tokens[:3] for tokens in words))).reshape(-1, 3)
    except BadNumber as error:
        raise FemorsError(f"line {_line(lines, where[error.index // 3])}: {error}") from None


def _indices(
    lines: list[bytes],
    tokens: list[bytes],
    part: int,
    face_lines: NDArray[np.int64],
    element_lines: NDArray[np.int64],
    what: str,
) -> NDArray[np.int64]:
    """Return (c,) the zero-based index in one part of "v/vt/vn" corners, -1 where it is left out."""
    texts = tokens if part == 0 else [b""] * len(tokens)
    if b"/" in b"".join(tokens):
        texts = [(token.split(b"/") + [b"", b""])[part] for token in tokens]
    given = np.fromiter((bool(text) or part == 0 for text in texts), bool, len(texts))
    texts = [text for text in texts if text or part == 0]
    lines_of = face_lines[given]
    try:
        value = integers(texts)
    except BadNumber as error:
        line = _line(lines, int(lines_of[error.index]))
        raise FemorsError(f"line {line}: {error}, and a {what} index is needed") from None
    # counted backwards from the face's own line where negative
    index = np.where(value < 0, value + np.searchsorted(element_lines, lines_of), value - 1)
    wrong = (index < 0) | (index >= len(element_lines)) | (value == 0)
    if wrong.any():
        first = int(np.argmax(wrong))
        line = _line(lines, int(lines_of[first]))
        raise FemorsError(
            f"line {line}: a face names {what} {value[first]}, the file has {len(element_lines)}"
        )
    out = np.full(len(given), -1, dtype=np.int64)
    out[given] = index
    return out


def _joined(line: bytes) -> bytes:
    """Return a statement without its continuations."""
    return line.replace(b"\\\n", b" ").replace(b"\\\r\n", b" ") if b"\\" in line else line


def _line(lines: list[bytes], statement: int) -> int:
    return 1 + statement + sum(line.count(b"\n") for line in lines[:statement])


# --- writing --------------------------------------------------------------------------------------
_COORDINATES = re.compile(rb"(\s*v\s+)\S+\s+\S+\s+[^\s#]+(.*)", re.DOTALL)


def build(vertices: Float, sizes: Int, corners: Int, template: Template | None) -> bytes:
    """Return an OBJ file's bytes: the template's with other coordinates, or plain `v` and `f` lines."""
    if template is None:
        return _build_plain(vertices, sizes, corners)
    lines = list(template.lines)
    moved = np.flatnonzero((vertices != template.vertices).any(axis=1))
    for number, position in zip(template.vertex_lines[moved].tolist(), vertices[moved].tolist(), strict=True):
        parts = _COORDINATES.match(_joined(lines[number]))
        assert parts is not None, lines[number]
        lines[number] = parts[1] + b"%.10g %.10g %.10g" % tuple(position) + parts[2]
    if len(moved) and len(template.normals):
        normals = carried(
            template.normals, template.corner_normals, template.vertices, vertices, sizes, corners
        )
        turned = np.flatnonzero((normals != template.normals).any(axis=1))
        for number, normal in zip(
            template.normal_lines[turned].tolist(), normals[turned].tolist(), strict=True
        ):
            end = b"\r" if lines[number].endswith(b"\r") else b""
            lines[number] = b"vn %.6g %.6g %.6g" % tuple(normal) + end
    return b"\n".join(lines)


def _build_plain(vertices: Float, sizes: Int, corners: Int) -> bytes:
    out = ["# FEMORS\n", "v %.10g %.10g %.10g\n" * len(vertices) % tuple(vertices.ravel().tolist())]
    names = [str(index) for index in (corners + 1).tolist()]
    start = 0
    for size in sizes.tolist():
        out.append(f"f {' '.join(names[start : start + size])}\n")
        start += size
    return "".join(out).encode()
