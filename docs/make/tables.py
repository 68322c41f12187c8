# SPDX-License-Identifier: GPL-3.0-or-later
"""Markdown out of plain values: cells, tables and pages."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

NOTE = "<!-- made by docs/make from the code: do not edit -->\n"


def cell(text: object) -> str:
    """Return a text for a table's cell: one line; of what Markdown reads as its own only `code` is left."""
    line = " ".join(str(text).split()).replace("``", "`")
    parts = line.split("`")
    if len(parts) % 2 == 0:  # a quote that is not closed
        parts = [line.replace("`", "'")]
    plain = [re.sub(r"([|<>*_\[\]\\$])", r"\\\1", part) for part in parts[::2]]
    marked = [f"`{part.replace('|', '&#124;')}`" for part in parts[1::2]]
    return "".join(one + two for one, two in zip(plain, [*marked, ""], strict=True))


def code(text: object) -> str:
    """Return a text as code in a table's cell."""
    line = " ".join(str(text).split()).replace("|", "&#124;")
    return f"`{line}`" if line else ""


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table; its cells are Markdown already."""
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    lines += [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join(lines) + "\n"


def number(value: object) -> str:
    """Return a default or a limit as a person writes it."""
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:g}" if isinstance(value, float) else str(value)


def limits(low: float | None, high: float | None) -> str:
    """Return limits in words; none where there are none to speak of."""
    bounds = [None if value is None or abs(value) > 1e30 else value for value in (low, high)]
    if bounds[0] is not None and bounds[1] is not None:
        return f"{bounds[0]:g} to {bounds[1]:g}"
    if bounds[0] is not None:
        return f"from {bounds[0]:g}"
    return "" if bounds[1] is None else f"to {bounds[1]:g}"


def write(path: Path, title: str, text: str) -> Path:
    """Write a page; one that says the same already keeps its time."""
    whole = f"# {title}\n\n{NOTE}\n{text.rstrip()}\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != whole:
        path.write_text(whole, encoding="utf-8")
    return path
