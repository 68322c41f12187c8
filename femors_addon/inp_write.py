# SPDX-License-Identifier: GPL-3.0-or-later
"""Abaqus decks out of the door: the file as it was but for coordinates, or one made from scratch."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .deck import by_part
from .elements import ABAQUS_NAMES
from .fields import number, spliced
from .inp_nodes import Places
from .inp_syntax import Source
from .mesh import Float, Int
from .progress import FemorsError
from .volume import VolumeMesh


@dataclasses.dataclass(frozen=True, eq=False)
class Template:
    """An input file and its includes as they were read.

    Attributes
    ----------
    sources : list of Source
        The deck first.
    places : Places
        Where each node's line stands.
    nodes : (n, 3) float64
        As read.
    """

    sources: list[Source]
    places: Places
    nodes: Float

    def inputs(self) -> list[Path]:
        """Return the files that were read."""
        return list(dict.fromkeys(source.path for source in self.sources))

    def encoded(self, nodes: Float) -> bytes:
        """Return the deck's own bytes with other coordinates (n, 3)."""
        return self._edited(self.sources[0], nodes)

    def outputs(self, nodes: Float, path: Path) -> dict[Path, bytes]:
        """Return the deck, and its includes at the places that they have seen from it.

        An include that is at its place already, unchanged, is left out.

        Raises
        ------
        FemorsError
            An include whose nodes moved and that the output would share with the input.
        """
        out = {path: self.encoded(nodes)}
        deck = self.sources[0].path
        for source in self.sources[1:]:
            data = self._edited(source, nodes)
            absolute = os.path.isabs(source.spelled)
            new = path.parent / os.path.relpath(source.path, deck.parent)
            if absolute or os.path.realpath(new) == os.path.realpath(source.path):
                if data != source.data:
                    raise FemorsError(
                        f"{path}: its include '{source.spelled}' has nodes that moved, and would replace "
                        f"that of {deck}; write into another folder"
                        + (" and name the include without one" if absolute else "")
                    )
            elif out.setdefault(new, data) != data:
                raise FemorsError(
                    f"{path}: '{source.spelled}' is included twice, and its nodes moved in two ways; "
                    "give each *INCLUDE a file of its own"
                )
        return out

    def _edited(self, source: Source, nodes: Float) -> bytes:
        """Return a file's bytes with the coordinates of the nodes in it that moved."""
        moved = (nodes != self.nodes).any(axis=1) & (self.places.files == source.number)
        rows = np.flatnonzero(moved)
        rows = rows[np.argsort(self.places.offsets[rows])]
        return spliced(source.data, self._lines(source.data, rows, nodes))

    def _lines(self, data: bytes, rows: Int, nodes: Float) -> Iterator[tuple[int, int, bytes]]:
        """Where the line of each row starts and ends, and what it is to be; in batches, to save memory."""
        for first in range(0, len(rows), 10_000):
            some = rows[first : first + 10_000]
            offsets, new, old = self.places.offsets[some], nodes[some], self.nodes[some]
            for start, position, before in zip(offsets.tolist(), new.tolist(), old.tolist(), strict=True):
                end = data.find(b"\n", start)
                end = len(data) if end < 0 else end
                yield start, end, replaced(data[start:end], position, before)


def replaced(line: bytes, new: list[float], old: list[float]) -> bytes:
    """Return a node's line with those of its three coordinates that changed; all else stays."""
    body = line.rstrip()
    end = line[len(body) :]
    fields = body.split(b",")
    while len(fields) < 4:
        fields.append(b"")
    for axis in range(3):
        if new[axis] != old[axis]:
            field = fields[axis + 1]
            text = field.strip()
            at = field.find(text) if text else len(field)
            fields[axis + 1] = field[:at] + number(new[axis]).encode() + field[at + len(text) :]
    return b",".join(fields) + end


# --- from scratch ---------------------------------------------------------------------------------
def fresh(mesh: VolumeMesh, parts: dict[str, Int], suffix: str = ".inp") -> bytes:
    """Return an input file with nothing but nodes, elements and sets.

    Parameters
    ----------
    mesh : VolumeMesh
        With ids that are unique.
    parts : dict of str to (k,) int32
        The element sets that elements are written in; those in none come last, without a set.
    """
    lines = ["** written by FEMORS", "*NODE"]
    lines += [
        f"{id_}, {number(x)}, {number(y)}, {number(z)}"
        for id_, (x, y, z) in zip(mesh.node_ids.tolist(), mesh.nodes.tolist(), strict=True)
    ]
    for name, block, chosen in by_part(mesh, parts):
        if block.kind not in ABAQUS_NAMES:
            raise FemorsError(f"Abaqus has no element like {block.kind}")
        elset = f", ELSET={_name(name)}" if name else ""
        lines.append(f"*ELEMENT, TYPE={ABAQUS_NAMES[block.kind]}{elset}")
        rows = np.column_stack((block.ids[chosen], mesh.node_ids[block.nodes[chosen]])).tolist()
        lines += [",\n".join(_joined(row)) for row in rows]
    for keyword, sets, ids in (
        ("NSET", mesh.node_sets, mesh.node_ids),
        ("ELSET", mesh.element_sets, mesh.element_ids),
    ):
        for name, members in sets.items():
            if name not in parts or keyword == "NSET":
                lines.append(f"*{keyword}, {keyword}={_name(name)}")
                lines += _joined(ids[members].tolist())
    return ("\n".join(lines) + "\n").encode()


def _name(name: str) -> str:
    plain = "".join(c if c.isprintable() and c not in '",' else "_" for c in name)
    return plain if plain.replace("-", "_").isidentifier() else f'"{plain}"'


def _joined(ids: list[int]) -> list[str]:
    return [", ".join(map(str, ids[i : i + 16])) for i in range(0, len(ids), 16)]
