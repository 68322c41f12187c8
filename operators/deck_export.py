# SPDX-License-Identifier: GPL-3.0-or-later
"""Which objects an export takes a deck's parts from, and the files that come of it."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..femors_addon.progress import FemorsError
from . import deck_scene, deck_store, scene
from .deck_nodes import together
from .lazy import np


def chosen(context: bpy.types.Context, name: str = "") -> list[bpy.types.Object]:
    """Return the named object, or the selected parts of decks, or the active one.

    Raises
    ------
    FemorsError
        None of them is a part of a deck, or they are of several decks.
    """
    if name:
        items = [scene.find(name, "object")]
    else:
        items = [item for item in context.selected_objects if deck_store.is_part(item)]
        active = context.view_layer.objects.active
        items = items or ([active] if deck_store.is_part(active) else [])
    if not items:
        raise FemorsError("Nothing to export: select an object that was imported from an FE model")
    for item in items:
        deck_store.archive_of(item)
        if item.data.femors.deck != items[0].data.femors.deck:
            raise FemorsError(
                f"'{items[0].name}' and '{item.name}' are of different decks: select the parts of one"
            )
    return items


def file_name(item: bpy.types.Object) -> str:
    """Return the name of the file that an object's deck was read from."""
    return next(iter(deck_store.originals(deck_store.archive_of(item))))


def providers(context: bpy.types.Context, items: list[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return one object for each part: those chosen, and for other parts the only one in the scene.

    Raises
    ------
    FemorsError
        A part that several objects with different meshes stand for.
    """
    text = items[0].data.femors.deck
    others = [
        item for item in context.scene.objects if deck_store.is_part(item) and item.data.femors.deck == text
    ]
    out: dict[str, bpy.types.Object] = {}
    for group in (items, others):
        done = set(out)
        for item in group:
            name = item.data.femors.part
            if name in done:
                continue
            if name in out and out[name].data != item.data:
                raise FemorsError(
                    f"'{out[name].name}' and '{item.name}' are both part '{name}': "
                    + ("select one of them" if group is items else "select the one to be exported, too")
                )
            out.setdefault(name, item)
    return list(out.values())


def write(context: bpy.types.Context, items: list[bpy.types.Object], path: str) -> tuple[str, str]:
    """Write the deck that the objects belong to; return a report level and one line.

    Raises
    ------
    FemorsError
        A mesh that no longer has the part's nodes, a path that cannot be written.
    """
    from ..femors_addon import deckfiles
    from ..femors_addon.deck import write_all

    items = providers(context, items)
    archive = deck_store.archive_of(items[0])
    deck = deck_store.unpacked(archive)
    out = Path(path)
    if not out.suffix:
        out = out.with_suffix(deck.suffix)
    shots = [deck_scene.shot(item, keys=True) for item in items]
    moved = together(deck, shots)
    written = deckfiles.written(moved, out)
    _spare_includes(archive, written.files, out)
    write_all(written.files)
    count = int((moved.coordinates != deck.coordinates).any(axis=1).sum())
    taken = ", ".join(f"'{item.name}'" for item in items[:4]) + (", ..." if len(items) > 4 else "")
    line = f"{out.name}: {count} of {len(deck.coordinates)} nodes moved, from {taken}"
    notes = [*written.notes, *(note for item in items for note in _left_out(item, deck))]
    return ("WARNING" if notes else "INFO"), "; ".join([line, *notes])


def _spare_includes(archive: bytes, files: dict[Path, bytes], out: Path) -> None:
    """Refuse to put moved nodes into the very include that the deck was read with."""
    before = deck_store.originals(archive)
    for path, data in files.items():
        if path == out or not path.is_file():
            continue
        name = path.relative_to(out.parent).as_posix() if path.is_relative_to(out.parent) else ""
        old = before.get(name)
        if old is not None and old != data and path.read_bytes() == old:
            raise FemorsError(f"{out}: would change the include '{name}' of the original; use another folder")


def _left_out(item: bpy.types.Object, deck: object) -> list[str]:
    """Say what of an object a deck does not hold."""
    notes = []
    if any(modifier.show_viewport for modifier in item.modifiers):
        notes.append(f"the modifiers of '{item.name}' are not exported")
    part = item.data.femors.part.upper()
    places = [i.matrix for i in deck.instances if part in (i.part.upper(), i.name.upper())] or [np.eye(4)]
    matrix = np.array(item.matrix_world)
    size = 1e-4 * max(1.0, *(float(np.abs(place).max()) for place in places))
    if not any(np.allclose(matrix, place, rtol=0, atol=size) for place in places):
        notes.append(f"'{item.name}' was moved as an object, not its nodes: apply that (Ctrl+A) to export it")
    return notes
