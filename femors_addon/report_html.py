# SPDX-License-Identifier: GPL-3.0-or-later
"""A report as one HTML file that needs nothing else: text, tables, and figures inside it."""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Sequence
from html import escape

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:1100px;margin:2em auto;padding:0 1em}
h1{font-size:1.6em;margin-bottom:.2em}h2{font-size:1.2em;margin-top:2em;border-bottom:1px solid #ccc}
p.lead{color:#555;margin-top:0}table{border-collapse:collapse;margin:.8em 0;font-size:14px;
display:block;overflow-x:auto}
h3{font-size:1em;margin:1em 0 .2em}h3+table{margin-top:0}
th,td{padding:.2em .6em;border-bottom:1px solid #e2e2e2;text-align:left;vertical-align:top}
td.n{text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums}
thead th{border-bottom:1.5px solid #888}
.figures{display:flex;flex-wrap:wrap;gap:1em;align-items:flex-end}figure{margin:.5em 0}
figcaption{font-size:13px;color:#555;max-width:460px}img,svg{max-width:100%;height:auto}
ul.warn{background:#fff6e0;border-left:4px solid #e0a030;padding:.5em .5em .5em 2em}
ul.note{color:#555;padding-left:1.2em}summary{cursor:pointer}
@media print{body{max-width:none;margin:0}figure,table{break-inside:avoid}}
"""


@dataclasses.dataclass(frozen=True)
class Table:
    """Rows of text under a head; columns after the first are numbers. Folded, a click shows it."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    folded: bool = False


@dataclasses.dataclass(frozen=True)
class Figure:
    """A picture, as SVG text or as the bytes of a PNG, and what it shows."""

    content: str | bytes
    caption: str


@dataclasses.dataclass(frozen=True)
class Warnings:
    """Sentences that a reader must not miss; where they are not loud, that are good to know."""

    lines: tuple[str, ...]
    loud: bool = True


Item = str | Table | Figure | Warnings


@dataclasses.dataclass(frozen=True)
class Section:
    """A heading and what stands below it; a str is a paragraph."""

    title: str
    items: tuple[Item, ...]


def html(title: str, lead: str, sections: Sequence[Section]) -> str:
    """Return the page."""
    body = "".join(_section(section) for section in sections if section.items)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n"
        f'<body><h1>{escape(title)}</h1><p class="lead">{escape(lead)}</p>\n{body}</body></html>\n'
    )


def _section(section: Section) -> str:
    out = [f"<h2>{escape(section.title)}</h2>\n"]
    row: list[str] = []
    for item in (*section.items, ""):
        if isinstance(item, Figure):
            row.append(_figure(item))
            continue
        if row:  # figures that follow one another stand side by side
            out.append(f'<div class="figures">{"".join(row)}</div>\n')
            row = []
        if isinstance(item, Table):
            out.append(_table(item))
        elif isinstance(item, Warnings):
            lines = "".join(f"<li>{escape(line)}</li>" for line in item.lines)
            out.append(f'<ul class="{"warn" if item.loud else "note"}">{lines}</ul>\n')
        elif item:
            out.append(f"<p>{escape(item)}</p>\n")
    return "".join(out)


def _figure(figure: Figure) -> str:
    if isinstance(figure.content, bytes):
        data = base64.b64encode(figure.content).decode("ascii")
        picture = f'<img alt="{escape(figure.caption)}" src="data:image/png;base64,{data}">'
    else:
        picture = figure.content
    return f"<figure>{picture}<figcaption>{escape(figure.caption)}</figcaption></figure>"


def _aligned(cell: str) -> str:
    """Numbers stand to the right, words to the left."""
    return ' class="n"' if cell[:1].isdigit() or cell[:1] in "-+[" else ""


def _table(table: Table) -> str:
    caption = f"<h3>{escape(table.caption)}</h3>" if table.caption and not table.folded else ""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in table.head)
    head = f"<thead><tr>{head}</tr></thead>" if any(table.head) else ""
    rows = []
    for first, *others in table.rows:
        cells = "".join(f"<td{_aligned(cell)}>{escape(cell)}</td>" for cell in others)
        rows.append(f"<tr><th>{escape(first)}</th>{cells}</tr>")
    out = f"{caption}<table>{head}<tbody>{''.join(rows)}</tbody></table>\n"
    return f"<details><summary>{escape(table.caption)}</summary>{out}</details>\n" if table.folded else out
