# SPDX-License-Identifier: GPL-3.0-or-later
"""The syntax of Abaqus input files: keyword lines, comments and includes.

The bytes of every file are kept; whatever is read knows where it stands in them.
"""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Iterator
from pathlib import Path

from .deck import Load
from .files import shown
from .progress import FemorsError

MOST_INCLUDES = 1000
DEEPEST = 50  # includes within includes


@dataclasses.dataclass(eq=False)
class Source:
    """A file of a deck.

    Attributes
    ----------
    number : int
        Its place among the deck's files; one that is included twice counts twice.
    path : Path
    data : bytes
    spelled : str
        What *INCLUDE calls it; "" for the deck itself.
    comments : list of (int, int)
        Where comment lines start and end, line ends included, in order.
    """

    number: int
    path: Path
    data: bytes
    spelled: str = ""
    comments: list[tuple[int, int]] = dataclasses.field(default_factory=list)

    def error(self, offset: int, text: str) -> FemorsError:
        """Return an error that names the file and the line at a byte offset."""
        return FemorsError(f"{self.path}: line {self.line(offset)}: {text}")

    def line(self, offset: int) -> int:
        """Return the number of the line at a byte offset, from 1."""
        return self.data.count(b"\n", 0, offset) + 1

    def text(self, offset: int) -> bytes:
        """Return the line at a byte offset, without its newline."""
        end = self.data.find(b"\n", offset)
        return self.data[offset:] if end < 0 else self.data[offset:end]


@dataclasses.dataclass(eq=False)
class Keyword:
    """A keyword line and the data lines behind it.

    Attributes
    ----------
    name : str
        Upper case, single blanks: "NODE", "END PART".
    parameters : dict
        Upper-case names; values as spelled, without quotes, "" where a parameter has none.
    source : Source
    offset : int
        Where the keyword line starts.
    scope : str
        What its ids belong to; see `inp_scopes`.
    spans : list of (Source, int, int)
        Where its data lines stand: one span, or several where an include interrupts them.
    """

    name: str
    parameters: dict[str, str]
    source: Source
    offset: int
    scope: str = ""
    spans: list[tuple[Source, int, int]] = dataclasses.field(default_factory=list)

    def error(self, text: str) -> FemorsError:
        """Return an error that names the file and the line of the keyword."""
        return self.source.error(self.offset, text)

    def lines(self) -> Iterator[tuple[Source, int, list[bytes]]]:
        """Yield (source, offset, stripped fields) of each data line; for the short tables only."""
        for source, start, stop in self.spans:
            for offset in _line_starts(source, start, stop):
                text = source.text(offset).strip()
                if text and not text.startswith(b"**"):
                    yield source, offset, [field.strip() for field in text.split(b",")]


def _line_starts(source: Source, start: int, stop: int) -> Iterator[int]:
    while start < stop:
        yield start
        end = source.data.find(b"\n", start, stop)
        start = stop if end < 0 else end + 1


# --- keywords -------------------------------------------------------------------------------------
def keywords(path: Path, load: Load) -> tuple[list[Keyword], list[Source]]:
    """Return the keywords of a deck and its includes in order, and the files, the deck first.

    Raises
    ------
    FemorsError
        Not a text file, no keyword at its start, an include that is missing or includes itself.
    """
    walk = _Walk(load)
    walk.file(path, "", path.parent, ())
    return walk.keywords, walk.sources


class _Walk:
    """Goes through a deck and, where it stands, through each include."""

    def __init__(self, load: Load) -> None:
        self.keywords: list[Keyword] = []
        self.sources: list[Source] = []
        self._load = load
        self._data: dict[str, bytes] = {}

    def file(self, path: Path, spelled: str, folder: Path, above: tuple[str, ...]) -> None:
        real = os.path.realpath(path)
        if real not in self._data:
            self._data[real] = _text(path, self._load(path))
        source = Source(len(self.sources), path, self._data[real], spelled)
        self.sources.append(source)
        for start, stop, is_keyword in _pieces(source):
            if not is_keyword:
                self._lines(source, start, stop)
                continue
            keyword = _keyword(source, start, stop)
            if keyword.name != "INCLUDE":
                self.keywords.append(keyword)
                continue
            if len(self.sources) > MOST_INCLUDES:
                raise keyword.error(f"more than {MOST_INCLUDES} includes are not read")
            name = keyword.parameters.get("INPUT", "")
            inner = _included(name, keyword, folder)
            if len(above) >= DEEPEST:
                raise keyword.error(f"includes are nested more than {DEEPEST} deep")
            if os.path.realpath(inner) in (*above, real):
                raise keyword.error(f"'{name}' includes itself")
            self.file(inner, name, folder, (*above, real))

    def _lines(self, source: Source, start: int, stop: int) -> None:
        if self.keywords:
            self.keywords[-1].spans.append((source, start, stop))
            return
        for offset in _line_starts(source, start, stop):
            text = source.text(offset).strip()
            if text and not text.startswith(b"**"):
                raise source.error(offset, f"a keyword line (*...) was expected, not '{shown(text)}'")


def _text(path: Path, data: bytes) -> bytes:
    zero = data.find(b"\0")
    if zero >= 0:
        raise FemorsError(f"{path}: is not an Abaqus input file but binary (a zero byte at {zero})")
    if b"\n" not in data and b"\r" in data:
        raise FemorsError(
            f"{path}: its lines end with carriage returns alone; save it with the usual line ends"
        )
    return data


def _included(name: str, keyword: Keyword, folder: Path) -> Path:
    """Return the path of an include: from the deck's folder, else from that of the file that names it."""
    if not name:
        raise keyword.error("*INCLUDE needs INPUT= and a file name")
    spellings = [name, name.replace("\\", "/")]
    for spelling in spellings:
        for base in (folder, keyword.source.path.parent):
            try:
                if (base / spelling).exists():
                    return base / spelling
            except (OSError, ValueError):  # a name that no file can have
                continue
    raise keyword.error(f"the include '{name[:80]}' is not there (looked for in {folder})")


def _pieces(source: Source) -> Iterator[tuple[int, int, bool]]:
    """Yield (start, stop, whether it is a keyword line) for keyword lines and the lines between them."""
    data, lines = source.data, 3 if source.data.startswith(b"\xef\xbb\xbf") else 0
    position = lines
    while (star := data.find(b"*", position)) >= 0:
        start = max(data.rfind(b"\n", position, star) + 1, position)
        stop = next_line(data, star)
        if not data[start:star].strip():
            if data[star + 1 : star + 2] == b"*":
                source.comments.append((start, stop))
            else:
                if start > lines:
                    yield lines, start, False
                stop = _continued(data, stop)
                yield start, stop, True
                lines = stop
        position = stop
    if lines < len(data):
        yield lines, len(data), False


def next_line(data: bytes, position: int) -> int:
    end = data.find(b"\n", position)
    return len(data) if end < 0 else end + 1


def _continued(data: bytes, stop: int) -> int:
    """Return where a keyword line ends that a comma continues on the next lines."""
    while data[max(stop - 256, 0) : stop].rstrip().endswith(b","):
        following = next_line(data, stop)
        # a comma left at the end of the line before a table continues nothing
        if re.match(rb"\s*[A-Za-z\"]", data[stop:following]) is None:
            break
        stop = following
    return stop


_PARAMETER = re.compile(r",\s*(?:\"[^\"]*\"|([^=,]*?))\s*(?:=\s*(?:\"([^\"]*)\"|([^,]*)))?\s*(?=,|$)")


def _keyword(source: Source, start: int, stop: int) -> Keyword:
    text = _decoded(source.data[start:stop]).strip()
    name, comma, rest = text.partition(",")
    parameters = {}
    for match in _PARAMETER.finditer(comma + " ".join(rest.split())):
        if match[1]:
            value = match[2] if match[2] is not None else match[3]
            parameters["".join(match[1].split()).upper()] = (value or "").strip()
    return Keyword(" ".join(name[1:].split()).upper(), parameters, source, start)


def _decoded(text: bytes) -> str:
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        return text.decode("latin-1")
