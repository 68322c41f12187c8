# SPDX-License-Identifier: GPL-3.0-or-later
"""Decks kept in the .blend: the files themselves, compressed, so that a part can be exported from it alone.

A deck is a Text data-block: a sentence for people, and as a custom property the bytes of a zip with the
deck and its includes. Each mesh of a part points at it (`Mesh.femors.deck`), so that it is saved, copied,
appended and undone with the mesh, and goes with the last of them. Element connectivity, sets and
original float64 coordinates are read from it again when they are needed: there is one truth, not two.
"""

from __future__ import annotations

import io
import os
import posixpath
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..femors_addon.progress import FemorsError
from .lazy import tempfile, zipfile

if TYPE_CHECKING:
    from ..femors_addon.deck import Deck

DECK = "femors_deck"
"""Custom property of a Text: the zip."""
LARGE = 200e6
"""Bytes of a deck from which on the user is told that the .blend grows."""


def read(path: str) -> tuple[Deck, dict[Path, bytes]]:
    """Read a deck from the disk; return it and the bytes of its files by path, its own first.

    Raises
    ------
    FemorsError
        One line that says what is wrong with the file.
    """
    from ..femors_addon import deckfiles
    from ..femors_addon.files import read_bytes

    files: dict[Path, bytes] = {}

    def load(place: Path) -> bytes:
        files[Path(place)] = data = read_bytes(place)
        return data

    return deckfiles.read_deck(path, load), files


def packed(files: Mapping[Path, bytes]) -> bytes:
    """Return files, the deck first, as a zip in which they stand to each other as they did on the disk."""
    places = [os.path.abspath(path) for path in files]
    folder = os.path.dirname(places[0])
    try:
        names = [os.path.relpath(place, folder).replace(os.sep, "/") for place in places]
    except ValueError as error:  # Windows: on another drive
        raise FemorsError(f"{places[0]}: its includes are on several drives; bring them to one") from error
    depth = max(name.split("/").count("..") for name in names)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=3) as archive:
        for name, data in zip(names, files.values(), strict=True):
            archive.writestr(posixpath.normpath("up/" * depth + name), data)
    return out.getvalue()


def unpacked(archive: bytes) -> Deck:
    """Read a deck from a zip that `packed` made.

    Raises
    ------
    FemorsError
        The bytes are damaged, or the deck names an include by an absolute path that is gone.
    """
    from ..femors_addon import deckfiles

    try:
        with zipfile.ZipFile(io.BytesIO(archive)) as held:
            names = held.namelist()
            if len(names) == 1:
                data = held.read(names[0])
                return deckfiles.read_deck(names[0], lambda path: data)
            with tempfile.TemporaryDirectory(prefix="femors_") as folder:
                held.extractall(folder)
                try:
                    return deckfiles.read_deck(Path(folder, names[0]))
                except FemorsError as error:
                    raise FemorsError(str(error).replace(folder + os.sep, "")) from None
    except (zipfile.BadZipFile, IndexError) as error:
        raise FemorsError(f"the deck kept in this file is damaged ({error}): import it again") from None


def originals(archive: bytes) -> dict[str, bytes]:
    """Return the files in a zip that `packed` made, by name beside the deck's."""
    with zipfile.ZipFile(io.BytesIO(archive)) as held:
        folder = posixpath.dirname(held.namelist()[0]) or "."
        return {posixpath.relpath(name, folder): held.read(name) for name in held.namelist()}


def keep(name: str, files: Mapping[Path, bytes]) -> bpy.types.Text:
    """Make the Text that holds a deck; it goes when no mesh uses it any more."""
    archive = packed(files)
    text = bpy.data.texts.new(name)
    text.use_fake_user = False
    size = sum(map(len, files.values())) / 1e6
    text.write(
        f"FEMORS keeps {name} here ({size:.3g} MB, compressed), as the custom property '{DECK}':\n"
        "its parts can be morphed and exported from this .blend alone. Delete this text, and they cannot.\n"
    )
    text[DECK] = archive
    return text


def is_part(item: bpy.types.Object | None) -> bool:
    """Whether an object is a part of a deck, or was made from one."""
    return item is not None and item.type == "MESH" and bool(item.data.femors.part)


def archive_of(item: bpy.types.Object) -> bytes:
    """Return the zip of an object's deck.

    Raises
    ------
    FemorsError
        It is not a part of a deck, or the Text was deleted.
    """
    if not is_part(item):
        raise FemorsError(f"'{item.name}' is not a part of an FE model: import one (File > Import)")
    text = item.data.femors.deck
    data = text.get(DECK) if text is not None else None
    if not isinstance(data, bytes):
        raise FemorsError(
            f"The deck of '{item.name}' is not in this file (its text was deleted): import it again"
        )
    return data
