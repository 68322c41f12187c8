# SPDX-License-Identifier: GPL-3.0-or-later
"""What is reported of the last transfer: its figures, and pictures of what is still there."""

from __future__ import annotations

import json
from typing import Any

import bpy

from ..femors_addon.progress import FemorsError
from . import heat_values, scene, transfer_work
from .fields import all_fields, data_of


def last(context: bpy.types.Context) -> dict[str, Any]:
    """Return the report of the scene's last transfer, or raise `FemorsError`."""
    text = context.scene.femors_transfer.report
    if not text:
        raise FemorsError("Nothing was transferred in this scene: transfer something first")
    return dict(json.loads(text))


def figures(report: dict[str, Any], surface: Any) -> list[Any]:
    """Return the sections with pictures: the field's surfaces, landmarks, and carried meshes.

    Parameters
    ----------
    report : dict
        See `last`.
    surface : callable
        Gives an object's surface as it is seen.
    """
    import numpy as np

    from ..femors_addon.report_transfer import Carried, transfer_figures
    from ..femors_addon.transfer import Transferred

    none = np.empty(0)
    carried = []
    rows = report.get("landmarks", [])
    if rows:
        before, after = (np.array([row[key] for row in rows]) for key in ("before", "after"))
        distances = [
            np.array([np.nan if row[key] is None else row[key] for row in rows], dtype=float)
            for key in ("distance_before", "distance_after")
        ]
        names = tuple(row["landmark"] for row in rows)
        moved = Transferred(after, distances[0], none, none)
        carried.append(Carried("landmarks", before, moved, distances[1], names))
    for old, new in report["objects"]["carried"].items():
        one, two = (_mesh(name) for name in (old, new))
        if one is None or two is None or len(one.data.vertices) != len(two.data.vertices):
            continue
        there = surface(two)
        moved = Transferred(there.vertices, none, none, none)
        start = heat_values.surface_of(one)[0]
        carried.append(Carried(old, start.vertices, moved, none, faces=there.faces))
    home, end = _surfaces(report, surface)
    names = [row["region"] for row in report.get("regions", [])]
    weights: list[Any] = [None, None]
    if names:
        target = _mesh(report["objects"]["target"] or "")
        source = _mesh(report["objects"]["source"] or "")
        if source is not None:
            home, weights[0] = surface(source), _weights(source, dict.fromkeys(names))
        if target is not None:
            weights[1] = _weights(target, report["objects"]["groups"])
    return transfer_figures(home, end, carried, regions=(weights[0], weights[1]))


def _weights(item: bpy.types.Object, groups: dict[str, Any]) -> Any:
    """Return (n,) for each vertex its largest weight in groups, by their names or those that they got."""
    import numpy as np

    known = scene.all_group_weights(item)
    found = [known[made or name] for name, made in groups.items() if (made or name) in known]
    return np.max(found, axis=0) if found else np.zeros(len(item.data.vertices))


def _surfaces(report: dict[str, Any], surface: Any) -> tuple[Any, Any]:
    """Return what was carried off, and what it ended beside; None for what is gone."""
    names = report["objects"]
    text = next((one for one in all_fields() if one.name == names["field"]), None)
    target = _mesh(names["target"] or "")
    home = end = None
    if text is not None:
        field = transfer_work.carrier_of(data_of(text), text.name).field
        if len(field.faces):
            home, end = field.origin, field.morphed
    if report["settings"]["inverse"]:
        home, end = end, home
    return home, end if target is None else surface(target)


def _mesh(name: str) -> bpy.types.Object | None:
    item = bpy.data.objects.get(name)
    return item if item is not None and item.type == "MESH" else None
