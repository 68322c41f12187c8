# SPDX-License-Identifier: GPL-3.0-or-later
"""STL, binary and ASCII: bytes to arrays and back.

Every triangle brings its own three vertices, in file order: nothing is merged here.
"""

from __future__ import annotations

import dataclasses
import re

import numpy as np
from numpy.typing import NDArray

from .files import BadNumber, floats, looks_like_text, shown
from .mesh import Float, Int, triangulate
from .progress import FemorsError
from .triples import unit

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
HEADER = 84


@dataclasses.dataclass(frozen=True, eq=False)
class Template:
    """What an STL file holds beside its coordinates.

    Attributes
    ----------
    header : bytes
        The 80 bytes of a binary file's header.
    attributes : (m,) uint16
        A binary file's "attribute byte count" of each triangle (colours, with some programs).
    solids : tuple of (bytes, int)
        For ASCII: each solid's name and its number of triangles; empty for a binary file.
    """

    header: bytes
    attributes: NDArray[np.uint16]
    solids: tuple[tuple[bytes, int], ...] = ()


def parse(data: bytes) -> tuple[Float, Int, Int, Template]:
    """Return (vertices (3m, 3), sizes (m,), corners (3m,), template) of an STL file's bytes.

    A file is binary when its length is what its triangle count says, whatever its first word is.

    Raises
    ------
    FemorsError
        Neither a binary nor an ASCII STL, a truncated file, no triangles, a malformed number.
    """
    count = int.from_bytes(data[80:HEADER], "little")
    if len(data) == HEADER + RECORD.itemsize * count and len(data) >= HEADER:
        corners, template = _parse_binary(data)
    elif data.removeprefix(b"\xef\xbb\xbf").lstrip()[:5].lower() == b"solid" and looks_like_text(data):
        corners, template = _parse_ascii(data)
    elif data[:4] in (b"ply\n", b"ply\r"):
        raise FemorsError("is a PLY file by its first line; give it the ending .ply")
    elif looks_like_text(data):
        raise FemorsError("is text but not an STL file, whose text starts with 'solid'")
    elif len(data) < HEADER:
        raise FemorsError(f"is not an STL file: {len(data)} bytes, and a binary one has at least {HEADER}")
    else:
        expected = HEADER + RECORD.itemsize * count
        what = "is a truncated" if len(data) < expected else "is not a proper"
        told = f"{count} triangles are announced, which take {expected} bytes"
        raise FemorsError(f"{what} binary STL: {told}, and it has {len(data)}")
    if len(corners) == 0:
        raise FemorsError("has no triangles")
    vertices = corners.reshape(-1, 3)
    sizes = np.full(len(corners), 3, dtype=np.int32)
    return vertices, sizes, np.arange(len(vertices), dtype=np.int32), template


def called(index: int) -> str:
    """Return how a vertex is found in an STL file, which numbers none."""
    return f"corner {index % 3 + 1} of triangle {index // 3 + 1}, counted from 1"


def _parse_binary(data: bytes) -> tuple[Float, Template]:
    records = np.frombuffer(data, RECORD, offset=HEADER)
    return records["corners"].astype(np.float64), Template(data[:80], records["attribute"].copy())


# --- ASCII ----------------------------------------------------------------------------------------
_VERTEX = rb"\s+vertex\s+(\S+)\s+(\S+)\s+(\S+)"
_FACET = re.compile(
    rb"\s*facet\s+normal\s+\S+\s+\S+\s+\S+\s+outer\s+loop" + 3 * _VERTEX + rb"\s+endloop\s+endfacet(?!\S)",
    re.IGNORECASE,
)
_SOLID = re.compile(rb"\s*solid(?:[^\S\n]+([^\n]*))?(?=\n|$)", re.IGNORECASE)
_END = re.compile(rb"\s*endsolid(?!\S)[^\n]*", re.IGNORECASE)
_WORDS = (*b"facet normal . . . outer loop".split(), *3 * b"vertex . . .".split(), b"endloop", b"endfacet")


def _parse_ascii(data: bytes) -> tuple[Float, Template]:
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    tokens: list[bytes] = []
    starts: list[int] = []
    solids: list[tuple[bytes, int]] = []
    name: bytes | None = None  # of the solid that is open
    position = first = 0
    while True:
        if name is None and (solid := _SOLID.match(data, position)):
            name, first, position = (solid.group(1) or b"").strip(), len(starts), solid.end()
        elif name is not None and (facet := _FACET.match(data, position)):
            tokens.extend(facet.groups())
            starts.append(facet.start())
            position = facet.end()
        elif name is not None and (end := _END.match(data, position)):
            solids.append((name, len(starts) - first))
            name, position = None, end.end()
        elif name is None and not data[position:].strip():
            break
        else:
            raise _misplaced(data, position, _WORDS if name is not None else (b"solid",))
    try:
        corners = floats(tokens).reshape(-1, 3, 3)
    except BadNumber as error:
        broken = _FACET.match(data, starts[error.index // 9])
        assert broken is not None
        raise FemorsError(f"line {_line(data, broken.start(error.index % 9 + 1))}: {error}") from None
    return corners, Template(b"", np.zeros(len(corners), np.uint16), tuple(solids))


def _misplaced(data: bytes, position: int, words: tuple[bytes, ...]) -> FemorsError:
    """Say what stands where an ASCII STL should go on with `words`."""
    found = re.compile(rb"\S+")
    for word in words:
        expected = "a number" if word == b"." else f"'{word.decode()}'"
        token = found.search(data, position)
        if token is None:
            return FemorsError(f"line {_line(data, len(data))}: the text ends where {expected} should follow")
        if word not in (b".", token.group().lower()):
            what = f"{expected} was expected, not '{shown(token.group())}'"
            return FemorsError(f"line {_line(data, token.start())}: {what}")
        position = token.end()
    raise AssertionError("nothing is misplaced")


def _line(data: bytes, position: int) -> int:
    return data.count(b"\n", 0, position) + 1


# --- writing --------------------------------------------------------------------------------------
def build(vertices: Float, sizes: Int, corners: Int, template: Template | None) -> bytes:
    """Return an STL file's bytes: the template's variant, or binary where there is none."""
    triangles, _ = triangulate(sizes, corners)
    positions = vertices[triangles]
    records = np.zeros(len(positions), RECORD)
    with np.errstate(over="ignore"):
        records["corners"] = positions
    if not np.isfinite(records["corners"]).all():
        raise FemorsError("coordinates are too large for the single precision of STL")
    a, b, c = np.moveaxis(positions, 1, 0)
    records["normal"] = unit(np.cross(b - a, c - a))
    header = b"FEMORS"
    if template is not None:
        if template.solids:
            return _build_ascii(positions, records["normal"], template)
        records["attribute"], header = template.attributes, template.header
    if header.lstrip()[:5].lower() == b"solid":
        header = b"binary " + header  # or other programs take the file for an ASCII one
    return header[:80].ljust(80, b"\0") + len(records).to_bytes(4, "little") + records.tobytes()


def _build_ascii(positions: Float, normals: Float, template: Template) -> bytes:
    facet = (
        "facet normal %.7g %.7g %.7g\n  outer loop\n"
        + 3 * "    vertex %.10g %.10g %.10g\n"
        + "  endloop\nendfacet\n"
    )
    rows = np.concatenate((normals[:, None], positions), axis=1).reshape(len(positions), 12)
    rows += 0.0  # no "-0"
    parts: list[bytes] = []
    start = 0
    for name, count in template.solids:
        values = tuple(rows[start : start + count].ravel().tolist())
        body = (facet * count % values).encode()
        title = b" " + name if name else b""
        parts.append(b"".join((b"solid", title, b"\n", body, b"endsolid", title, b"\n")))
        start += count
    return b"".join(parts)
