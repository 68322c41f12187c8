# SPDX-License-Identifier: GPL-3.0-or-later
"""Legacy VTK files of surfaces (POLYDATA), which meshio does not read: triangles and quads as shells.

Versions 2 to 5.1, text and binary. Only the coordinates of nodes that moved change; all other bytes,
point and cell data among them, stay.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .deck import Deck, Load, OneFile, Part
from .files import read_bytes, require_finite
from .mesh import Float, Int
from .progress import FemorsError, counted
from .volume import Block, VolumeMesh

_HEAD = re.compile(
    rb"\s*# vtk DataFile Version[^\n]*\n[^\n]*\n\s*(ASCII|BINARY)\s*\n\s*DATASET\s+POLYDATA\s*\n", re.I
)
_LINE = re.compile(rb"\s*([A-Za-z_]+)([^\n]*)\n")
_WORD = re.compile(rb"\S+")
_TEXT_END = re.compile(rb"^[ \t]*[A-Za-z_]", re.MULTILINE)
_TYPES = {
    "float": ">f4",
    "double": ">f8",
    "int": ">i4",
    "vtkidtype": ">i4",
    "vtktypeint64": ">i8",
    "long": ">i8",
}
_DATA = {"POINT_DATA", "CELL_DATA"}


@dataclasses.dataclass(frozen=True, eq=False)
class Template(OneFile):
    """A file, where its coordinates stand, and what they are."""

    path: Path
    data: bytes
    start: int
    stop: int
    dtype: str
    text: bool
    nodes: Float

    def encoded(self, nodes: Float) -> bytes:
        """Return the file's bytes with the coordinates that changed."""
        changed = (nodes != self.nodes).ravel()
        if not changed.any():
            return self.data
        section = self.data[self.start : self.stop]
        if not self.text:
            values = np.frombuffer(section, self.dtype).copy()
            values[changed] = nodes.ravel()[changed]
            return self.data[: self.start] + values.tobytes() + self.data[self.stop :]
        single = self.dtype == ">f4"
        parts, done = [self.data[: self.start]], 0
        for number, word in enumerate(_WORD.finditer(section)):
            if changed[number]:
                value = float(nodes.flat[number])
                parts += [section[done : word.start()], (f"{value:.9g}" if single else repr(value)).encode()]
                done = word.end()
        return b"".join([*parts, section[done:], self.data[self.stop :]])


def is_polydata(data: bytes) -> bool:
    """Whether a file's bytes begin as those of a legacy VTK surface do."""
    return _HEAD.match(data) is not None


def read(path: Path, load: Load = read_bytes) -> Deck:
    """Read a surface; arguments and errors as for `inp.read`."""
    data = load(path)
    try:
        reader = _Reader(data)
        polygons = reader.polygons()
        if reader.points is None or polygons is None:
            raise FemorsError("has no POINTS or no POLYGONS; a surface is needed")
        start, stop, dtype = reader.points
        nodes = reader.numbers(start, stop, dtype).astype(np.float64).reshape(-1, 3)
        require_finite(nodes, "points", called)
        blocks = _blocks(*polygons, len(nodes))
        mesh = VolumeMesh(nodes, tuple(blocks), np.arange(1, len(nodes) + 1))
    except FemorsError as error:
        raise FemorsError(f"{path}: {error}") from None
    part = Part(path.stem, mesh.used_nodes, np.arange(mesh.element_count, dtype=np.int32))
    template = Template(path, data, start, stop, dtype, reader.text, mesh.nodes)
    return Deck(path, ".vtk", mesh, {path.stem: part}, template)


def called(index: int) -> str:
    """Return what a VTK file calls a point: cells count from 0."""
    return f"point {index}, counted from 0"


def _blocks(offsets: NDArray[np.int64], corners: NDArray[np.int64], count: int) -> list[Block]:
    """Return the polygons as blocks of shells, in the order of the file as far as kinds allow."""
    sizes = np.diff(offsets)
    other = int(((sizes < 3) | (sizes > 4)).sum())
    if other:
        raise FemorsError(
            f"{counted(other, 'polygon has', 'polygons have')} neither three nor four corners; "
            "triangulate first"
        )
    if not len(sizes):
        raise FemorsError("has no polygons")
    if len(corners) and (corners.min() < 0 or corners.max() >= count):
        raise FemorsError("a polygon names a point that the file does not have")
    blocks = []
    for size, kind in ((3, "tri3"), (4, "quad4")):
        mine = np.flatnonzero(sizes == size)
        if len(mine):
            rows: Int = corners[offsets[mine, None] + np.arange(size)].astype(np.int32)
            blocks.append(Block(kind, rows, mine + 1))
    return blocks


class _Reader:
    """Walks through a file's sections; `points` is (start, stop, type) once they were met."""

    def __init__(self, data: bytes) -> None:
        head = _HEAD.match(data)
        if head is None:
            raise FemorsError("is no legacy VTK file of a surface (DATASET POLYDATA)")
        self._data, self._at = data, head.end()
        self.text = head[1].upper() == b"ASCII"
        self.points: tuple[int, int, str] | None = None

    def polygons(self) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
        """Walk to the end of the geometry; return (offsets, corners) of the polygons."""
        found = None
        while (line := _LINE.match(self._data, self._at)) is not None:
            word, rest = line[1].decode("latin-1").upper(), line[2].decode("latin-1").split()
            if word in _DATA:
                break
            self._at = line.end()
            if word == "METADATA":
                end = re.compile(rb"\n[ \t\r]*\n").search(self._data, self._at - 1)
                self._at = len(self._data) if end is None else end.end()
            elif word == "FIELD":
                self._skip_field(_whole(rest, 1))
            elif word == "POINTS":
                dtype = _TYPES.get(rest[1].lower(), "") if len(rest) > 1 else ""
                if dtype not in (">f4", ">f8"):
                    raise FemorsError(f"POINTS are of type '{' '.join(rest[1:])}'; float or double is needed")
                self.points = (*self._section(3 * _whole(rest, 0), dtype), dtype)
            elif word in ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS"):
                cells = self._cells(_whole(rest, 0), _whole(rest, 1))
                found = cells if word == "POLYGONS" else found
            else:
                raise FemorsError(f"a section '{word}' is not known")
        return found

    def numbers(self, start: int, stop: int, dtype: str) -> NDArray:
        """Return the numbers of a section."""
        part = self._data[start:stop]
        if not self.text:
            return np.frombuffer(part, dtype)
        try:
            return np.array(part.split(), dtype=np.float64 if dtype[1] == "f" else np.int64)
        except (ValueError, OverflowError):
            raise FemorsError("has a word where a number was expected") from None

    def _section(self, count: int, dtype: str) -> tuple[int, int]:
        """Step over so many numbers; return where they start and stop."""
        start = self._at
        if self.text:
            end = _TEXT_END.search(self._data, start)
            stop = len(self._data) if end is None else end.start()
            if len(self._data[start:stop].split()) != count:
                raise FemorsError(f"{count} numbers were announced, and others stand there")
        else:
            stop = start + count * np.dtype(dtype).itemsize
            if stop > len(self._data):
                raise FemorsError(f"{count} numbers were announced, and the file ends before")
        self._at = stop
        return start, stop

    def _cells(self, count: int, size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Read cells, as offsets and connectivity (5.1) or as counts and corners (before)."""
        line = _LINE.match(self._data, self._at)
        if line is not None and line[1].upper() == b"OFFSETS":
            arrays = []
            for length in (count, size):
                line = _LINE.match(self._data, self._at)
                dtype = "" if line is None else _TYPES.get(line[2].decode("latin-1").strip().lower(), "")
                if line is None or not dtype:
                    raise FemorsError("OFFSETS and CONNECTIVITY of whole numbers were expected")
                self._at = line.end()
                arrays.append(self.numbers(*self._section(length, dtype), dtype).astype(np.int64))
            offsets, corners = arrays
            if len(offsets) and (
                offsets[0] != 0 or offsets[-1] != len(corners) or (np.diff(offsets) < 0).any()
            ):
                raise FemorsError("the OFFSETS of its cells do not fit their CONNECTIVITY")
            return offsets, corners
        values = self.numbers(*self._section(size, ">i4"), ">i4").astype(np.int64)
        starts, at = [], 0
        for _ in range(count):
            if at >= len(values) or values[at] < 0:
                raise FemorsError("the counts of its cells do not fit their number")
            starts.append(at)
            at += 1 + int(values[at])
        if at != len(values):
            raise FemorsError("the counts of its cells do not fit their number")
        keep = np.ones(len(values), dtype=bool)
        keep[starts] = False
        return np.cumsum([0, *values[starts].tolist()]).astype(np.int64), values[keep]

    def _skip_field(self, count: int) -> None:
        """Step over the arrays of a FIELD."""
        for _ in range(count):
            line = _LINE.match(self._data, self._at)
            words = [] if line is None else line[2].decode("latin-1").split()
            dtype = _TYPES.get(words[2].lower(), "") if len(words) > 2 else ""
            if line is None or not dtype:
                raise FemorsError("a FIELD of plain numbers was expected")
            self._at = line.end()
            self._section(_whole(words, 0) * _whole(words, 1), dtype)


def _whole(words: list[str], number: int) -> int:
    try:
        value = int(words[number])
    except (IndexError, ValueError):
        raise FemorsError(f"a whole number was expected in '{' '.join(words)}'") from None
    if value < 0:
        raise FemorsError(f"{value} is no count")
    return value
