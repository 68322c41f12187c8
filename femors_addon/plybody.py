# SPDX-License-Identifier: GPL-3.0-or-later
"""The rows behind a PLY header: ASCII and binary, read element by element."""

from __future__ import annotations

import dataclasses
import struct
from itertools import accumulate, chain, islice

import numpy as np
from numpy.typing import NDArray

from .files import BadNumber, floats, integers
from .progress import FemorsError


@dataclasses.dataclass(frozen=True)
class Property:
    """One property of an element: a NumPy type such as "f4"; a list where `counter` is its length's type."""

    name: str
    type: str
    counter: str = ""


@dataclasses.dataclass(frozen=True)
class Element:
    """One element of a header, with the number of its rows."""

    name: str
    count: int
    properties: tuple[Property, ...]

    def column(self, *names: str) -> int:
        """Return the place of the first property with one of the names, -1 where there is none."""
        return next((i for i, p in enumerate(self.properties) if p.name in names), -1)

    @property
    def has_lists(self) -> bool:
        """Whether rows differ in length."""
        return any(p.counter for p in self.properties)

    def dtype(self, order: str, lengths: list[int] | None = None) -> np.dtype:
        """Return the type of a binary row; `lengths` are those of its lists, one per property."""
        fields: list[tuple] = []
        for i, p in enumerate(self.properties):
            if p.counter and lengths is not None:
                fields += [(f"n{i}", order + p.counter), (f"p{i}", order + p.type, (lengths[i],))]
            else:
                fields.append((f"p{i}", order + (p.counter or p.type)))
        return np.dtype(fields)

    def truncated(self, found: int) -> FemorsError:
        """Return the error of a file that ends early."""
        return FemorsError(f"is truncated: {self.count} rows '{self.name}' are announced, it has {found}")


class AsciiBody:
    """Rows of text, one per line."""

    def __init__(self, data: bytes, start: int) -> None:
        self.first = data.count(b"\n", 0, start) + 1  # line number of the first row
        self.lines = data[start:].split(b"\n")
        self.at = 0

    def skip(self, element: Element) -> tuple[list[int], bytes]:
        """Pass over an element; return its lines' numbers (from 0) and its bytes as they stand."""
        filled = (i for i in range(self.at, len(self.lines)) if self.lines[i].strip())
        rows = list(islice(filled, element.count))
        if len(rows) < element.count:
            raise element.truncated(len(rows))
        begin, self.at = self.at, rows[-1] + 1 if rows else self.at
        raw = b"".join(line + b"\n" for line in self.lines[begin : self.at])
        return rows, raw

    def rest(self) -> bytes:
        """Return what no element has claimed yet."""
        return b"\n".join(self.lines[self.at :])

    def table(self, element: Element, columns: list[int]) -> tuple[NDArray[np.float64], bytes]:
        """Return ((count, k) the scalar columns, the rows as they stand)."""
        rows, raw = self.skip(element)
        words = [tuple(self.lines[i].split()) for i in rows]
        self._check_lengths(words, rows, [len(element.properties)] * len(rows))
        try:
            flat = floats([tokens[column] for tokens in words for column in columns])
        except BadNumber as error:
            raise self._at(rows[error.index // len(columns)], str(error)) from None
        return flat.reshape(-1, len(columns)), raw

    def lists(self, element: Element, column: int) -> tuple[NDArray[np.int64], NDArray[np.int64], bytes]:
        """Return ((count,) lengths, the values of the list column one after the other, the rows)."""
        rows, raw = self.skip(element)
        words = [tuple(self.lines[i].split()) for i in rows]
        starts = [0] * len(rows)
        for property in element.properties[:column]:
            if property.counter:
                lengths = self._counts(words, rows, starts)
                starts = [start + 1 + length for start, length in zip(starts, lengths, strict=True)]
            else:
                starts = [start + 1 for start in starts]
        sizes = self._counts(words, rows, starts)
        self._check_lengths(words, rows, [start + 1 + n for start, n in zip(starts, sizes, strict=True)])
        tokens = [w[s + 1 : s + 1 + n] for w, s, n in zip(words, starts, sizes, strict=True)]
        try:
            values = integers(list(chain.from_iterable(tokens)))
        except BadNumber as error:
            row = int(np.searchsorted(list(accumulate(sizes)), error.index, side="right"))
            raise self._at(rows[row], str(error)) from None
        return np.array(sizes, dtype=np.int64), values, raw

    def _counts(self, words: list[tuple[bytes, ...]], rows: list[int], starts: list[int]) -> list[int]:
        self._check_lengths(words, rows, [start + 1 for start in starts])
        try:
            counts = integers([tokens[start] for tokens, start in zip(words, starts, strict=True)]).tolist()
        except BadNumber as error:
            raise self._at(rows[error.index], str(error)) from None
        negative = next((i for i, count in enumerate(counts) if count < 0), None)
        if negative is not None:
            raise self._at(rows[negative], "a list cannot have a negative length")
        return counts

    def _check_lengths(self, words: list[tuple[bytes, ...]], rows: list[int], needed: list[int]) -> None:
        for tokens, row, length in zip(words, rows, needed, strict=True):
            if len(tokens) < length:
                raise self._at(row, f"{length} numbers are needed, not {len(tokens)}")

    def _at(self, row: int, message: str) -> FemorsError:
        return FemorsError(f"line {self.first + row}: {message}")


class BinaryBody:
    """Rows of bytes, in one byte order ("<" or ">")."""

    def __init__(self, data: bytes, start: int, order: str) -> None:
        self.data, self.at, self.order = data, start, order

    def rest(self) -> bytes:
        """Return what no element has claimed yet."""
        return self.data[self.at :]

    def skip(self, element: Element) -> tuple[list[int], bytes]:
        """Pass over an element; return nothing much and its bytes."""
        if element.has_lists:
            return [], self.lists(element, -1)[2]
        return [], self._records(element, element.dtype(self.order)).tobytes()

    def table(self, element: Element, columns: list[int]) -> tuple[NDArray[np.float64], bytes]:
        """Return ((count, k) the scalar columns, the rows as they stand)."""
        records = self._records(element, element.dtype(self.order))
        return np.column_stack([records[f"p{c}"].astype(np.float64) for c in columns]), records.tobytes()

    def _records(self, element: Element, dtype: np.dtype) -> NDArray:
        room = (len(self.data) - self.at) // dtype.itemsize
        if room < element.count:
            raise element.truncated(room)
        records = np.frombuffer(self.data, dtype, element.count, self.at)
        self.at += records.nbytes
        return records

    def lists(self, element: Element, column: int) -> tuple[NDArray[np.int64], NDArray[np.int64], bytes]:
        """Return ((count,) lengths, the values of the list column one after the other, the rows)."""
        begin = self.at
        smallest = element.dtype(self.order).itemsize
        if (len(self.data) - begin) // smallest < element.count:
            raise element.truncated((len(self.data) - begin) // smallest)
        empty = np.zeros(0, dtype=np.int64)
        if element.count == 0:
            return empty, empty, b""
        found = self._alike(element, column) or self._walk(element, column)
        return *found, self.data[begin : self.at]

    def _alike(self, element: Element, column: int) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
        """Read rows that all are as long as the first (a mesh of triangles only, say)."""
        one = dataclasses.replace(element, count=1)
        begin = self.at
        lengths: list[int] = []
        self._walk(one, -1, lengths)
        self.at = begin
        dtype = element.dtype(self.order, lengths)
        if (len(self.data) - begin) // dtype.itemsize < element.count:
            return None
        records = np.frombuffer(self.data, dtype, element.count, begin)
        if any((records[f"n{i}"] != lengths[i]).any() for i, p in enumerate(element.properties) if p.counter):
            return None
        self.at += records.nbytes
        sizes = np.full(element.count, max(lengths[column], 0), dtype=np.int64)
        return sizes, records[f"p{column}"].astype(np.int64).ravel() if column >= 0 else sizes[:0]

    def _walk(
        self, element: Element, column: int, lengths: list[int] | None = None
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Read row by row; `lengths` takes the length of each property of the rows, 0 for scalars."""
        data, at, end = self.data, self.at, len(self.data)
        plan = [self._step(p, i == column) for i, p in enumerate(element.properties)]
        starts: list[int] = []
        sizes: list[int] = []
        for row in range(element.count):
            for width, counter, wanted in plan:
                count = 0
                if counter is None:
                    at += width
                else:
                    if at + counter.size > end:
                        raise element.truncated(row)
                    (count,) = counter.unpack_from(data, at)
                    at += counter.size
                    if count < 0:
                        raise FemorsError(f"{element.name} row {row}: a list cannot have a negative length")
                    if wanted:
                        starts.append(at)
                        sizes.append(count)
                    at += width * count
                if at > end:
                    raise element.truncated(row)
                if lengths is not None:
                    lengths.append(count)
        self.at = at
        if column < 0:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        dtype = np.dtype(self.order + element.properties[column].type)
        return np.array(sizes, dtype=np.int64), self._gather(starts, sizes, dtype)

    def _step(self, property: Property, wanted: bool) -> tuple[int, struct.Struct | None, bool]:
        codes = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I"}
        counter = struct.Struct(self.order + codes[property.counter]) if property.counter else None
        return np.dtype(property.type).itemsize, counter, wanted

    def _gather(self, starts: list[int], sizes: list[int], dtype: np.dtype) -> NDArray[np.int64]:
        """Return the values that stand at the starts, one list after the other."""
        count = np.array(sizes, dtype=np.int64)
        step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        first = np.repeat(np.array(starts, dtype=np.int64), count) + step * dtype.itemsize
        raw = np.frombuffer(self.data, np.uint8)[first[:, None] + np.arange(dtype.itemsize)]
        return raw.reshape(-1).view(dtype).astype(np.int64)
