# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines and rows of text files, and how they were written: line ends, byte order mark."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple


class Manner(NamedTuple):
    """How a text file was written."""

    mark: bool = False  # begins with the byte order mark by which a spreadsheet knows UTF-8
    end: str = "\n"  # of its last line: there may be others within quotes

    @classmethod
    def of(cls, data: bytes) -> Manner:
        """Return how a file was written."""
        ends = re.findall(rb"\r\n|\r|\n", data)
        return cls(data.startswith(codecs.BOM_UTF8), ends[-1].decode() if ends else "\n")

    def encoded(self, lines: Iterable[str]) -> bytes:
        """Return the lines as a file that is written so."""
        return ("\ufeff" * self.mark + "".join(line + self.end for line in lines)).encode()


def lines_of(text: str) -> list[str]:
    """Return the lines of a text, without their ends; unlike `str.splitlines`, none ends with U+2028."""
    return [line.rstrip("\r\n") for line in io.StringIO(text, newline="")]


def joined(cells: Sequence[str], delimiter: str = ",") -> str:
    """Return a row of a CSV file, without the end of its line; what has a line break in it is quoted.

    So is a first cell that would make a comment of the row.
    """
    out = io.StringIO()
    csv.writer(out, delimiter=delimiter, lineterminator="\r\n").writerow(cells)
    row = out.getvalue().removesuffix("\r\n")
    return f'"{cells[0]}"{row[len(cells[0]) :]}' if row.lstrip().startswith("#") else row
