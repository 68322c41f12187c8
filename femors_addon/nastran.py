# SPDX-License-Identifier: GPL-3.0-or-later
"""Nastran bulk data: GRID and element cards, and the file kept to be written again.

meshio's writer cannot hold every number in Nastran's fields and drops all other cards, so this one is
our own: the cards of nodes that moved are written in large fields (16 characters), all else stays.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from .deck import Deck, Load, OneFile, Part
from .elements import KINDS, Kind
from .fields import NASTRAN, number, spliced
from .files import read_bytes, shown
from .ids import Lookup
from .inp_syntax import Source
from .mesh import Float, Int
from .nastran_cards import Card, cards_of, real, whole, written
from .progress import FemorsError
from .volume import Block, VolumeMesh

SOLIDS = {
    "CTETRA": ("tet4", "tet10"),
    "CPYRAM": ("pyra5", "pyra13"),
    "CPYRA": ("pyra5", "pyra13"),
    "CPENTA": ("penta6", "penta15"),
    "CHEXA": ("hex8", "hex20"),
}
SHELLS = {
    "CTRIA3": ("tri3", "tri3"),
    "CTRIAR": ("tri3", "tri3"),
    "CTRIA6": ("tri3", "tri6"),
    "CQUAD4": ("quad4", "quad4"),
    "CQUADR": ("quad4", "quad4"),
    "CQUAD8": ("quad4", "quad8"),
}
CARDS = {**SOLIDS, **SHELLS}
"""Kind of the element with corner nodes only, and with all its mid-side nodes."""
_OTHERS = (
    "CAABSF CBAR CBEAM CBEAM3 CBEND CBUSH CBUSH1D CBUSH2D CCONEAX CDAMP1 CDAMP2 CDAMP3 CDAMP4 CDAMP5 "
    "CELAS1 CELAS2 CELAS3 CELAS4 CFAST CFLUID2 CFLUID3 CFLUID4 CGAP CGAPG CGASK6 CGASK8 CGASK12 "
    "CGASK16 CHACAB CHACBR CHBDYE CHBDYG CHBDYP CIFHEX CIFPENT CIFQDX CIFQUAD CMASS1 CMASS2 CMASS3 "
    "CMASS4 CONM1 CONM2 CONROD CPLSTN3 CPLSTN4 CPLSTN6 CPLSTN8 CPLSTS3 CPLSTS4 CPLSTS6 CPLSTS8 CQUAD "
    "CQUADX CQUADX4 CQUADX8 CRAC2D CRAC3D CROD CSEAM CSHEAR CSLOT3 CSLOT4 CTRAX3 CTRAX6 CTRIAX "
    "CTRIAX6 CTUBE CVISC CWELD GENEL JOINTG PLOTEL PLOTEL3 PLOTEL4 RBAR RBAR1 RBE1 RBE2 RBE2GS RBE3 "
    "RJOINT RROD RSPLINE RSSCON RTRPLT"
)
OTHERS = frozenset(_OTHERS.split())
"""Elements that take no part in a morph."""
NAMES = {
    "tet4": "CTETRA",
    "tet10": "CTETRA",
    "pyra5": "CPYRAM",
    "pyra13": "CPYRAM",
    "penta6": "CPENTA",
    "penta15": "CPENTA",
    "hex8": "CHEXA",
    "hex20": "CHEXA",
    "tri3": "CTRIA3",
    "tri6": "CTRIA6",
    "quad4": "CQUAD4",
    "quad8": "CQUAD8",
}
# Nastran has the vertical mid-side nodes before those of the top face; the order is its own inverse
ORDER = {
    "hex20": [*range(12), 16, 17, 18, 19, 12, 13, 14, 15],
    "penta15": [*range(9), 12, 13, 14, 9, 10, 11],
}


@dataclasses.dataclass(frozen=True, eq=False)
class Template(OneFile):
    """A Nastran file, and the GRID card of each node (n,) with its coordinates (n, 3) as read."""

    path: Path
    data: bytes
    cards: list[Card]
    nodes: Float

    def encoded(self, nodes: Float) -> bytes:
        """Return the file's bytes with other coordinates."""
        moved = np.flatnonzero((nodes != self.nodes).any(axis=1)).tolist()
        moved.sort(key=lambda index: self.cards[index].start)
        cards = [self.cards[index] for index in moved]
        rows = zip(cards, nodes[moved], self.nodes[moved], strict=True)
        return spliced(
            self.data, ((card.start, card.stop, _grid(card, self.data, new, old)) for card, new, old in rows)
        )


def _grid(card: Card, data: bytes, new: Float, old: Float) -> bytes:
    """Return a node's card in large fields; fields that did not change keep their text.

    What the card's lines have between and behind them, comments and empty lines, comes before it.
    """
    texts = [card.field(index).strip() for index in range(8)]
    for axis in range(3):
        if new[axis] != old[axis] or len(texts[2 + axis]) > NASTRAN:
            texts[2 + axis] = number(new[axis], NASTRAN)
    raw = data[card.start : card.stop]
    end = b"\r\n" if b"\r\n" in raw or (not raw.endswith(b"\n") and b"\r\n" in data[:4096]) else b"\n"
    first = "GRID*   " + "".join(text.ljust(NASTRAN) for text in texts[:4])
    second = "*       " + "".join(text.ljust(NASTRAN) for text in texts[4:])
    last = end if raw.endswith(b"\n") else b""
    return (
        _comments(raw, end)
        + first.rstrip().encode("latin-1")
        + end
        + second.rstrip().encode("latin-1")
        + last
    )


def _comments(raw: bytes, end: bytes) -> bytes:
    """Return the comments and the empty lines among a card's lines, as lines of their own."""
    out = []
    for line in raw.split(b"\n")[: -1 if raw.endswith(b"\n") else None]:
        fields, mark, comment = line.rstrip(b"\r").partition(b"$")
        if mark or not fields.strip():
            out.append(mark + comment if fields.strip() else fields + mark + comment)
    return b"".join(line + end for line in out)


def read(path: Path, load: Load = read_bytes) -> Deck:
    """Read a Nastran file; arguments and errors as for `inp.read`."""
    source = Source(0, path, load(path))
    if b"\0" in source.data:
        raise FemorsError(f"{path}: is not a Nastran file but binary")
    cards = cards_of(source, {"GRID", "GRDSET", "INCLUDE", *CARDS, *OTHERS})
    grids = [card for card in cards if card.name == "GRID"]
    if not grids:
        raise FemorsError(f"{path}: has no nodes (GRID cards)")
    ids = np.array([whole(source, card, 0, "a node's id") for card in grids], np.int64)
    preset = next((card.field(1).strip() for card in cards if card.name == "GRDSET"), "")
    positions = np.array([_position(source, card, preset) for card in grids])
    lookup = Lookup(ids, 0)
    _refuse_twins(source, grids, lookup, "node")
    members = [card for card in cards if card.name in CARDS]
    if not members:
        raise FemorsError(f"{path}: has no elements with a surface (CTETRA, CHEXA, CTRIA3 and so on)")
    blocks, parts, in_order = _elements(source, members, lookup)
    mesh = VolumeMesh(positions, tuple(blocks), ids)
    elements = Lookup(mesh.element_ids, 0)
    _refuse_twins(source, in_order, elements, "element")
    named = {
        f"PID {pid}": Part(f"PID {pid}", mesh.restricted(chosen)[1], chosen) for pid, chosen in parts.items()
    }
    there = {card.name for card in cards}
    notes = ["files that an INCLUDE names are not read"] if "INCLUDE" in there else []
    if there & OTHERS:
        notes.append(f"elements of type {', '.join(sorted(there & OTHERS))} are kept as they are")
    template = Template(path, source.data, grids, mesh.nodes)
    return Deck(path, path.suffix.lower(), mesh, named, template, (), tuple(notes))


def _position(source: Source, card: Card, preset: str) -> list[float]:
    """The coordinates of a GRID card; only the basic system is read, and `preset` is GRDSET's."""
    own = card.field(1)
    if (own or preset) not in ("", "0"):
        where = f"{own[:20]}" if own else f"{preset[:20]} (by the GRDSET card)"
        raise source.error(
            card.start, f"node {card.field(0)} is in coordinate system {where}; use the basic one"
        )
    return [real(source, card, index) for index in (2, 3, 4)]


# --- elements -------------------------------------------------------------------------------------
def _elements(
    source: Source, cards: list[Card], lookup: Lookup
) -> tuple[list[Block], dict[int, Int], list[Card]]:
    """Return the blocks, the elements of each property id, and the cards in the order of the elements."""
    groups: dict[tuple[str, str], list[tuple[Card, list[int]]]] = {}
    for card in cards:
        kind = _kind(source, card)
        nodes = [whole(source, card, 2 + index, "the id of a node") for index in range(kind.size)]
        if kind.name in ORDER:
            nodes = [nodes[index] for index in ORDER[kind.name]]
        groups.setdefault((card.name, kind.name), []).append((card, nodes))
    blocks, in_order, pids = [], [], []
    for (name, kind_name), rows in groups.items():
        ids = np.array([nodes for _, nodes in rows], np.int64)
        index = lookup(ids.ravel()).reshape(ids.shape)
        if (index < 0).any():
            at, column = np.argwhere(index < 0)[0]
            card = rows[at][0]
            text = f"element {card.field(0)} names node {ids[at, column]}, which the file lacks"
            raise source.error(card.start, text)
        numbers = np.array([whole(source, card, 0, "an element's id") for card, _ in rows], np.int64)
        blocks.append(Block(kind_name, index, numbers, name))
        in_order += [card for card, _ in rows]
        pids += [_property(source, card) for card, _ in rows]
    properties = np.array(pids, np.int64)
    parts = {int(pid): np.flatnonzero(properties == pid).astype(np.int32) for pid in np.unique(properties)}
    return blocks, parts, in_order


def _kind(source: Source, card: Card) -> Kind:
    """Return the kind of an element: linear without mid-side nodes, quadratic with all of them."""
    linear, quadratic = (KINDS[name] for name in CARDS[card.name])
    given = sum(card.field(2 + index) not in ("", "0") for index in range(linear.size, quadratic.size))
    if given in (0, quadratic.size - linear.size):
        return quadratic if given else linear
    # as the linear kind, those that are given would belong to no element, and stay where they are
    text = f"element {shown(card.field(0).encode())} ({card.name}) has {given} of its {len(quadratic.edges)}"
    raise source.error(card.start, f"{text} mid-side nodes; give it all of them or none")


def _property(source: Source, card: Card) -> int:
    return whole(source, card, 1, "a property's id") if card.field(1) else 0


def _refuse_twins(source: Source, cards: list[Card], lookup: Lookup, what: str) -> None:
    twins = lookup.twins()
    if twins is not None:
        one, two = (cards[index] for index in twins)
        text = f"{what} {two.field(0)} is there already, on line {source.line(one.start)}"
        raise source.error(two.start, text)


# --- from scratch ---------------------------------------------------------------------------------
def fresh(mesh: VolumeMesh, parts: dict[str, Int], suffix: str = ".bdf") -> bytes:
    """Return bulk data with nothing but nodes and elements; parts become property ids, by number."""
    lines = ["$ written by FEMORS"]
    lines += [f"$ PID {index + 1}: {shown(name.encode())}" for index, name in enumerate(parts)]
    lines.append("BEGIN BULK")
    for id_, position in zip(mesh.node_ids.tolist(), mesh.nodes.tolist(), strict=True):
        x, y, z = (number(value, NASTRAN) for value in position)
        lines += [f"GRID*   {id_:<32}{x:<16}{y}", f"*       {z}"]
    pid = np.full(mesh.element_count, len(parts) + 1)
    for index, elements in enumerate(parts.values()):
        pid[elements] = index + 1
    for block, start in mesh.with_starts():
        order: list[int] = ORDER.get(block.kind, list(range(block.shape.size)))
        ids = mesh.node_ids[block.nodes[:, order]]
        table = np.column_stack((block.ids, pid[start : start + len(block)], ids)).tolist()
        lines += [written(NAMES[block.kind], row) for row in table]
    return ("\n".join([*lines, "ENDDATA"]) + "\n").encode("latin-1", "replace")
