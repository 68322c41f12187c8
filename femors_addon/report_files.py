# SPDX-License-Identifier: GPL-3.0-or-later
"""A report as a file: HTML, JSON or CSV by the ending of its name."""

from __future__ import annotations

import csv
import datetime
import io
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .files import Location, check_no_folder
from .progress import FemorsError
from .report_html import Section, Table, html
from .report_tables import flat, sections
from .versions import versions

ENDINGS = (".html", ".htm", ".json", ".csv")
FORMATS = ".html is a page with pictures and plots, .json and .csv are data"
HELP = f"settings, history, every figure: {FORMATS}"


def check_ending(path: Location) -> str:
    """Return a report's ending in lower case, or raise `FemorsError`: before a long computation."""
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        check_no_folder(path)
        raise FemorsError(f"{path}: a report ends in {', '.join(ENDINGS)}")
    return ending


def report_bytes(
    path: Location,
    report: Mapping[str, Any],
    title: str,
    figures: Callable[[], Sequence[Section]] = tuple,
    others: Mapping[str, str] | None = None,
) -> bytes:
    """Return a report in the format that its file's name says.

    Parameters
    ----------
    path : path
        Only its ending counts.
    report : dict
        Whatever a job reports, as JSON would have it: see `report_tables.sections`.
    title : str
        Of the page.
    figures : callable
        Gives sections with pictures, which stand after the summary; called for HTML only.
    others : dict of str to str
        Versions beside those of FEMORS and its libraries.

    Raises
    ------
    FemorsError
        An ending that is none of `ENDINGS`.
    """
    ending = check_ending(path)
    if ending == ".json":
        return (json.dumps(report, indent=1, allow_nan=False) + "\n").encode("utf-8")
    if ending == ".csv":
        out = io.StringIO(newline="")
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(("name", "value"))
        writer.writerows(flat(report))
        return out.getvalue().encode("utf-8")
    now = datetime.datetime.now().astimezone()
    summary, *rest = sections(report)
    known = {**versions(), **(others or {})}
    made_by = Section("Versions", (Table(("", ""), tuple(known.items())),))
    lead = f"Made by FEMORS {known['FEMORS']} on {now:%Y-%m-%d at %H:%M %z}"
    return html(title, lead, [summary, *figures(), *rest, made_by]).encode("utf-8")
