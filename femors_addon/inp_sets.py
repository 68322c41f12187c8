# SPDX-License-Identifier: GPL-3.0-or-later
"""The named sets and surfaces of an Abaqus deck: *NSET, *ELSET and *SURFACE, by index."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from .ids import Lookup
from .inp_elements import Elements
from .inp_nodes import Nodes
from .inp_scopes import Scopes
from .inp_syntax import Keyword
from .inp_table import table
from .mesh import Int
from .progress import FemorsError
from .volume_faces import Block, all_faces, outer_faces

NONE = np.zeros(0, np.int32)
Named = dict[tuple[str, str], Int]
"""Members by (scope, upper-case name)."""


class Sets:
    """All sets of a deck.

    Attributes
    ----------
    nodes, elements, surfaces : dict of str to (k,) int32
        By name; ``part.name`` where several parts have one of that name. A surface is its nodes.
    notes : list of str
    """

    def __init__(self, words: list[Keyword], scopes: Scopes, nodes: Nodes, elements: Elements) -> None:
        self._scopes, self._nodes, self._elements = scopes, nodes, elements
        self._spelled: dict[tuple[str, str], str] = {}
        self._node_sets: Named = {}
        self._element_sets: Named = {}
        self._surfaces: Named = {}
        self._missing: dict[str, int] = {}
        for scope, name, members in nodes.sets:
            self._add(self._node_sets, scope, name, members)
        for scope, name, members in elements.sets:
            if name:
                self._add(self._element_sets, scope, name, members)
        for word in words:
            if word.name in ("NSET", "ELSET"):
                self._set(word)
        for word in words:
            if word.name == "SURFACE":
                self._surface(word)
        self.nodes, self.elements, self.surfaces = map(
            self._by_name, (self._node_sets, self._element_sets, self._surfaces)
        )
        self.notes = [
            f"the set '{name}' names {count} that the deck lacks" for name, count in self._missing.items()
        ][:5]

    # --- sets ---------------------------------------------------------------------------------
    def _set(self, word: Keyword) -> None:
        name = word.parameters.get(word.name, "")
        if not name:
            raise word.error(f"*{word.name} needs {word.name}= and a name")
        scope = self._scopes.target(word)
        members: list[Int] = []
        if word.name == "NSET":
            own, lookup = self._node_sets, self._nodes.lookups.get(scope)
            if "ELSET" in word.parameters:
                members.append(self._of_elements(word, scope))
        else:
            own, lookup = self._element_sets, self._elements.lookups.get(scope)
        if "GENERATE" in word.parameters:
            members += _generated(word, lookup)
        else:
            members += self._listed(word, scope, lookup, own, name)
        self._add(own, scope, name, np.concatenate([NONE, *members]))

    def _of_elements(self, word: Keyword, scope: str) -> Int:
        """Return the nodes of the element set that *NSET, ELSET= names."""
        found = self._find(self._element_sets, scope, word.parameters["ELSET"])
        return NONE if found is None else nodes_of(self._elements.blocks, found)

    def _listed(self, word: Keyword, scope: str, lookup: Lookup | None, own: Named, name: str) -> list[Int]:
        """Return the members that data lines list: ids, and names of other sets."""
        try:
            ids, names = table(word, np.int64).values, []
        except FemorsError:
            words = [field for _, _, fields in word.lines() for field in fields if field]
            texts = [field.decode("utf-8", "replace").strip('"') for field in words]
            ids = np.array([int(text) for text in texts if _is_id(text)], np.int64)
            names = [text for text in texts if not _is_id(text)]
        index = np.full(len(ids), -1, np.int32) if lookup is None else lookup(ids)
        lost = int((index < 0).sum())
        out = [index[index >= 0]]
        for other in names:
            found = self._find(own, scope, other)
            lost += found is None
            out += [] if found is None else [found]
        # an element of an unknown type is there, though it is not among ours
        if lost and not (word.name == "ELSET" and self._elements.unknown):
            self._missing[name] = self._missing.get(name, 0) + lost
        return out

    def _find(self, sets: Named, scope: str, name: str) -> Int | None:
        """Return a set by its name in the scope, or by ``instance.name``."""
        found = sets.get((scope, name.upper()))
        if found is None and "." in name:
            instance, _, rest = name.partition(".")
            found = sets.get((self._scopes.owner(f"I:{instance.upper()}"), rest.upper()))
        return found

    def _add(self, sets: Named, scope: str, name: str, members: Int) -> None:
        key = scope, name.upper()
        self._spelled.setdefault(key, name)
        sets[key] = np.union1d(sets.get(key, NONE), members).astype(np.int32)

    def _by_name(self, sets: Named) -> dict[str, Int]:
        names = [name for _, name in sets]
        out = {}
        for key, members in sets.items():
            spelled = self._spelled[key]
            if names.count(key[1]) > 1 and key[0] in self._scopes.names:
                spelled = f"{self._scopes.names[key[0]]}.{spelled}"
            out[spelled] = members
        return out

    # --- surfaces -----------------------------------------------------------------------------
    def _surface(self, word: Keyword) -> None:
        """Keep the nodes of a *SURFACE of elements: rows "set or element, face"."""
        name = word.parameters.get("NAME", "")
        kind = word.parameters.get("TYPE", "ELEMENT").upper()
        if not name or kind not in ("ELEMENT", "NODE"):
            return  # analytical and Eulerian surfaces have no nodes
        scope = self._scopes.target(word)
        members = [NONE]
        for _, _, fields in word.lines():
            of = fields[0].decode("utf-8", "replace").strip('"')
            label = fields[1].decode("latin-1").upper() if len(fields) > 1 else ""
            if kind == "NODE":
                found = self._members(self._node_sets, self._nodes.lookups, scope, of)
                members.append(found)
            else:
                found = self._members(self._element_sets, self._elements.lookups, scope, of)
                members.append(self._face_nodes(found, label))
        self._add(self._surfaces, scope, name, np.concatenate(members))

    def _members(self, sets: Named, lookups: Mapping[str, Lookup], scope: str, of: str) -> Int:
        found = self._find(sets, scope, of)
        if found is None and _is_id(of) and scope in lookups:
            index = lookups[scope](np.array([int(of)], np.int64))
            found = index[index >= 0]
        return NONE if found is None else found

    def _face_nodes(self, elements: Int, label: str) -> Int:
        """Return the corner nodes of one face of each element; of the outer faces where no label is given."""
        pairs = _chosen(self._elements.blocks, elements)
        number = re.fullmatch("S([1-6])", label)
        solids = [(block, start) for block, start in pairs if block.shape.solid]
        shells = [block.nodes.ravel() for block, _ in pairs if not block.shape.solid]
        if number is not None:
            faces = all_faces(solids)
            ends = np.cumsum(faces.sizes)
            keep = np.repeat(faces.face == int(number[1]) - 1, faces.sizes)
            solid = faces.corners[keep] if len(ends) else NONE
        else:
            solid = outer_faces(solids, len(self._nodes.ids)).corners if solids else NONE
        return np.unique(np.concatenate([NONE, solid, *shells])).astype(np.int32)


def _is_id(text: str) -> bool:
    return re.fullmatch(r"[+-]?[0-9]{1,18}", text) is not None


def _generated(word: Keyword, lookup: Lookup | None) -> list[Int]:
    """Return the members of a set whose lines are "first, last, step"."""
    out = []
    for source, offset, fields in word.lines():
        values = [field.decode("latin-1") for field in fields if field]
        if not 2 <= len(values) <= 3 or not all(map(_is_id, values)):
            raise source.error(offset, "first, last and step of the ids were expected")
        low, high, step = (*map(int, values), 1)[:3]
        if step <= 0:
            raise source.error(offset, f"a step from 1 was expected, not {step}")
        if lookup is not None:
            out.append(lookup.between(low, high, step))
    return out


def _chosen(blocks: list[Block], elements: Int) -> list[tuple[Block, int]]:
    """Return the elements (ascending indices) as blocks; the numbers of the elements no longer matter."""
    out, start = [], 0
    for block in blocks:
        low, high = np.searchsorted(elements, [start, start + len(block)])
        if high > low:
            mine = elements[low:high] - start
            out.append((Block(block.kind, block.nodes[mine], block.ids[mine], block.type), 0))
        start += len(block)
    return out


def nodes_of(blocks: list[Block], elements: Int) -> Int:
    """Return the nodes of some elements (ascending indices), ascending."""
    found = [block.nodes.ravel() for block, _ in _chosen(blocks, elements)]
    return np.unique(np.concatenate([NONE, *found])).astype(np.int32)
