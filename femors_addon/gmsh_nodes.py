# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the nodes of a Gmsh file stand, so that they can be moved in place.

meshio's reader is used for the elements, but not its writer: it numbers everything afresh, and it
mixes up element data of several types (format 2.2). Here all bytes but coordinates are kept.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .fields import spliced
from .mesh import Float
from .volume_faces import Ids

_FORMAT = re.compile(rb"\$MeshFormat\s+(\S+)\s+([01])\s+([48])[^\n]*\n")
_DATA = re.compile(
    rb"^\$((?:Node|Element|ElementNode)Data)\b.*?^\$End\1[^\n]*(?:\n|\Z)", re.MULTILINE | re.DOTALL
)
_ROW = re.compile(rb"([ \t]*\S+[ \t]+)?(\S+)([ \t]+)(\S+)([ \t]+)([^\s]+)")


@dataclasses.dataclass(frozen=True, eq=False)
class NodePlaces:
    """The nodes of a Gmsh file.

    Attributes
    ----------
    ids : (n,) int64
        Node tags, in the order of the file.
    positions : (n, 3) float64
    spans : (n, 2) int64
        Where each one's x, y, z start and end, as text, or as three binary numbers.
    text : bool
    """

    ids: Ids
    positions: Float
    spans: NDArray[np.int64]
    text: bool

    def moved(self, data: bytes, nodes: Float) -> bytes:
        """Return the file's bytes with the nodes at other positions (n, 3)."""
        if not self.text:
            out = np.frombuffer(data, np.uint8).copy()
            out[self.spans[:, :1] + np.arange(24)] = nodes.astype("<f8").view(np.uint8).reshape(-1, 24)
            return out.tobytes()
        return spliced(data, self._rows(data, nodes))

    def _rows(self, data: bytes, nodes: Float) -> Iterator[tuple[int, int, bytes]]:
        """Where the coordinates of each node that moved start and end, and what they are to be."""
        for index in np.flatnonzero((nodes != self.positions).any(axis=1)).tolist():
            start, stop = self.spans[index].tolist()
            match = _ROW.fullmatch(data, start, stop)
            assert match is not None
            new = [
                repr(value).encode() if value != old else match[group]
                for group, value, old in zip(
                    (2, 4, 6), nodes[index].tolist(), self.positions[index].tolist(), strict=True
                )
            ]
            yield start, stop, new[0] + match[3] + new[1] + match[5] + new[2]


def without_data(data: bytes) -> bytes:
    """Return a Gmsh file without its data sections, which no element depends on."""
    return _DATA.sub(b"", data)


def node_places(data: bytes) -> NodePlaces | None:
    """Find the nodes of a file of format 2 or 4.1, text or (little-endian) binary; None in any other."""
    form = _FORMAT.search(data[:10_000])
    begin = re.search(rb"^\$Nodes[ \t\r]*\n", data, re.MULTILINE)
    if form is None or begin is None:
        return None
    version = form[1].decode("latin-1")
    try:
        if form[2] == b"1":
            spans, ids = (_binary2 if version[0] == "2" else _binary4)(data, begin.end(), int(form[3]))
        else:
            spans, ids = (_text2 if version[0] == "2" else _text4)(data, begin.end())
        if version[0] not in "24" or version == "4.0":
            return None
        return _checked(data, spans, ids, form[2] == b"0")
    except (ValueError, IndexError, AttributeError, OverflowError):
        return None  # something else than expected: meshio has the last word


def _checked(data: bytes, spans: NDArray[np.int64], ids: Ids, text: bool) -> NodePlaces:
    if text:
        rows = [data[start:stop].split() for start, stop in spans.tolist()]
        positions = np.array([[float(field) for field in row] for row in rows])
    else:
        raw = np.frombuffer(data, np.uint8)[spans[:, :1] + np.arange(24)]
        positions = np.ascontiguousarray(raw).view("<f8").astype(np.float64)
    if positions.shape != (len(ids), 3):
        raise ValueError("no three coordinates")
    return NodePlaces(ids, positions, spans, text)


def _line(data: bytes, start: int) -> tuple[bytes, int]:
    """Return the line at a byte, and where the next one starts."""
    end = data.index(b"\n", start)
    return data[start:end], end + 1


def _text2(data: bytes, at: int) -> tuple[NDArray[np.int64], Ids]:
    head, at = _line(data, at)
    spans, ids = [], []
    for _ in range(int(head)):
        row, next_ = _line(data, at)
        fields = row.split()
        ids.append(int(fields[0]))
        start = at + row.index(fields[0]) + len(fields[0])
        start += len(data[start:next_]) - len(data[start:next_].lstrip())
        spans.append((start, at + len(row.rstrip())))
        at = next_
    return np.array(spans, np.int64), np.array(ids, np.int64)


def _text4(data: bytes, at: int) -> tuple[NDArray[np.int64], Ids]:
    head, at = _line(data, at)
    spans: list[tuple[int, int]] = []
    ids: list[int] = []
    for _ in range(int(head.split()[0])):
        head, at = _line(data, at)
        count = int(head.split()[3])
        for _ in range(count):
            row, at = _line(data, at)
            ids.append(int(row))
        for _ in range(count):
            row, next_ = _line(data, at)
            spans.append((at + len(row) - len(row.lstrip()), at + len(row.rstrip())))
            at = next_
    return np.array(spans, np.int64), np.array(ids, np.int64)


def _binary2(data: bytes, at: int, size: int) -> tuple[NDArray[np.int64], Ids]:
    head, at = _line(data, at)
    records = np.frombuffer(data, [("id", "<i4"), ("x", "<f8", 3)], int(head), at)
    starts = at + 4 + 28 * np.arange(len(records), dtype=np.int64)
    return np.column_stack((starts, starts + 24)), records["id"].astype(np.int64)


def _binary4(data: bytes, at: int, size: int) -> tuple[NDArray[np.int64], Ids]:
    whole = f"<u{size}"
    blocks = int(np.frombuffer(data, whole, 4, at)[0])
    at += 4 * size
    starts, ids = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for _ in range(blocks):
        count = int(np.frombuffer(data, whole, 1, at + 12)[0])
        at += 12 + size
        ids.append(np.frombuffer(data, whole, count, at).astype(np.int64))
        at += size * count
        starts.append(at + 24 * np.arange(count, dtype=np.int64))
        at += 24 * count
    start = np.concatenate(starts)
    return np.column_stack((start, start + 24)), np.concatenate(ids)
