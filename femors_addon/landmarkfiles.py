# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks from files: CSV with x, y, z or name, x, y, z in each row; and their pairing."""

from __future__ import annotations

import csv
import dataclasses

import numpy as np

from .files import Location, read_bytes, shown
from .mesh import Float, frozen
from .progress import FemorsError

Row = tuple[int, list[str]]


@dataclasses.dataclass(frozen=True, eq=False)
class Landmarks:
    """Points (k, 3) float64, and their names where the file has some (else an empty tuple)."""

    points: Float
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen(self.points, np.float64, 3))


def read(path: Location) -> Landmarks:
    """Read a CSV file (comma, semicolon or tab) with rows "x, y, z" or "name, x, y, z".

    A first row without numbers is a header; where it names x, y and z, it says which columns they are.
    Empty rows and rows that begin with # are passed over.

    Raises
    ------
    FemorsError
        One line that names the file, the line and what was expected.
    """
    data = read_bytes(path)
    try:
        rows = _rows(data)
        header = rows.pop(0)[1] if rows and not any(map(_is_number, rows[0][1])) else []
        if not rows:
            raise FemorsError("has no landmarks; rows 'x, y, z' or 'name, x, y, z' are needed")
        columns, name = _columns(header, rows[0])
        points = np.array([_point(row, columns, name) for row in rows])
        names = tuple(cells[name] for _, cells in rows) if name is not None else ()
        _check_names(names)
    except FemorsError as error:
        raise FemorsError(f"{path}: {error}") from None
    return Landmarks(points, names if all(names) else ())


def _rows(data: bytes) -> list[Row]:
    """Return (line number, cells) of the rows that say something."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    delimiter = next((mark for mark in ";\t" if mark in text), ",")
    rows: list[Row] = []
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                (cells,) = csv.reader([line], delimiter=delimiter, skipinitialspace=True)
            except (csv.Error, ValueError):
                raise FemorsError(f"line {number}: is not a row of a CSV file") from None
            rows.append((number, [cell.strip() for cell in cells]))
    return rows


def _columns(header: list[str], first: Row) -> tuple[list[int], int | None]:
    """Return the columns of x, y and z, and that of the name."""
    titles = [title.lower() for title in header]
    if {"x", "y", "z"} <= set(titles):
        columns = [titles.index(axis) for axis in "xyz"]
        return columns, next((i for i in range(len(titles)) if i not in columns), None)
    number, cells = first
    if len(cells) not in (3, 4):
        raise FemorsError(f"line {number}: 'x, y, z' or 'name, x, y, z' is needed, not {len(cells)} values")
    return ([0, 1, 2], None) if len(cells) == 3 else ([1, 2, 3], 0)


def _point(row: Row, columns: list[int], name: int | None) -> list[float]:
    number, cells = row
    needed = 1 + max([*columns, name or 0])
    if len(cells) < needed:
        raise FemorsError(f"line {number}: {needed} values are needed, not {len(cells)}")
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


def _check_names(names: tuple[str, ...]) -> None:
    if all(names) and len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise FemorsError(f"the name '{shown(twice.encode())}' stands twice")


def paired(source: Landmarks, target: Landmarks) -> tuple[Float, Float]:
    """Return the landmarks of two files as pairs (k, 3), (k, 3): by name where both have names.

    Raises
    ------
    FemorsError
        A landmark without a partner, or fewer than three pairs.
    """
    if source.names and target.names:
        alone = set(source.names) ^ set(target.names)
        if alone:
            listed = ", ".join(sorted(alone)[:5]) + (", ..." if len(alone) > 5 else "")
            raise FemorsError(f"landmarks without a partner of the same name: {listed}")
        order = [target.names.index(name) for name in source.names]
        target = Landmarks(target.points[order], source.names)
    if len(source.points) != len(target.points):
        raise FemorsError(
            f"{len(source.points)} source landmarks and {len(target.points)} target landmarks are not pairs"
        )
    if len(source.points) < 3:
        raise FemorsError(f"{len(source.points)} pair(s) of landmarks; at least 3 are needed")
    return source.points, target.points
