# SPDX-License-Identifier: GPL-3.0-or-later
"""Abaqus input files: nodes, elements, sets, parts and instances, and the file kept to be written again.

Each part is in its own coordinates; `Deck.instances` says where an assembly places it. What is not
understood (materials, steps, unknown keywords and elements) is passed through. Includes are looked for
from the deck's folder and written beside the output, at the places that their *INCLUDE lines name.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .deck import Deck, Load, Part
from .files import read_bytes
from .inp_elements import Elements, read_elements
from .inp_nodes import Nodes, read_nodes
from .inp_scopes import Scopes
from .inp_sets import Sets
from .inp_syntax import keywords
from .inp_write import Template
from .mesh import Int
from .progress import FemorsError
from .volume import VolumeMesh


def read(path: Path, load: Load = read_bytes) -> Deck:
    """Read a deck and its includes.

    Parameters
    ----------
    path : Path
    load : callable
        Gives the bytes at a path; for decks that are kept elsewhere than on the disk.

    Raises
    ------
    FemorsError
        One line that names the file, the line and what was expected there.
    """
    words, sources = keywords(path, load)
    scopes = Scopes(words)
    nodes = read_nodes(words, sources)
    if not len(nodes.ids):
        raise FemorsError(f"{path}: has no nodes (*NODE lines and what follows them)")
    elements = read_elements(words, sources, scopes, nodes)
    if not elements.blocks:
        raise FemorsError(f"{path}: has no elements with a surface, solids or shells{elements.skipped()}")
    sets = Sets(words, scopes, nodes, elements)
    mesh = VolumeMesh(
        nodes.positions, tuple(elements.blocks), nodes.ids, sets.nodes, sets.elements, sets.surfaces
    )
    notes = [*nodes.notes, *sets.notes]
    if elements.unknown:
        notes.append(f"elements without a surface are kept as they are{elements.skipped()}")
    template = Template(sources, nodes.places, mesh.nodes)
    parts = _parts(mesh, scopes, nodes, elements, path.stem)
    return Deck(path, ".inp", mesh, parts, template, scopes.instances, tuple(notes))


def _parts(mesh: VolumeMesh, scopes: Scopes, nodes: Nodes, elements: Elements, stem: str) -> dict[str, Part]:
    """Return the parts, or where no part has elements, the sets that elements are defined in."""
    out: dict[str, Part] = {}
    for scope, lookup in elements.lookups.items():
        if scope in scopes.names:
            where = nodes.lookups[scope]
            members = np.arange(where.first, where.first + len(where.sorted), dtype=np.int32)
            mine = np.arange(lookup.first, lookup.first + len(lookup.sorted), dtype=np.int32)
            out[_free(scopes.names[scope], out)] = Part(scopes.names[scope], members, mine)
    by_set: dict[str, list[Int]] = {}
    spelled: dict[str, str] = {}
    for scope, name, members in elements.sets:
        if scope not in scopes.names:
            by_set.setdefault(spelled.setdefault(name.upper(), name or stem), []).append(members)
    for name, groups in by_set.items():
        chosen = np.concatenate(groups)
        name = _free(name, out)
        out[name] = Part(name, mesh.restricted(chosen)[1], np.sort(chosen))
    return out


def _free(name: str, taken: dict[str, Part]) -> str:
    """Return the name, with a number behind it where it is taken (compared without regard to case)."""
    upper = {other.upper() for other in taken}
    new, number = name, 1
    while new.upper() in upper:
        number += 1
        new = f"{name} ({number})"
    return new
