# SPDX-License-Identifier: GPL-3.0-or-later
"""PLY (Stanford), ASCII and binary of either byte order: bytes to arrays and back.

When written again, a file keeps its header, its other elements and every other property of its
vertices and faces byte for byte; vertex normals (nx, ny, nz) follow the surface.
"""

from __future__ import annotations

import dataclasses
import re

import numpy as np
from numpy.typing import NDArray

from .files import shown
from .mesh import Float, Int
from .normals import carried
from .plybody import AsciiBody, BinaryBody, Element, Property
from .progress import FemorsError

_CODES = ("i1", "u1", "i2", "u2", "i4", "u4")
INTEGERS = {
    **dict(zip(("char", "uchar", "short", "ushort", "int", "uint"), _CODES, strict=True)),
    **dict(zip(("int8", "uint8", "int16", "uint16", "int32", "uint32"), _CODES, strict=True)),
}
TYPES = {**INTEGERS, "float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
NORMAL = ("nx", "ny", "nz")
END = re.compile(rb"^end_header[ \t]*\r?\n", re.MULTILINE)


@dataclasses.dataclass(frozen=True, eq=False)
class Template:
    """A PLY file around its vertex rows.

    Attributes
    ----------
    order : {"", "<", ">"}
        ASCII, or a binary file's byte order.
    vertex : Element
        The header's vertex element.
    before, rows, after : bytes
        The file in three parts; `rows` are those of the vertices.
    vertices, normals : (n, 3) float64
        As read; `normals` has no rows where the file has none.
    """

    order: str
    vertex: Element
    before: bytes
    rows: bytes
    after: bytes
    vertices: Float
    normals: Float


def parse(data: bytes) -> tuple[Float, Int, Int, Template]:
    """Return (vertices (n, 3), sizes (p,), corners (sum(sizes),), template) of a PLY file's bytes.

    Raises
    ------
    FemorsError
        A broken header, fewer rows than it announces, a malformed number, a face that names a vertex
        that is not there.
    """
    order, elements, start = _header(data)
    body = BinaryBody(data, start, order) if order else AsciiBody(data, start)
    parts = [data[:start], b"", b""]
    template = None
    sizes = corners = np.zeros(0, dtype=np.int64)
    for element in elements:
        if element.name == "vertex":
            table, parts[1] = body.table(element, _vertex_columns(element))
            template = Template(order, element, parts[0], parts[1], b"", table[:, :3], table[:, 3:])
            continue
        column = element.column("vertex_indices", "vertex_index") if element.name == "face" else -1
        if column >= 0:
            sizes, corners, raw = body.lists(element, column)
        else:
            raw = body.skip(element)[1]
        parts[0 if template is None else 2] += raw
    assert template is not None  # _header sees to it
    template = dataclasses.replace(template, after=parts[2] + body.rest())
    _check_faces(sizes, corners, len(template.vertices))
    return template.vertices, sizes.astype(np.int32), corners.astype(np.int32), template


def called(index: int) -> str:
    """Return what a PLY file calls a vertex: faces count from 0."""
    return f"vertex {index}, counted from 0"


def _header(data: bytes) -> tuple[str, list[Element], int]:
    """Return (byte order, elements, where the rows begin)."""
    if re.match(rb"ply[ \t]*\r?\n", data) is None:
        raise FemorsError("is not a PLY file, whose first line is 'ply'")
    end = END.search(data)
    if end is None:
        raise FemorsError("is a PLY file whose header has no 'end_header' line")
    order: str | None = None
    elements: list[Element] = []
    for number, line in enumerate(data[: end.start()].split(b"\n"), 1):
        words = line.decode("latin-1").split()
        if words[:1] == ["format"] and len(words) > 1 and words[1] in ORDERS:
            order = ORDERS[words[1]]
        elif words[:1] == ["element"] and len(words) == 3 and re.fullmatch("[0-9]{1,18}", words[2]):
            elements.append(Element(words[1], int(words[2]), ()))
        elif words[:1] == ["property"] and elements and (new := _property(words)):
            last = elements[-1]
            elements[-1] = dataclasses.replace(last, properties=(*last.properties, new))
        elif words and words[0] not in ("ply", "comment", "obj_info"):
            raise FemorsError(f"line {number}: '{shown(line.strip())}' is not understood in a PLY header")
    if order is None:
        raise FemorsError("is a PLY file whose header has no 'format' line")
    _check_elements(elements)
    return order, elements, end.end()


def _property(words: list[str]) -> Property | None:
    if len(words) == 3 and words[1] in TYPES:
        return Property(words[2], TYPES[words[1]])
    if len(words) == 5 and words[1] == "list" and words[2] in INTEGERS and words[3] in TYPES:
        return Property(words[4], TYPES[words[3]], INTEGERS[words[2]])
    return None


def _check_elements(elements: list[Element]) -> None:
    names = [element.name for element in elements]
    if names.count("vertex") != 1 or names.count("face") > 1:
        raise FemorsError("is a PLY file without exactly one 'vertex' and at most one 'face' element")
    if "tristrips" in names and "face" not in names:
        raise FemorsError("stores triangle strips, which cannot be read; save it with plain faces")
    for element in elements:
        columns = [p.name for p in element.properties]
        if not columns or len(set(columns)) < len(columns):
            raise FemorsError(f"is a PLY file whose element '{element.name}' has no or repeated properties")
        if element.name == "vertex" and (element.has_lists or not {"x", "y", "z"} <= set(columns)):
            raise FemorsError("is a PLY file whose vertices are not made of x, y, z and other plain numbers")
        face = element.properties[element.column("vertex_indices", "vertex_index")]
        if element.name == "face" and not (face.counter and face.type in INTEGERS.values()):
            raise FemorsError("is a PLY file whose faces have no list 'vertex_indices' of whole numbers")


def _vertex_columns(vertex: Element) -> list[int]:
    """Return the columns of x, y, z and, where all three are there, of the normal."""
    normal = [vertex.column(name) for name in NORMAL]
    floating = all(i >= 0 and vertex.properties[i].type[0] == "f" for i in normal)
    return [vertex.column(name) for name in "xyz"] + (normal if floating else [])


def _check_faces(sizes: NDArray[np.int64], corners: NDArray[np.int64], count: int) -> None:
    wrong = (corners < 0) | (corners >= count)
    if wrong.any():
        first = int(np.argmax(wrong))
        face = int(np.searchsorted(np.cumsum(sizes), first, side="right"))
        raise FemorsError(f"face {face} (from 0) names vertex {corners[first]}, the file has {count}")


# --- writing --------------------------------------------------------------------------------------
def build(vertices: Float, sizes: Int, corners: Int, template: Template | None) -> bytes:
    """Return a PLY file's bytes: the template's with other coordinates, or plain little-endian binary."""
    if template is None:
        return _build_plain(vertices, sizes, corners)
    values = vertices
    columns = _vertex_columns(template.vertex)
    if len(columns) > 3:
        normals = carried(template.normals, corners, template.vertices, vertices, sizes, corners)
        values = np.concatenate((vertices, normals), axis=1)
    if not template.order:
        rows = _ascii_rows(template, values, columns)
    else:
        rows = _binary_rows(template, values, columns)
    return _floating_header(template) + rows + template.after


def _ascii_rows(template: Template, values: Float, columns: list[int]) -> bytes:
    read = np.concatenate((template.vertices, template.normals.reshape(len(values), -1)), axis=1)
    lines = [line for line in template.rows.split(b"\n") if line.strip()]
    for number in np.flatnonzero((values != read).any(axis=1)).tolist():
        words = lines[number].split()
        for column, value in zip(columns, values[number].tolist(), strict=True):
            words[column] = b"%.10g" % value
        lines[number] = b" ".join(words) + (b"\r" if lines[number].endswith(b"\r") else b"")
    return b"".join(line + b"\n" for line in lines)


def _binary_rows(template: Template, values: Float, columns: list[int]) -> bytes:
    old = np.frombuffer(template.rows, template.vertex.dtype(template.order))
    new = np.empty(len(old), _floating(template.vertex).dtype(template.order))
    assert old.dtype.names is not None
    for name in old.dtype.names:
        new[name] = old[name]
    for column, value in zip(columns, values.T, strict=True):
        with np.errstate(over="ignore"):
            new[f"p{column}"] = value
        if not np.isfinite(new[f"p{column}"]).all():
            raise FemorsError("coordinates are too large for the number type of the PLY file")
    return new.tobytes()


def _floating(vertex: Element) -> Element:
    """Return the element with x, y, z that can hold fractions."""
    properties = (
        dataclasses.replace(p, type="f4") if p.name in ("x", "y", "z") and p.type[0] != "f" else p
        for p in vertex.properties
    )
    return dataclasses.replace(vertex, properties=tuple(properties))


def _floating_header(template: Template) -> bytes:
    """Return all before the vertex rows; coordinates that were whole numbers become floats."""
    if _floating(template.vertex) == template.vertex:
        return template.before
    end = END.search(template.before)
    assert end is not None
    head = re.split(rb"(?m)^(?=element\b)", template.before[: end.end()])
    whole = re.compile(rb"(?m)^(\s*property\s+)(?:" + "|".join(INTEGERS).encode() + rb")(\s+[xyz]\s*)$")
    for i, part in enumerate(head):
        if part.split()[1:2] == [b"vertex"]:
            head[i] = whole.sub(rb"\1float\2", part)
    return b"".join(head) + template.before[end.end() :]


def _build_plain(vertices: Float, sizes: Int, corners: Int) -> bytes:
    counter = ("u1", "uchar") if len(sizes) == 0 or sizes.max() < 256 else ("<i4", "int")
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment FEMORS\nelement vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(sizes)}\nproperty list {counter[1]} int vertex_indices\nend_header\n"
    )
    with np.errstate(over="ignore"):
        rows = vertices.astype("<f4")
    if not np.isfinite(rows).all():
        raise FemorsError("coordinates are too large for the single precision of PLY")
    return header.encode() + rows.tobytes() + _face_rows(sizes, corners, np.dtype(counter[0]))


def _face_rows(sizes: Int, corners: Int, counter: np.dtype) -> bytes:
    """Return each polygon's length and its corners, as bytes in the order of the file."""
    lengths = np.asarray(sizes, dtype=np.int64)
    width = counter.itemsize + 4 * lengths
    start = np.cumsum(width) - width
    out = np.zeros(int(width.sum()), dtype=np.uint8)
    heads = lengths.astype(counter).view(np.uint8).reshape(-1, counter.itemsize)
    out[start[:, None] + np.arange(counter.itemsize)] = heads
    step = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    first = np.repeat(start + counter.itemsize, lengths) + 4 * step
    out[first[:, None] + np.arange(4)] = corners.astype("<i4").view(np.uint8).reshape(-1, 4)
    return out.tobytes()
