# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel Overclosure says of a removal: the certificate, pairs before and after, each body."""

from __future__ import annotations

from typing import Any

import bpy

from .figures import draw_row, draw_sentence, length_unit, number


def draw_removal(layout: bpy.types.UILayout, context: bpy.types.Context, report: dict[str, Any]) -> None:
    """Draw the certificate, the pairs before and after, and what became of each body."""
    factor, unit = length_unit(context.scene.unit_settings)
    verdict = layout.column(align=True)
    draw_sentence(verdict, context, report["certificate"], "CHECKMARK" if report["certified"] else "CANCEL")
    for warning in report["warnings"]:
        draw_sentence(verdict, context, warning, "ERROR")
    after = {(pair["one"], pair["two"]): pair for pair in report["pairs"]["after"]}
    column = layout.column(align=True)
    draw_row(column, f"Gap of nodes ({unit})", "before", "after")
    box = column.box().column(align=True)
    for pair in report["pairs"]["before"]:
        now = after.pop((pair["one"], pair["two"]), None)
        _pair_row(
            box,
            pair,
            number(factor * pair["least"]),
            "apart" if now is None else number(factor * now["least"]),
            alert=now is not None and now["state"] != "clear",
        )
    for pair in after.values():
        _pair_row(box, pair, "apart", number(factor * pair["least"]))
    before, now = (report["pairs"][key] for key in ("before", "after"))
    box = column.box().column(align=True)
    for title, count in (
        ("Crossing triangles", lambda pairs: str(sum(pair["crossings"] for pair in pairs))),
        ("Nodes too near", lambda pairs: str(sum(sum(pair["over"]) for pair in pairs))),
        ("Surfaces apart", lambda pairs: _apart(pairs, factor)),
        ("Shared volume", lambda pairs: _volume(pairs, factor)),
    ):
        draw_row(box, title, count(before), count(now))
    for body in report["bodies"]:
        draw_body(column, factor, body)


def draw_body(layout: bpy.types.UILayout, factor: float, body: dict[str, Any]) -> None:
    """Draw how a body moved and changed."""
    box = layout.box().column(align=True)
    if not body["nodes_moved"]:
        draw_row(box, body["name"], "", "rigid" if body["rigid"] else "not moved")
        return
    draw_row(box, body["name"], "", "")
    draw_row(box, "    Nodes moved", "", str(body["nodes_moved"]))
    draw_row(box, "    Moved up to", "", number(factor * body["movement"]["maximum"]))
    if body["xor"] is not None:
        draw_row(box, "    Changed volume", "", f"{100 * body['xor']:.2g} %")
    if body["thickness"] is not None:
        draw_row(box, "    Thinned up to", "", f"{100 * body['thickness_lost']:.2g} %")
    if body["scaled_jacobian"] is not None:
        figures = (f"{body['scaled_jacobian'][side]['minimum']:.3f}" for side in ("before", "after"))
        draw_row(box, "    Jacobian, min", *figures)
        new = len(body["newly_inverted"])
        draw_row(box, "    Newly inverted", "", str(new), alert=new > 0)


def _apart(pairs: list[dict[str, Any]], factor: float) -> str:
    """Return the least distance of two surfaces, between edges too, which may be less than that of nodes."""
    found = [pair.get("surfaces_apart") for pair in pairs]
    return "-" if None in found or not found else number(factor * min(found))


def _volume(pairs: list[dict[str, Any]], factor: float) -> str:
    shared = [pair["shared"] for pair in pairs]
    return "-" if None in shared else number(factor**3 * sum(shared))


def _pair_row(layout: bpy.types.UILayout, pair: dict[str, Any], *cells: str, alert: bool = False) -> None:
    """Draw two names one below the other, and two figures beside the second."""
    draw_row(layout, pair["one"], "", "")
    draw_row(layout, f"    {pair['two']}", *cells, alert=alert)
