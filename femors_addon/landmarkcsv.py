# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks as CSV: rows "x, y, z" or "name, x, y, z", and whatever columns stand beside them."""

from __future__ import annotations

import csv
import dataclasses
import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from .csvtext import Manner, joined, lines_of
from .files import shown
from .mesh import Float
from .progress import FemorsError, counted

Row = tuple[int, list[str]]
DELIMITERS = (",", ";", "\t")
DECIMAL = re.compile(r"[+-]?\d+,\d+")
UNIT = re.compile(r"[(\[].*")  # behind a column's title
NAMED = ("name", "label", "landmark", "id")  # titles of a column of names, the best first


@dataclasses.dataclass(frozen=True)
class Template:
    """A CSV file apart from its coordinates: lines, and where in which of them the cells stand."""

    lines: tuple[str | None, ...]  # a row over several lines stands in its first, None in the others
    rows: tuple[Row, ...]  # (number of its first line from 1, cells)
    columns: tuple[int, ...]  # of x, y and z
    name: int | None
    delimiter: str
    manner: Manner


def parse(data: bytes, space: str = "") -> tuple[Float, tuple[str, ...], Template]:
    """Read the rows of a file (comma, semicolon or tab); `space` is not used, CSV says nothing of axes.

    A first row without numbers is a header; where it names x, y and z, it says which columns they are.
    Empty rows and rows that begin with # are passed over.

    Raises
    ------
    FemorsError
        One line that names the line and what was expected.
    """
    lines, rows, delimiter = _rows(data)
    header = rows.pop(0)[1] if rows and not any(map(_is_number, rows[0][1])) else []
    if not rows:
        raise FemorsError("has no landmarks; rows 'x, y, z' or 'name, x, y, z' are needed")
    columns, name = _columns(header, rows)
    points = np.array([_point(row, columns, name) for row in rows])
    names = tuple(cells[name] for _, cells in rows) if name is not None else ()
    kept = Template(tuple(lines), tuple(rows), tuple(columns), name, delimiter, Manner.of(data))
    return points, names, kept


def build(
    points: Float,
    names: Sequence[str],
    template: Template | None,
    space: str = "",
    beside: Mapping[str, Sequence[object]] | None = None,
) -> bytes:
    """Write the rows anew with other points (k, 3); everything else of the template stays.

    Parameters
    ----------
    beside : mapping of str to sequence
        More columns, only where there is no template.
    """
    if template is None or beside:
        return _fresh(points, names, beside or {})
    lines = list(template.lines)
    for (number, cells), point in zip(template.rows, points, strict=True):
        changed = list(cells)
        for column, value in zip(template.columns, point, strict=True):
            changed[column] = _text(value)
        lines[number - 1] = joined(changed, template.delimiter)
    return template.manner.encoded(line for line in lines if line is not None)


def _fresh(points: Float, names: Sequence[str], beside: Mapping[str, Sequence[object]]) -> bytes:
    lines = []
    if names or beside:
        lines.append(joined([*(["name"] if names else []), "x", "y", "z", *beside]))
    for row, point in enumerate(points):
        cells = [names[row]] if names else []
        cells += [_text(value) for value in point]
        cells += [_text(v) if isinstance(v, float) else str(v) for v in (beside[key][row] for key in beside)]
        lines.append(joined(cells))
    return Manner().encoded(lines)


def _text(value: float) -> str:
    return "" if np.isnan(value) else f"{value + 0.0:.10g}"


def _rows(data: bytes) -> tuple[list[str | None], list[Row], str]:
    """Return all lines, (line number, cells) of those that say something, and the delimiter.

    A quoted cell may have line breaks in it: such a row's text stands in its first line, None in the others.
    """
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    delimiter = _delimiter([line for line in lines_of(text) if _says(line)])
    lines: list[str | None] = []
    rows: list[Row] = []
    rest = io.StringIO(text, newline="")
    for line in rest:
        whole = [line]
        if _says(line):
            number = len(lines) + 1
            try:
                cells = next(
                    csv.reader(_noted(line, rest, whole), delimiter=delimiter, skipinitialspace=True)
                )
            except (csv.Error, ValueError):
                raise FemorsError(f"line {number}: is not a row of a CSV file") from None
            # a quote that is never closed, or by another row's, would take that row into its cell
            if "".join(whole).count('"') % 2 or any(_swallowed(line, delimiter) for line in whole[1:]):
                hint = "; close the quote that begins there" if len(whole) > 1 else ""
                raise FemorsError(f"line {number}: is not a row of a CSV file{hint}")
            rows.append((number, [cell.strip() for cell in cells]))
        lines += ["".join(whole).rstrip("\r\n"), *[None] * (len(whole) - 1)]
    return lines, rows, delimiter


def _swallowed(line: str, delimiter: str) -> bool:
    """Whether a line within a quoted cell has a row's three numbers before the quote ends."""
    return sum(_is_number(cell.strip()) for cell in line.partition('"')[0].split(delimiter)) >= 3


def _says(line: str) -> bool:
    """Whether a line is neither empty nor a comment."""
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _noted(first: str, rest: Iterable[str], whole: list[str]) -> Iterator[str]:
    """Give a line and as many behind it as are asked for, which are added to `whole`."""
    yield first
    for line in rest:
        whole.append(line)
        yield line


def _delimiter(lines: list[str]) -> str:
    """Return what separates numbers in most rows; a semicolon in a name says nothing.

    Raises
    ------
    FemorsError
        Decimal commas, or nothing but spaces between the numbers.
    """

    def numbers(line: str, mark: str) -> int:
        return sum(_is_number(cell.strip().strip('"')) for cell in line.split(mark))

    counts = {mark: sum(numbers(line, mark) >= 3 for line in lines) for mark in DELIMITERS}
    if max(counts.values()):
        return max(DELIMITERS, key=lambda mark: counts[mark])
    for line in lines:
        if any(
            len([cell for cell in line.split(mark) if DECIMAL.fullmatch(cell.strip())]) > 2 for mark in ";\t "
        ):
            raise FemorsError("has decimal commas; write numbers with points, as in 1.5")
        if numbers(line, " ") >= 3 or sum(map(_is_number, line.split())) >= 3:
            raise FemorsError("has spaces between the numbers; commas, semicolons or tabs are needed")
    return max(DELIMITERS, key=lambda mark: lines[0].count(mark) if lines else 0)


def _columns(header: list[str], rows: Sequence[Row]) -> tuple[list[int], int | None]:
    """Return the columns of x, y and z, and that of the name."""
    titles = [UNIT.sub("", title).strip().lower() for title in header]
    if {"x", "y", "z"} <= set(titles):
        columns = [titles.index(axis) for axis in "xyz"]
        named = [titles.index(title) for title in NAMED if title in titles]
        words = [
            i
            for i in range(len(titles))
            if i not in columns
            and any(i < len(cells) and cells[i] and not _is_number(cells[i]) for _, cells in rows)
        ]
        return columns, next(iter([*named, *words]), None)
    number, cells = rows[0]
    if len(cells) not in (3, 4):
        raise FemorsError(
            f"line {number}: 'x, y, z' or 'name, x, y, z' is needed, not {counted(len(cells), 'value')}"
        )
    return ([0, 1, 2], None) if len(cells) == 3 else ([1, 2, 3], 0)


def _point(row: Row, columns: list[int], name: int | None) -> list[float]:
    number, cells = row
    needed = 1 + max([*columns, name or 0])
    if len(cells) < needed:
        raise FemorsError(
            f"line {number}: {counted(needed, 'value is', 'values are')} needed, not {len(cells)}"
        )
    wrong = next((cells[c] for c in columns if not _is_number(cells[c])), None)
    if wrong is not None:
        raise FemorsError(f"line {number}: '{shown(wrong.encode())}' is not a number")
    point = [float(cells[c]) for c in columns]
    if not np.isfinite(point).all():
        raise FemorsError(f"line {number}: the coordinates are not finite numbers")
    return point


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # Python reads 1_000 as a thousand
