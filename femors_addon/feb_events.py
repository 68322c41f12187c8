# SPDX-License-Identifier: GPL-3.0-or-later
"""The mesh section of an FEBio file, found in one pass over its XML: what stands where, in bytes."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple
from xml.parsers import expat

from .progress import FemorsError

SECTIONS = ("Mesh", "Geometry")  # as of specification 3; before
GROUPS = ("Nodes", "Elements", "NodeSet", "ElementSet", "Surface")


class Row(NamedTuple):
    """An element such as <node>: its id as spelled, its byte, and where its text starts and ends."""

    id: str
    offset: int
    start: int
    stop: int


@dataclasses.dataclass(eq=False)
class Group:
    """An element such as <Nodes>: its attributes, its rows, and its own text."""

    name: str
    label: str
    type: str
    material: str
    rows: list[Row] = dataclasses.field(default_factory=list)
    text: list[str] = dataclasses.field(default_factory=list)


def line_of(data: bytes, offset: int) -> int:
    """Return the number of the line at a byte, from 1."""
    return data.count(b"\n", 0, offset) + 1


def mesh_groups(data: bytes) -> tuple[list[Group], str]:
    """Return the groups of nodes, elements, sets and surfaces, and the specification.

    Entities and external files are never resolved: a DOCTYPE is refused.

    Raises
    ------
    FemorsError
        Not XML, not an FEBio file, a mesh that stands in another file.
    """
    if b"\0" in data:
        raise FemorsError("is not an FEBio file but binary, or text in UTF-16; save it as UTF-8")
    events = _Events(data)
    try:
        events.parser.Parse(data, True)
    except expat.ExpatError as error:
        raise FemorsError(
            f"line {error.lineno}: is not proper XML ({expat.ErrorString(error.code)})"
        ) from None
    except (ValueError, LookupError) as error:
        if isinstance(error, FemorsError):
            raise
        raise FemorsError(f"is in an encoding that is not known ({error}); save it as UTF-8") from None
    return events.groups, events.spec


class _Events:
    """Handlers of the parser; depth 1 is the root, 2 its sections, 3 groups, 4 rows."""

    def __init__(self, data: bytes) -> None:
        self.groups: list[Group] = []
        self.spec = ""
        self._data = data
        self._depth = 0
        self._mesh = False
        self._group: Group | None = None
        self._id, self._offset, self._start = "", 0, -1
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self._begin
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._text
        self.parser.StartDoctypeDeclHandler = self._doctype

    def _error(self, text: str) -> FemorsError:
        return FemorsError(f"line {self.parser.CurrentLineNumber}: {text}")

    def _doctype(self, *_: object) -> None:
        raise self._error("has a DOCTYPE, which no FEBio file needs; remove it")

    def _begin(self, name: str, attributes: dict[str, str]) -> None:
        self._depth += 1
        if self._depth == 4:
            if self._group is not None:
                self._id = attributes.get("id", "")
                self._offset, self._start = self.parser.CurrentByteIndex, -1
        elif self._depth == 3:
            if self._mesh and name in GROUPS:
                label = attributes.get("name", attributes.get("elset", ""))
                self._group = Group(name, label, attributes.get("type", ""), attributes.get("mat", ""))
                self.groups.append(self._group)
        elif self._depth == 2:
            self._mesh = name in SECTIONS
            if self._mesh and "from" in attributes:
                raise self._error(f"its mesh stands in the file '{attributes['from']}'; open that one")
        elif self._depth == 1:
            if name != "febio_spec":
                raise self._error(f"<febio_spec> was expected, not <{name[:30]}>")
            self.spec = attributes.get("version", "")

    def _text(self, text: str) -> None:
        if self._group is not None:
            if self._depth == 4 and self._start < 0:
                self._start = self.parser.CurrentByteIndex
            elif self._depth == 3:
                self._group.text.append(text)

    def _end(self, name: str) -> None:
        if self._group is not None:
            if self._depth == 4:
                stop = self.parser.CurrentByteIndex
                start = stop if self._start < 0 else self._start
                self._group.rows.append(Row(self._id, self._offset, start, stop))
            elif self._depth == 3:
                self._group = None
        self._depth -= 1
