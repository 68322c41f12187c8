# SPDX-License-Identifier: GPL-3.0-or-later
"""FEBio input files, specification 2.5 to 4: nodes, elements and sets, and the file kept to be written again.

Only the text of <node> elements is ever changed, in place: the file is read as a stream of events that
know their byte, and never rebuilt from a tree.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from .deck import Deck, Load, OneFile, Part, by_part
from .elements import febio_kind
from .feb_events import Group, Row, line_of, mesh_groups
from .fields import spliced
from .files import read_bytes, shown
from .ids import Lookup
from .inp_table import parsed
from .mesh import Float, Int
from .progress import FemorsError, counted
from .volume import Block, VolumeMesh
from .volume_faces import Ids

_INTEGER = re.compile(r"[+-]?[0-9]{1,18}")
_FLOAT = re.compile(rb"\s*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?\s*")


@dataclasses.dataclass(frozen=True, eq=False)
class Template(OneFile):
    """An FEBio file, and where the coordinates (n, 3) of its nodes start and end in it, (n, 2)."""

    path: Path
    data: bytes
    spans: NDArray[np.int64]
    nodes: Float

    def encoded(self, nodes: Float) -> bytes:
        """Return the file's bytes with other coordinates."""
        return spliced(self.data, self._texts(nodes))

    def _texts(self, nodes: Float) -> Iterator[tuple[int, int, bytes]]:
        """Where the coordinates of each node that moved start and end, and what they are to be."""
        moved = np.flatnonzero((nodes != self.nodes).any(axis=1))
        for index in moved[np.argsort(self.spans[moved, 0])].tolist():
            start, stop = self.spans[index].tolist()
            fields = self.data[start:stop].split(b",")
            for axis in range(3):
                if nodes[index, axis] != self.nodes[index, axis]:
                    text = fields[axis].strip()
                    fields[axis] = fields[axis].replace(text, repr(float(nodes[index, axis])).encode(), 1)
            yield start, stop, b",".join(fields)


def read(path: Path, load: Load = read_bytes) -> Deck:
    """Read an FEBio file; arguments and errors as for `inp.read`."""
    data = load(path)
    try:
        groups, spec = mesh_groups(data)
        return _deck(path, data, groups, spec)
    except FemorsError as error:
        text = str(error)
        raise FemorsError(text if text.startswith(str(path)) else f"{path}: {text}") from None


def _deck(path: Path, data: bytes, groups: list[Group], spec: str) -> Deck:
    rows = [row for group in groups if group.name == "Nodes" for row in group.rows]
    if not rows:
        raise FemorsError("has no nodes (<node> in <Mesh>, <Nodes>)")
    positions, ids = _positions(data, rows), _ids(data, rows, "a node")
    lookup = Lookup(ids, 0)
    _refuse_twins(data, rows, lookup, "node")
    blocks, element_rows, parts, unknown = _elements(data, groups, lookup)
    if not blocks:
        skipped = f" (of type {', '.join(sorted(unknown))})" if unknown else ""
        raise FemorsError(f"has no elements with a surface, solids or shells{skipped}")
    elements = Lookup(np.concatenate([block.ids for block in blocks]), 0)
    _refuse_twins(data, element_rows, elements, "element")
    notes = [f"FEBio {spec}: only 2.5 to 4.0 are known"] if spec not in ("2.5", "3.0", "4.0") else []
    if unknown:
        notes.append(f"elements of type {', '.join(sorted(unknown))} are kept as they are")
    node_sets = _sets(data, groups, "NodeSet", lookup, notes)
    element_sets = _sets(data, groups, "ElementSet", elements, notes if not unknown else [])
    surfaces = {}
    for group in groups:
        if group.name == "Surface":
            named = np.concatenate(
                [np.zeros(0, np.int64), *(_listed(data, row, "node") for row in group.rows)]
            )
            surfaces[group.label] = np.unique(lookup(named)[lookup(named) >= 0]).astype(np.int32)
    mesh = VolumeMesh(positions, tuple(blocks), ids, node_sets, element_sets, surfaces)
    spans = np.array([(row.start, row.stop) for row in rows], np.int64)
    template = Template(path, data, spans, mesh.nodes)
    found = {name: Part(name, mesh.restricted(chosen)[1], chosen) for name, chosen in parts.items()}
    return Deck(path, ".feb", mesh, found, template, (), tuple(notes))


def _error(data: bytes, row: Row, text: str) -> FemorsError:
    return FemorsError(f"line {line_of(data, row.offset)}: {text}")


def _ids(data: bytes, rows: Iterable[Row], what: str) -> Ids:
    out = []
    for row in rows:
        if _INTEGER.fullmatch(row.id) is None or int(row.id) < 1:
            raise _error(
                data,
                row,
                f"the id of {what} was expected, a whole number from 1, not '{shown(row.id.encode())}'",
            )
        out.append(int(row.id))
    return np.array(out, np.int64)


def _quickly(data: bytes, rows: list[Row], width: int, dtype: type) -> NDArray | None:
    """Return (rows, width) the numbers of all rows at once, None where some row has others."""
    texts = [data[row.start : row.stop] for row in rows]
    if any(text.count(b",") != width - 1 for text in texts):
        return None
    numbers = parsed(b",".join(texts).rstrip(), dtype)
    if numbers is None or len(numbers) != width * len(rows) or not np.isfinite(numbers).all():
        return None
    return numbers.reshape(-1, width)


def _positions(data: bytes, rows: list[Row]) -> Float:
    """Return the coordinates (n, 3) that the rows' texts spell."""
    quick = _quickly(data, rows, 3, np.float64)
    if quick is not None:
        return quick
    out = np.empty((len(rows), 3))
    for index, row in enumerate(rows):
        fields = data[row.start : row.stop].split(b",")
        if len(fields) != 3 or not all(map(_FLOAT.fullmatch, fields)):
            found = shown(data[row.start : row.stop])
            raise _error(data, row, f"x,y,z of node {row.id} were expected, not '{found}'")
        out[index] = [float(field) for field in fields]
        if not np.isfinite(out[index]).all():
            raise _error(data, row, f"the coordinates of node {row.id} are not finite numbers")
    return out


def _elements(
    data: bytes, groups: list[Group], lookup: Lookup
) -> tuple[list[Block], list[Row], dict[str, Int], set[str]]:
    """Return the blocks, the row of each element, the elements of each part, and types passed over."""
    blocks: list[Block] = []
    rows: list[Row] = []
    parts: dict[str, list[Int]] = {}
    unknown: set[str] = set()
    for group in groups:
        if group.name != "Elements":
            continue
        kind = febio_kind(group.type)
        if kind is None:
            unknown.add(group.type or "without a name")
        elif group.rows:
            ids = _node_ids(data, group, kind.size)
            nodes = lookup(ids.ravel()).reshape(ids.shape)
            if (nodes < 0).any():
                at, column = np.argwhere(nodes < 0)[0]
                text = f"element {group.rows[at].id} names node {ids[at, column]}, which the file lacks"
                raise _error(data, group.rows[at], text)
            members = np.arange(len(rows), len(rows) + len(ids), dtype=np.int32)
            label = group.label or (f"mat {group.material}" if group.material else "elements")
            parts.setdefault(label, []).append(members)
            rows += group.rows
            blocks.append(Block(kind.name, nodes, _ids(data, group.rows, "an element"), group.type))
    return blocks, rows, {name: np.concatenate(chosen) for name, chosen in parts.items()}, unknown


def _node_ids(data: bytes, group: Group, size: int) -> Ids:
    """Return (k, size) the ids of the nodes of a group's elements."""
    quick = _quickly(data, group.rows, size, np.int64)
    if quick is not None:
        return quick
    out = []
    for row in group.rows:
        out.append(_listed(data, row, "node"))
        if len(out[-1]) != size:
            text = f"element {row.id} has {counted(len(out[-1]), 'node')}, and {group.type} needs {size}"
            raise _error(data, row, text)
    return np.array(out)


def _listed(data: bytes, row: Row, what: str) -> Ids:
    """Return the ids in a row's text."""
    fields = data[row.start : row.stop].decode("latin-1").split(",")
    texts = [field.strip() for field in fields]
    if not all(map(_INTEGER.fullmatch, texts)):
        raise _error(data, row, f"ids of {what}s were expected, not '{shown(data[row.start : row.stop])}'")
    return np.array([int(text) for text in texts], np.int64)


def _refuse_twins(data: bytes, rows: list[Row], lookup: Lookup, what: str) -> None:
    twins = lookup.twins()
    if twins is not None:
        one, two = (rows[index] for index in twins)
        raise _error(data, two, f"{what} {two.id} is there already, on line {line_of(data, one.offset)}")


def _sets(data: bytes, groups: list[Group], kind: str, lookup: Lookup, notes: list[str]) -> dict[str, Int]:
    """Return the sets of a kind: rows with an id, or a text of ids and ranges a:b:step."""
    out: dict[str, Int] = {}
    for group in groups:
        if group.name != kind:
            continue
        members = [
            lookup(np.array([int(row.id) for row in group.rows if _INTEGER.fullmatch(row.id)], np.int64))
        ]
        single = []
        for word in re.split(r"[\s,]+", "".join(group.text).strip()):
            numbers = word.split(":")
            if not all(map(_INTEGER.fullmatch, numbers)):
                continue  # an empty set, or a reference of a kind that is not known here
            if len(numbers) == 1:
                single.append(int(word))
            else:
                low, high, step = (*map(int, numbers), 1)[:3]
                members.append(lookup.between(low, high, max(step, 1)))
        members.append(lookup(np.array(single, np.int64)))
        index = np.concatenate(members)
        if (index < 0).any():
            notes.append(f"the set '{group.label}' names {int((index < 0).sum())} that the file lacks")
        out[group.label] = np.unique(index[index >= 0]).astype(np.int32)
    return out


# --- from scratch ---------------------------------------------------------------------------------
def fresh(mesh: VolumeMesh, parts: dict[str, Int], suffix: str = ".feb") -> bytes:
    """Return an FEBio 4 file with nothing but nodes, elements and sets; as `inp_write.fresh`."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<febio_spec version="4.0">',
        "\t<Mesh>",
        "\t\t<Nodes>",
    ]
    for id_, (x, y, z) in zip(mesh.node_ids.tolist(), mesh.nodes.tolist(), strict=True):
        lines.append(f'\t\t\t<node id="{id_}">{x!r},{y!r},{z!r}</node>')
    lines.append("\t\t</Nodes>")
    taken: set[str] = set()
    for name, block, chosen in by_part(mesh, parts):
        label = name or "elements"
        label = f"{label}_{block.kind}" if label in taken else label  # a section holds one type
        taken.add(label)
        lines.append(f'\t\t<Elements type="{block.kind}" name={quoteattr(label)}>')
        rows = np.column_stack((block.ids[chosen], mesh.node_ids[block.nodes[chosen]])).tolist()
        lines += [f'\t\t\t<elem id="{row[0]}">{",".join(map(str, row[1:]))}</elem>' for row in rows]
        lines.append("\t\t</Elements>")
    for tag, sets, ids in (
        ("NodeSet", mesh.node_sets, mesh.node_ids),
        ("ElementSet", mesh.element_sets, mesh.element_ids),
    ):
        for name, members in sets.items():
            if name not in parts or tag == "NodeSet":
                lines.append(
                    f"\t\t<{tag} name={quoteattr(name)}>{','.join(map(str, ids[members].tolist()))}</{tag}>"
                )
    return ("\n".join([*lines, "\t</Mesh>", "</febio_spec>"]) + "\n").encode()
