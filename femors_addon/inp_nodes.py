# SPDX-License-Identifier: GPL-3.0-or-later
"""The nodes of an Abaqus deck, from its *NODE tables; and from ids to indices."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from .ids import Lookup
from .inp_syntax import Keyword, Source
from .inp_table import Table, table
from .mesh import Float, Int
from .progress import FemorsError, counted
from .volume_faces import Ids

MAKERS = ("NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY")
"""Keywords that make or move nodes and elements which have no line of their own."""
LARGEST_ID = 2**53


@dataclasses.dataclass(frozen=True, eq=False)
class Places:
    """Where the lines of nodes or elements stand: number of the file (n,) and byte in it (n,)."""

    files: NDArray[np.uint16]
    offsets: NDArray[np.int64]

    @classmethod
    def joined(cls, parts: list[Places]) -> Places:
        """Return the places of several tables, one after the other."""
        return cls(
            np.concatenate([np.zeros(0, np.uint16), *(part.files for part in parts)]),
            np.concatenate([np.zeros(0, np.int64), *(part.offsets for part in parts)]),
        )

    def refuse_twins(self, lookup: Lookup, what: str, sources: list[Source]) -> None:
        """Raise `FemorsError` where an id stands twice."""
        twins = lookup.twins()
        if twins is not None:
            one, two = twins
            source = sources[self.files[one]]
            first = f"line {source.line(int(self.offsets[one]))} of {source.path.name}"
            id_ = lookup.ids[two - lookup.first]
            raise self.error(sources, two, f"{what} {id_} is there already, on {first}")

    def error(self, sources: list[Source], index: int, text: str) -> FemorsError:
        """Return an error at one of the lines."""
        return sources[self.files[index]].error(int(self.offsets[index]), text)


@dataclasses.dataclass(eq=False)
class Nodes:
    """All nodes, scope by scope, each in the order of the file.

    Attributes
    ----------
    positions : (n, 3) float64
    ids : (n,) int64
    places : Places
    lookups : dict
        For each scope from ids to indices.
    sets : list of (scope, name, indices)
        What NSET= on *NODE lines names.
    notes : list of str
    """

    positions: Float
    ids: Ids
    places: Places
    lookups: dict[str, Lookup]
    sets: list[tuple[str, str, Int]]
    notes: list[str]


def read_nodes(words: list[Keyword], sources: list[Source]) -> Nodes:
    """Read every *NODE table.

    Raises
    ------
    FemorsError
        A number or id that cannot be read, an id that stands twice, nodes that have no line of their
        own or are in a coordinate system of their own.
    """
    found: dict[str, list[tuple[Keyword, Table]]] = {}
    for word in _node_keywords(words):
        found.setdefault(word.scope, []).append((word, table(word, np.float64)))
    tables = [read for group in found.values() for _, read in group]
    places = Places.joined([Places(read.files, read.offsets) for read in tables])
    rows = np.concatenate([np.zeros((0, 4)), *map(_rows, tables)])
    counts = np.concatenate([np.zeros(0, np.int64), *(read.counts for read in tables)])
    _check(rows, counts, places, sources)
    out = Nodes(rows[:, 1:], rows[:, 0].astype(np.int64), places, {}, [], [])
    start = 0
    for scope, group in found.items():
        first = start
        for word, read in group:
            stop = start + len(read.counts)
            if name := word.parameters.get("NSET", ""):
                out.sets.append((scope, name, np.arange(start, stop, dtype=np.int32)))
            start = stop
        out.lookups[scope] = Lookup(out.ids[first:start], first)
        places.refuse_twins(out.lookups[scope], "node", sources)
    short = sum(int((read.counts < min(read.counts.max(initial=0), 4)).sum()) for read in tables)
    if short:
        out.notes.append(
            f"{counted(short, 'node has', 'nodes have')} fewer coordinates than others; what is missing is 0"
        )
    if (counts > 4).any():
        out.notes.append("normals on the lines of nodes stay as they are")
    return out


def _node_keywords(words: list[Keyword]) -> list[Keyword]:
    local = False
    out = []
    for word in words:
        if word.name in MAKERS:
            raise word.error(
                f"*{word.name} makes nodes or elements that have no line of their own; "
                "write the deck with every one of them listed"
            )
        if word.name == "SYSTEM":
            local = next(word.lines(), None) is not None
        elif word.name == "NODE":
            if local or word.parameters.get("SYSTEM", "R").upper() != "R":
                raise word.error("nodes in a coordinate system of their own are not read; use global x, y, z")
            if "INPUT" in word.parameters:
                raise word.error("*NODE, INPUT= is not read; put *INCLUDE behind the *NODE line instead")
            out.append(word)
    return out


def _rows(read: Table) -> Float:
    """Return (l, 4) id, x, y, z of each line; what is left out is 0."""
    start = np.cumsum(read.counts) - read.counts
    rows = np.zeros((len(read.counts), 4))
    for column in range(4):
        there = read.counts > column
        rows[there, column] = read.values[start[there] + column]
    return rows


def _check(rows: Float, counts: NDArray[np.int64], places: Places, sources: list[Source]) -> None:
    ids = rows[:, 0]
    bad_id = ~((ids >= 1) & (ids <= LARGEST_ID) & (ids == np.floor(ids)))
    bad_count = (counts < 2) | (counts > 7)
    wrong = bad_id | bad_count | ~np.isfinite(rows).all(axis=1)
    if not wrong.any():
        return
    first = int(np.argmax(wrong))
    if bad_count[first]:
        text = f"a node's id and its coordinates x, y, z were expected, not {counted(counts[first], 'value')}"
    elif bad_id[first]:
        text = f"a node's id was expected, a whole number from 1, not {ids[first]:.17g}"
    else:
        text = f"the coordinates of node {ids[first]:.0f} are not finite numbers"
    raise places.error(sources, first, text)
