# SPDX-License-Identifier: GPL-3.0-or-later
"""What a transfer writes: vertex groups of a target, and the panel's table of landmarks."""

from __future__ import annotations

import json
from typing import Any

import bpy

from .lazy import np

GROUPS_MADE = "femors_groups"
"""Custom property of a target: the names of the groups that transfers have made, as JSON."""


def groups(target: bpy.types.Object, weights: dict[str, Any]) -> list[str]:
    """Write groups to a mesh; one that an earlier transfer has made is written anew, no other is touched."""
    try:
        ours = dict(json.loads(target.get(GROUPS_MADE, "{}")))
    except (TypeError, ValueError):
        ours = {}
    made = []
    for name, values in weights.items():
        group = target.vertex_groups.get(ours.get(name, ""))
        if group is not None:
            group.remove(list(range(len(target.data.vertices))))
        else:
            group = target.vertex_groups.new(name=name)
        for weight in np.unique(values[values > 0]):
            group.add(np.flatnonzero(values == weight).tolist(), float(weight), "REPLACE")
        ours[name] = group.name
        made.append(group.name)
    target[GROUPS_MADE] = json.dumps(ours)
    return made


def table(form: Any, title: str, prediction: Any) -> None:
    """Put predicted landmarks into the panel's table."""
    form.marks.clear()
    form.title, form.mark = title, 0
    columns = prediction.columns()
    for row, name in enumerate(prediction.names):
        mark = form.marks.add()
        mark.name, mark.point = name, prediction.points[row]
        for key, values in columns.items():
            if not np.isnan(values[row]):
                setattr(mark, key, values[row])


def report(form: Any, figures: dict[str, Any], **objects: Any) -> None:
    """Keep a transfer's figures with the form, for a report.

    Parameters
    ----------
    figures : dict
        As the worker made them.
    **objects
        Names of what took part: ``field`` (a Text), ``source`` and ``target`` (meshes, or None), ``groups``
        (regions, and what they are called on the target), ``carried`` (objects before and after).
    """
    form.report = json.dumps({**figures, "objects": objects})
