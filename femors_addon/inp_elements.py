# SPDX-License-Identifier: GPL-3.0-or-later
"""The elements of an Abaqus deck, from its *ELEMENT tables."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray

from .elements import Kind, abaqus_kind
from .ids import Lookup
from .inp_nodes import Nodes, Places
from .inp_scopes import Scopes
from .inp_syntax import Keyword, Source
from .inp_table import Table, table
from .mesh import Int
from .progress import counted
from .volume_faces import Block, Ids

FULL_LINE = 16  # values on a data line that the next one may continue without a comma between them


@dataclasses.dataclass(eq=False)
class Elements:
    """All elements that have a surface, scope by scope, each in the order of the file.

    Attributes
    ----------
    blocks : list of Block
    scopes : list of str
        Of each block.
    lookups : dict
        For each scope from ids to indices through all blocks.
    sets : list of (scope, name, indices)
        What ELSET= on *ELEMENT lines names; "" where it is left out.
    unknown : set of str
        Element types that were passed over.
    """

    blocks: list[Block] = dataclasses.field(default_factory=list)
    scopes: list[str] = dataclasses.field(default_factory=list)
    lookups: dict[str, Lookup] = dataclasses.field(default_factory=dict)
    sets: list[tuple[str, str, Int]] = dataclasses.field(default_factory=list)
    unknown: set[str] = dataclasses.field(default_factory=set)

    def skipped(self) -> str:
        """Return what was passed over, for the end of a sentence."""
        return f" (of type {', '.join(sorted(self.unknown)[:6])})" if self.unknown else ""


@dataclasses.dataclass(frozen=True, eq=False)
class _Group:
    """One *ELEMENT table: ids (k,), node ids (k, nn), and the lines that the elements start on."""

    word: Keyword
    kind: Kind
    ids: Ids
    nodes: Ids
    places: Places


def read_elements(words: list[Keyword], sources: list[Source], scopes: Scopes, nodes: Nodes) -> Elements:
    """Read every *ELEMENT table of a known type.

    Raises
    ------
    FemorsError
        A number that cannot be read, an element with a wrong number of nodes, an id that stands twice,
        a node that is not there.
    """
    out = Elements()
    found: dict[str, list[_Group]] = {}
    for word in words:
        if word.name == "ELEMENT":
            group = _group(word, sources)
            if group is None:
                out.unknown.add(word.parameters["TYPE"].upper())
            elif len(group.ids):
                found.setdefault(scopes.owner(word.scope), []).append(group)
    first = 0
    places = Places.joined([group.places for groups in found.values() for group in groups])
    for scope, groups in found.items():
        start = first
        for group in groups:
            stop = start + len(group.ids)
            name = group.word.parameters.get("ELSET", "")
            out.sets.append((scope, name, np.arange(start, stop, dtype=np.int32)))
            start = stop
        out.lookups[scope] = Lookup(np.concatenate([group.ids for group in groups]), first)
        places.refuse_twins(out.lookups[scope], "element", sources)
        first = start
        for block in _blocks(groups, nodes.lookups.get(scope), sources):
            out.blocks.append(block)
            out.scopes.append(scope)
    return out


def _group(word: Keyword, sources: list[Source]) -> _Group | None:
    """Return the elements of a table; None where their type has no surface."""
    name = word.parameters.get("TYPE", "")
    if not name:
        raise word.error("*ELEMENT needs TYPE=")
    if "INPUT" in word.parameters:
        raise word.error("*ELEMENT, INPUT= is not read; put *INCLUDE behind the *ELEMENT line instead")
    kind = abaqus_kind(name)
    if kind is None:
        return None
    read = table(word, np.int64)
    width = kind.size + 1
    end = np.cumsum(read.counts)
    _check(word, read, end, width, sources)
    records = read.values.reshape(-1, width)
    lines = np.searchsorted(end, np.arange(len(records)) * width, side="right")
    return _Group(word, kind, records[:, 0], records[:, 1:], Places(read.files[lines], read.offsets[lines]))


def _check(word: Keyword, read: Table, end: NDArray[np.int64], width: int, sources: list[Source]) -> None:
    """Raise where an element does not end with a line, or a line within one does not go on."""
    if not len(end):
        return
    begin = end - read.counts
    across = (end - 1) // width != begin // width
    stops = (end % width != 0) & ~read.open & (read.counts < FULL_LINE)
    stops[-1] |= end[-1] % width != 0
    wrong = across | stops
    if not wrong.any():
        return
    line = int(np.argmax(wrong))
    first = begin[line] // width * width  # of the values of the element that goes wrong
    start = int(np.searchsorted(end, first, side="right"))
    raise sources[read.files[start]].error(
        int(read.offsets[start]),
        f"element {read.values[first]} has {counted(end[line] - first - 1, 'node')}, "
        f"and {word.parameters['TYPE'].upper()} needs {width - 1}",
    )


def _blocks(groups: list[_Group], lookup: Lookup | None, sources: list[Source]) -> list[Block]:
    """Return the groups as blocks; consecutive ones of one type become one."""
    out: list[Block] = []
    for type_, run in itertools.groupby(groups, lambda group: group.word.parameters["TYPE"].upper()):
        same = list(run)
        nodes = [_indices(group, lookup, sources) for group in same]
        ids = np.concatenate([group.ids for group in same])
        out.append(Block(same[0].kind.name, np.concatenate(nodes), ids, type_))
    return out


def _indices(group: _Group, lookup: Lookup | None, sources: list[Source]) -> Int:
    """Return the indices (k, nn) of the nodes that a table names."""
    flat = np.full(group.nodes.size, -1, np.int32) if lookup is None else lookup(group.nodes.ravel())
    if (flat < 0).any():
        index = int(np.argmax(flat < 0))
        element = index // group.kind.size
        text = f"element {group.ids[element]} names node {group.nodes.ravel()[index]}, which the deck lacks"
        raise group.places.error(sources, element, text)
    return flat.reshape(group.nodes.shape)
