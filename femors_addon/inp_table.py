# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of numbers in Abaqus input files, read in large pieces, and where each line stands."""

from __future__ import annotations

import bisect
import dataclasses
import re

import numpy as np
from numpy.typing import NDArray

from .files import shown
from .inp_syntax import Keyword, Source, next_line

CHUNK = 1 << 20  # bytes that are looked at in one go
LONGEST = 1 << 20  # bytes of a line; Abaqus reads 256


@dataclasses.dataclass(frozen=True, eq=False)
class Table:
    """The numbers of a keyword's data lines.

    Attributes
    ----------
    values : (t,) float64 or int64
        All numbers, one line after the other.
    counts : (l,) int64
        How many stand on each line; lines without any are left out.
    offsets : (l,) int64
        Where each line starts in its file.
    files : (l,) uint16
        Number of that file.
    open : (l,) bool
        Whether the line ends with a comma.
    """

    values: NDArray
    counts: NDArray[np.int64]
    offsets: NDArray[np.int64]
    files: NDArray[np.uint16]
    open: NDArray[np.bool_]


def table(keyword: Keyword, dtype: type) -> Table:
    """Return the numbers of a keyword's data lines; empty fields are 0 among float64, refused among int64.

    Raises
    ------
    FemorsError
        A field that is not a number (or not a whole one).
    """
    parts = []
    for source, start, stop in keyword.spans:
        while start < stop:
            end = stop
            if stop - start > CHUNK:
                end = source.data.rfind(b"\n", start, start + CHUNK) + 1 or next_line(
                    source.data, start + CHUNK
                )
            if end - start > max(CHUNK, LONGEST):
                raise source.error(start, f"a line of {end - start} bytes is not read")
            values, counts, offsets, open_ = _chunk(source, start, end, dtype)
            parts.append(
                Table(values, counts, offsets, np.full(len(counts), source.number, np.uint16), open_)
            )
            start = end
    if len(parts) == 1:
        return parts[0]
    empty = Table(np.zeros(0, dtype), *(np.zeros(0, kind) for kind in (np.int64, np.int64, np.uint16, bool)))
    names = [field.name for field in dataclasses.fields(Table)]
    return Table(*(np.concatenate([getattr(part, name) for part in (empty, *parts)]) for name in names))


def _chunk(
    source: Source, start: int, stop: int, dtype: type
) -> tuple[NDArray, NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Return (values, counts, offsets, open) of whole lines."""
    text = np.frombuffer(source.data, np.uint8, stop - start, start).copy()
    for a, b in _within(source.comments, start, stop):
        text[a - start : b - start - (source.data[b - 1] == 10)] = 32
    ends = np.flatnonzero(text == 10)
    if not len(text) or text[-1] != 10:
        ends = np.append(ends, len(text))
    begins = np.concatenate(([0], ends[:-1] + 1))
    commas = np.flatnonzero(text == 44)
    first, last = np.searchsorted(commas, begins), np.searchsorted(commas, ends)
    tail = np.where(last > first, commas[np.maximum(last - 1, 0)] + 1 if len(commas) else 0, begins)
    ink = np.concatenate(([0], np.cumsum(text > 32, dtype=np.int64)))
    has_ink, open_ = ink[ends] > ink[begins], ink[ends] == ink[tail]
    counts = (last - first + 1 - open_)[has_ink]
    offsets, open_lines = (start + begins)[has_ink], open_[has_ink]
    separators = ends[has_ink & ~open_]
    text[ends[ends < len(text)]] = 32
    text[separators[separators < len(text)]] = 44
    if dtype is np.float64:
        text[(text == 68) | (text == 100)] = 101  # a D marks an exponent too
    joined = text.tobytes().rstrip(b", \t\r\f\v")
    values = parsed(joined, dtype)
    if values is None or len(values) != counts.sum():
        values = _slowly(source, offsets, counts, dtype)
    return values, counts, offsets, open_lines


def _within(spans: list[tuple[int, int]], start: int, stop: int) -> list[tuple[int, int]]:
    return spans[bisect.bisect_left(spans, (start, 0)) : bisect.bisect_left(spans, (stop, 0))]


def parsed(text: bytes, dtype: type) -> NDArray | None:
    """Return comma-separated numbers; None where some field is none, as one that is empty.

    What is refused here is looked at line by line by those who call, who know what to say of it.
    """
    if not text:
        return np.zeros(0, dtype)
    if b"_" in text:  # Python's own numbers may have some
        return None
    parts: list[NDArray] = []
    start = 0
    while start <= len(text):
        end = text.find(b",", start + CHUNK)
        end = len(text) if end < 0 else end
        try:
            parts.append(np.array(text[start:end].split(b","), dtype))
        except (ValueError, OverflowError):
            return None
        start = end + 1
    return np.concatenate(parts)


def _slowly(source: Source, offsets: NDArray, counts: NDArray, dtype: type) -> NDArray:
    """Read line by line, where some field is empty or not a number, and say which."""
    out: list[float] = []
    for offset, count in zip(offsets.tolist(), counts.tolist(), strict=True):
        fields = source.text(offset).split(b",")[:count]
        out += [_number(field.strip(), source, offset, dtype) for field in fields]
    return np.array(out, dtype)


_INTEGER = re.compile(rb"[+-]?[0-9]{1,18}")
_FLOAT = re.compile(rb"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eEdD][+-]?[0-9]+)?")


def _number(field: bytes, source: Source, offset: int, dtype: type) -> float:
    if dtype is np.float64:
        if not field:
            return 0.0
        if _FLOAT.fullmatch(field):
            return float(re.sub(rb"[dD]", b"e", field))
        raise source.error(offset, f"'{shown(field)}' is not a number")
    if _INTEGER.fullmatch(field):
        return int(field)
    raise source.error(offset, f"a whole number was expected, not '{shown(field)}'")
