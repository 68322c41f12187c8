# SPDX-License-Identifier: GPL-3.0-or-later
"""Fields kept in the .blend: each is a Text with a sentence for people and the bytes of its ``.npz`` file.

A Text is saved, appended, copied and undone by Blender itself. It has a fake user, so that it stays
where no object points at it; the result of its morph does, and brings it along when it is appended.
"""

from __future__ import annotations

import datetime
import json
from typing import TYPE_CHECKING, Any

import bpy

from ..femors_addon.progress import FemorsError
from .form import FIELD

if TYPE_CHECKING:
    from ..femors_addon.keptfield import KeptField

HEAD = "femors_field_head"
"""Custom property of a Text: names, date and figures as JSON, so that a panel need not read the field."""


def now() -> str:
    """Return the date and time, ISO 8601 with the zone."""
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")


def keep(field: KeptField) -> bpy.types.Text:
    """Make the Text that holds a field, named after the pair."""
    text = bpy.data.texts.new(field.name)
    text.use_fake_user = True
    data = field.encoded()
    text.write(
        f"FEMORS keeps the field of a morph here: '{field.source}' to '{field.target}', {field.date}\n"
        f"({len(data) / 1e6:.2g} MB, as the custom property '{FIELD}'). It carries landmarks, regions and\n"
        "whole geometries; delete this text, and the field is gone.\n"
    )
    text[FIELD] = data
    head = {"source": field.source, "target": field.target, "date": field.date, "figures": field.figures}
    text[HEAD] = json.dumps(head)
    return text


def all_fields() -> list[bpy.types.Text]:
    """Return the Texts that hold a field, the newest first."""
    found = [text for text in bpy.data.texts if FIELD in text.keys()]  # noqa: SIM118  (a Text is no dict)
    return sorted(found, key=lambda text: (head_of(text).get("date", ""), text.name), reverse=True)


def head_of(text: bpy.types.Text) -> dict[str, Any]:
    """Return names, date and figures of a field; nothing where somebody has overwritten them."""
    try:
        return dict(json.loads(text.get(HEAD, "{}")))
    except (TypeError, ValueError):
        return {}


def find(name: str) -> bpy.types.Text:
    """Return the Text of a field by its name; the newest field where no name is given.

    Raises
    ------
    FemorsError
        No such field, or none at all.
    """
    known = all_fields()
    if not known:
        raise FemorsError("There is no field in this file: morph first, which keeps one")
    if not name:
        return known[0]
    for text in known:
        if text.name == name:
            return text
    listed = ", ".join(f"'{text.name}'" for text in known[:5]) + (", ..." if len(known) > 5 else "")
    raise FemorsError(f"There is no field named '{name}'; there is {listed}")


def data_of(text: bpy.types.Text) -> bytes:
    """Return the bytes of a field's file."""
    data = text.get(FIELD)
    if not isinstance(data, bytes):
        raise FemorsError(f"The field '{text.name}' is damaged: morph again")
    return data
