# SPDX-License-Identifier: GPL-3.0-or-later
"""The syntax of Nastran bulk data: cards and their fields, free, small and large."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Container

import numpy as np

from .files import shown
from .inp_syntax import Source

_REAL = re.compile(r"([+-]?)([0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD]?([+-][0-9]{1,3})|[eEdD]([0-9]{1,3}))?")
WHOLE = re.compile(r"[0-9]{1,15}")


@dataclasses.dataclass(frozen=True, eq=False)
class Card:
    """A card: its upper-case name, its data fields, and its bytes in the file."""

    name: str
    fields: list[str]
    start: int
    stop: int

    def field(self, index: int) -> str:
        """Return a data field, from 0; "" where the card is shorter."""
        return self.fields[index] if index < len(self.fields) else ""


def cards_of(source: Source, names: Container[str]) -> list[Card]:
    """Return the cards of the bulk data that have one of the names."""
    data = source.data
    begin = re.search(rb"^[ \t]*BEGIN[ \t]+BULK[^\n]*\n", data, re.MULTILINE | re.IGNORECASE)
    start = begin.end() if begin else 0
    out: list[Card] = []
    lines: list[str] = []
    first = last = start
    for end in _ends(data, start):
        text = data[start:end].decode("latin-1").rstrip("\r\n")
        plain = text.strip()
        if plain and not plain.startswith("$"):
            if plain[:7].upper() == "ENDDATA":
                break
            if text[0] in "+*, \t" and lines:
                lines.append(text)
            else:
                _add(out, lines, first, last, names)
                lines, first = [text], start
            last = end
        start = end
    _add(out, lines, first, last, names)
    return out


def _ends(data: bytes, start: int) -> list[int]:
    """Where each line from `start` on ends, its newline included."""
    newlines = np.flatnonzero(np.frombuffer(data, np.uint8)[start:] == 10) + start + 1
    ends: list[int] = newlines.tolist()
    return ends if ends and ends[-1] == len(data) else [*ends, len(data)]


def _add(out: list[Card], lines: list[str], start: int, stop: int, names: Container[str]) -> None:
    """Add the card that lines make, at these bytes."""
    if not lines:
        return
    head = re.split(r"[,\s*]", lines[0].lstrip(), maxsplit=1)[0].upper()
    if head in names:
        fields = [field for line in lines for field in _fields(line)]
        out.append(Card(head, fields, start, stop))


def _fields(line: str) -> list[str]:
    """Return a line's data fields: eight, or four of a line in large fields; a comment may follow them."""
    line = line.partition("$")[0]
    if "," in line:
        parts = [part.strip() for part in line.split(",")]
        count = 4 if "*" in parts[0] else 8
        return (parts[1 : 1 + count] + [""] * count)[:count]
    line = line.expandtabs(8)
    if "*" in line[:8]:
        return [line[8 + 16 * i : 24 + 16 * i].strip() for i in range(4)]
    return [line[8 + 8 * i : 16 + 8 * i].strip() for i in range(8)]


def whole(source: Source, card: Card, index: int, what: str) -> int:
    """Return the whole number, from 1, in a field; `what` it should be."""
    text = card.field(index)
    if WHOLE.fullmatch(text) is None or int(text) < 1:
        raise source.error(card.start, f"{what} was expected, not '{shown(text.encode())}'")
    return int(text)


def real(source: Source, card: Card, index: int) -> float:
    """Return a real number in one of Nastran's spellings: 7.0, .7E1, 70.-1."""
    text = card.field(index)
    if not text:
        return 0.0
    match = _REAL.fullmatch(text)
    value = np.inf
    if match is not None:
        value = float(f"{match[1]}{match[2]}e{match[3] or match[4] or 0}")
    if not np.isfinite(value):
        raise source.error(card.start, f"a coordinate was expected, not '{shown(text.encode())}'")
    return value


def written(name: str, values: list[int]) -> str:
    """Return a card of whole numbers, in large fields where a small one cannot hold them all."""
    large = any(len(str(value)) > 8 for value in values)
    per_line, width = (4, 16) if large else (8, 8)
    rows = [values[i : i + per_line] for i in range(0, len(values), per_line)]
    first, more = (f"{name}*", "*") if large else (name, "+")
    heads = [first, *[more] * (len(rows) - 1)]
    return "\n".join(
        head.ljust(8) + "".join(f"{value:<{width}}" for value in row)
        for head, row in zip(heads, rows, strict=True)
    )
