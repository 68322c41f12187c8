# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks in and out of files, by their ending: CSV, and 3D Slicer's two; and their pairing."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from . import landmarkcsv, markups
from .files import Location, check_no_folder, read_bytes, shown
from .mesh import Float, frozen
from .progress import FemorsError, counted, listed


@dataclasses.dataclass(frozen=True)
class _Kind:
    parse: Callable[..., Any]
    build: Callable[..., bytes]


FORMATS = {
    ".mrk.json": _Kind(markups.parse_json, markups.build_json),
    ".json": _Kind(markups.parse_json, markups.build_json),
    ".fcsv": _Kind(markups.parse_fcsv, markups.build_fcsv),
    ".csv": _Kind(landmarkcsv.parse, landmarkcsv.build),
}
MARKS = "CSV (x,y,z or name,x,y,z), .fcsv or .mrk.json"
"""The files of landmarks, for the help of the command line."""
NO_PARTNER = "landmarks without a partner of the same name"


@dataclasses.dataclass(frozen=True, eq=False)
class Landmarks:
    """Named points, and the rest of the file that they were read from.

    Attributes
    ----------
    points : (k, 3) float64
        In the axes of the meshes.
    names : tuple of str
        Empty where the file has none.
    kind : str
        The ending whose format `template` belongs to; "" for points from elsewhere.
    template : object
        What else was in the file.
    space : str
        Axes of the points: LPS or RAS.
    """

    points: Float
    names: tuple[str, ...] = ()
    kind: str = ""
    template: Any = None
    space: str = "LPS"

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen(self.points, np.float64, 3))

    def with_points(self, points: ArrayLike) -> Landmarks:
        """Return the same landmarks at other places (k, 3)."""
        return dataclasses.replace(self, points=np.asarray(points, dtype=np.float64))

    @property
    def labels(self) -> tuple[str, ...]:
        """The names, or numbers from 1 where there are none."""
        return self.names or tuple(str(number) for number in range(1, len(self.points) + 1))

    def named(self, labels: Sequence[str]) -> Float:
        """Return the points (k, 3) of some labels."""
        return self.points[[self.labels.index(label) for label in labels]]


def is_landmarks(path: Location) -> bool:
    """Whether a path's ending is that of a landmark file."""
    return _ending(path) in FORMATS


def ending_of(path: Location) -> str:
    """Return the ending of a landmark file; raise `FemorsError` where it is no known one."""
    ending = _ending(path)
    if ending not in FORMATS:
        check_no_folder(path)
        raise FemorsError(f"{path}: is no kind of landmark file; use {', '.join(FORMATS)}")
    return ending


def _ending(path: Location) -> str:
    name = os.path.basename(os.fspath(path)).lower()
    return next((ending for ending in FORMATS if name.endswith(ending)), "")


def read(path: Location, space: str = "LPS") -> Landmarks:
    """Read a CSV, ``.fcsv`` or ``.mrk.json`` file; what is none of the others is read as CSV.

    Parameters
    ----------
    space : {"LPS", "RAS"}
        The axes of the meshes: points of a file of 3D Slicer are turned into them. A CSV file says
        nothing of axes, and is taken as it is.

    Raises
    ------
    FemorsError
        One line that names the file, where possible the line, and what was expected.
    """
    data = read_bytes(path)
    kind = _ending(path) or ".csv"
    try:
        points, names, template = FORMATS[kind].parse(data, space)
        names = _filled(names)
        _check_names(names)
    except FemorsError as error:
        raise FemorsError(f"{path}: {error}") from None
    return Landmarks(points, names, kind, template, space)


def encoded(path: Location, marks: Landmarks, beside: Mapping[str, Sequence[object]] | None = None) -> bytes:
    """Return the bytes of a landmark file of the kind that the path's ending says.

    Landmarks that were read from the same kind keep all else that was in their file.

    Parameters
    ----------
    beside : mapping of str to sequence
        More columns of a CSV file, which is then made from scratch; the other kinds have no room for them.
    """
    kind = ending_of(path)
    same = marks.kind and FORMATS[marks.kind] == FORMATS[kind]
    template = marks.template if same else None
    if FORMATS[kind].parse is landmarkcsv.parse:
        return landmarkcsv.build(marks.points, marks.names, template, beside=beside)
    return FORMATS[kind].build(marks.points, marks.labels, template, marks.space)


def _filled(names: tuple[str, ...]) -> tuple[str, ...]:
    """Number what has no name, where others have one; nothing where none has."""
    if not any(names):
        return ()
    return tuple(name or str(number) for number, name in enumerate(names, 1))


def _check_names(names: tuple[str, ...]) -> None:
    if all(names) and len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise FemorsError(f"the name '{shown(twice.encode())}' stands twice; give each landmark its own")


class Paired(NamedTuple):
    """Landmarks of two files in pairs.

    Attributes
    ----------
    source, target : (k, 3) float64
    names : tuple of str
        Of the pairs; empty where they go by their order.
    alone : tuple of str
        Names that only one of the two has.
    """

    source: Float
    target: Float
    names: tuple[str, ...]
    alone: tuple[str, ...] = ()

    @property
    def notes(self) -> list[str]:
        """What the user should know."""
        return [f"{NO_PARTNER}: {_names(self.alone)}; left out"] if self.alone else []


def paired(source: Landmarks, target: Landmarks) -> Paired:
    """Return the landmarks of two files as pairs: by name where both have names, else by their order.

    Raises
    ------
    FemorsError
        Fewer than three pairs; without names, not as many in both.
    """
    if source.names and target.names:
        names = tuple(name for name in source.names if name in target.names)
        alone = tuple(sorted(set(source.names) ^ set(target.names)))
        if len(names) < 3:
            those = f" ({NO_PARTNER}: {_names(alone)})" if alone else ""
            raise FemorsError(f"{counted(len(names), 'pair')} of landmarks; at least 3 are needed{those}")
        return Paired(source.named(names), target.named(names), names, alone)
    if len(source.points) != len(target.points):
        raise FemorsError(
            f"{len(source.points)} source landmarks and {len(target.points)} target landmarks are not pairs"
        )
    if len(source.points) < 3:
        raise FemorsError(f"{counted(len(source.points), 'pair')} of landmarks; at least 3 are needed")
    return Paired(source.points, target.points, source.names)


def _names(names: Sequence[str]) -> str:
    return listed((shown(name.encode()) for name in names), most=5)
