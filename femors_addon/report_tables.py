# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables and plots from the dictionary that any job of FEMORS reports: no job needs a page of its own."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterator, Mapping
from typing import Any

from .cleaning import MERGED
from .plots import curves, number
from .progress import counted
from .report_html import Figure, Item, Section, Table, Warnings

STAT = {"median", "p99", "maximum"}
"""Keys by which a `quality.Stat` is known."""
STATISTICS = "median [1 %, 99 %] maximum"
LOUD = ("faults", "warnings", "notes")
LONGEST = 40
"""Rows of a table of records, and members of a list, that are printed; the JSON has them all."""
WHOLE = ("landmarks",)
"""Keys of tables that are printed whole: people look for a row of theirs."""
WORDS = {
    "surface_to_target": "Surface distance, source to target",
    "target_to_surface": "Surface distance, target to source",
    "hausdorff": "Distance to the nearest vertex",
    "aspect": "Aspect ratio",
    "dihedral": "Dihedral angle (degrees)",
    "flipped": "Flipped faces",
    "self_intersecting": "Self-intersecting faces",
    "p01": "1st percentile",
    "p99": "99th percentile",
    "cpu_seconds": "CPU time (s)",
    "solve_cpu_seconds": "CPU time of the removal (s)",
    "seconds": "Time (s)",
    "femors": "FEMORS version",
    "stop_reason": "Verdict",
    "sampled": "Before the morph",
    "xor": "XOR volume",
    "rms": "RMS",
    "edge": "Edge length",
    "scaled_jacobian": "Scaled Jacobian",
    "xor_uncertainty": "XOR volume, uncertainty",
    "dice": "Dice coefficient",
    "inverted_on_input": "Elements inverted before (ids)",
    "newly_inverted": "Elements newly inverted (ids)",
    "worst": "Worst element (id)",
    "least": "Least distance",
    "over": "Nodes too near, of each",
    "where": "Deepest at",
    "mesh_name": "Mesh",
    "other_name": "Compared with",
}
"""Keys that say less than they should."""
REMOVAL = {
    "number": "iteration",
    "missing": "depth left",
    "pierced": "edges crossing",
    "spread": "spread",
}
"""What the records of a removal of overclosure are about, by their keys."""
LENGTH = "length in the unit of the meshes (log)"


def words(key: str) -> str:
    """Return a key as a reader would have it."""
    return WORDS.get(key) or key.replace("_", " ").capitalize()


def sections(report: Mapping[str, Any]) -> list[Section]:
    """Return the sections of a report: verdict, before and after, convergence, settings, and all else.

    Parameters
    ----------
    report : dict
        As JSON would have it. Known by their keys: ``before`` and ``after`` (compared), ``history`` (a
        list of records, one per iteration), ``settings``, ``warnings``, ``faults``, ``notes``. Other
        dictionaries become sections of their own. Of ``files`` the folders are left out.
    """
    report = _with_base_names(report)
    plain = {k: v for k, v in report.items() if not isinstance(v, (Mapping, list, tuple))}
    out = [Section("Summary", (*_loud(report), *_records_or_pairs(plain)))]
    if isinstance(report.get("before"), Mapping) and isinstance(report.get("after"), Mapping):
        out.append(Section("Before and after", (compared(report["before"], report["after"]),)))
    history = report.get("history")
    if history:
        out.append(Section("Convergence", tuple(_history(history))))
    for key, value in report.items():
        if key in ("before", "after", "history", "settings", *LOUD) or not isinstance(
            value, (Mapping, list, tuple)
        ):
            continue
        items: tuple[Item, ...]
        if key in WHOLE and isinstance(value, Mapping):
            items = (_led_by(value),)
        elif key in WHOLE and value:
            items = (_records(value, most=len(value)),)
        else:
            items = tuple(_items(value))
        if items:
            out.append(Section(words(key), items))
    if isinstance(report.get("settings"), Mapping):
        out.append(Section("Settings", tuple(_records_or_pairs(report["settings"]))))
    return [section for section in out if section.items]


def _led_by(steering: Mapping[str, Any]) -> Table:
    """Return a table of the landmarks that led a morph, from `Steering.as_dict`."""
    left_out = set(steering["left_out"])
    rows = zip(steering["names"], steering["aligned"], steering["residual"], strict=True)
    records = [
        {"name": name, "aligned": before, "residual": after, "left_out": name in left_out}
        for name, before, after in rows
    ]
    return _records(records, "pulled" if steering["pulled"] else "aligned by, not pulled", len(records))


def compared(before: Mapping[str, Any], after: Mapping[str, Any]) -> Table:
    """Return a table of what both have."""
    rows = tuple(
        (words(key), _cell(before[key]), _cell(after[key]))
        for key in before
        if key in after and (_is_stat(before[key]) or not isinstance(before[key], (Mapping, list)))
    )
    stats = any(_is_stat(before[key]) for key in before if key in after)
    return Table((STATISTICS if stats else "", "before", "after"), rows)


def flat(report: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every number and text of a report by its path, such as ``after.aspect.median``."""
    for key, value in report.items():
        path = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from flat(value, f"{path}.")
        elif isinstance(value, (list, tuple)):
            yield from flat({str(i): one for i, one in enumerate(value)}, f"{path}.")
        else:
            yield path, value


def _loud(report: Mapping[str, Any]) -> Iterator[Item]:
    lines = tuple(
        str(line) for key in LOUD if isinstance(report.get(key), (list, tuple)) for line in report[key]
    )
    quiet = tuple(line for line in lines if line.endswith(MERGED))
    loud = tuple(line for line in lines if line not in quiet)
    if loud:
        yield Warnings(loud)
    if quiet:
        yield Warnings(quiet, loud=False)


def _with_base_names(report: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a report whose files, and what is said of them, have no folders; names stay different."""
    known = report.get("files")
    if not isinstance(known, Mapping):
        return report
    given = [value for value in known.values() if isinstance(value, str)]
    given += [one for value in known.values() if isinstance(value, (list, tuple)) for one in value]
    bases = [os.path.basename(os.path.normpath(path)) for path in dict.fromkeys(given)]
    short = {
        path: base
        for path, base in zip(dict.fromkeys(given), bases, strict=True)
        if bases.count(base) == 1 and os.path.sep in path
    }

    def named(value: Any) -> Any:
        if isinstance(value, (list, tuple)):
            return [named(one) for one in value]
        return short.get(value, value) if isinstance(value, str) else value

    def told(line: Any) -> Any:
        path = next((path for path in short if str(line).startswith(f"{path}: ")), None)
        return line if path is None else short[path] + str(line)[len(path) :]

    out = {**report, "files": {key: named(value) for key, value in known.items()}}
    for key in LOUD:
        if isinstance(report.get(key), (list, tuple)):
            out[key] = [told(line) for line in report[key]]
    return out


def _items(value: Any, caption: str = "") -> Iterator[Item]:
    if isinstance(value, Mapping):
        stats = {k: v for k, v in value.items() if _is_stat(v)}
        if isinstance(value.get("before"), Mapping) and isinstance(value.get("after"), Mapping):
            yield compared(value["before"], value["after"])
            value = {k: v for k, v in value.items() if k not in ("before", "after")}
        if stats:
            rows = tuple((words(k), _cell(v)) for k, v in stats.items())
            yield Table((STATISTICS, ""), rows, caption)
        plain = {k: v for k, v in value.items() if not isinstance(v, (Mapping, list, tuple))}
        yield from _records_or_pairs(plain, "" if stats else caption)
        for key, other in value.items():
            if key == "history" and isinstance(other, list) and other:
                yield from _history(other)
            elif isinstance(other, (Mapping, list, tuple)) and not _is_stat(other):
                yield from _items(other, words(key))
    elif value and all(isinstance(one, Mapping) for one in value):
        yield _records(value, caption)
    elif value and all(isinstance(one, (list, tuple)) for one in value):
        yield Table(("",), tuple(tuple(_cell(x) for x in ("", *row)) for row in value[:LONGEST]), caption)
    elif value:
        more = f" ... ({len(value)} in all)" if len(value) > LONGEST else ""
        text = ", ".join(_cell(one) for one in value[:LONGEST]) + more
        yield f"{caption}: {text}" if caption else text


def _records_or_pairs(plain: Mapping[str, Any], caption: str = "") -> Iterator[Table]:
    rows = tuple((words(key), _cell(value)) for key, value in plain.items() if value is not None)
    if rows:
        yield Table(("", ""), rows, caption)


def _records(records: Any, caption: str = "", most: int = LONGEST) -> Table:
    keys = list(dict.fromkeys(key for record in records for key in record))
    keys = [key for key in keys if any(record.get(key) is not None for record in records)]
    rows = [tuple(_cell(record.get(key, "")) for key in keys) for record in records[:most]]
    if not caption and any(_is_stat(record.get(key)) for record in records for key in keys):
        caption = STATISTICS
    if len(records) > most:
        rows.append((f"... {len(records)} in all", *[""] * (len(keys) - 1)))
    return Table(tuple(words(key) for key in keys), tuple(rows), caption)


def _history(history: Any) -> Iterator[Item]:
    """Plot what falls from iteration to iteration; the rows themselves are folded."""
    if set(history[0]) == set(REMOVAL):
        history = [{REMOVAL[key]: value for key, value in step.items()} for step in history]
        yield from _removal(history)
        first = _first_count(history)
        blank: dict[str, Any] = {"edges crossing": None}  # they need not have been counted there
        history = [step if i >= first else {**step, **blank} for i, step in enumerate(history)]
    else:
        numbers = [
            key
            for key in history[0]
            if key not in ("iteration", "nodes", "level")
            and all(isinstance(step.get(key), (int, float)) for step in history)
        ]
        series = {words(key): [(i + 1, step[key]) for i, step in enumerate(history)] for key in numbers[:4]}
        drawn = curves(series, "iteration, all levels in turn", LENGTH)
        if drawn:
            yield Figure(
                drawn, "Convergence: one point for each iteration, from the coarsest level to the dense mesh."
            )
    yield dataclasses.replace(
        _records(history),
        caption=f"Every step: {counted(len(history), 'iteration')}",
        folded=True,
    )


def _removal(history: Any) -> Iterator[Item]:
    """Plot what a removal has left: lengths in one figure, counts in another."""

    def series(*keys: str) -> dict[str, list[tuple[float, float]]]:
        return {words(key): [(step["iteration"], step[key]) for step in history] for key in keys}

    lengths = curves(series("depth left", "spread"), "iteration", LENGTH)
    if lengths:
        yield Figure(
            lengths,
            "Depth left, the largest of all pairs, and spread of the displacement field at each iteration; "
            "what is 0 has no point.",
        )
    points = series("edges crossing")
    first = _first_count(history)
    if first == len(history):
        yield "Edges crossing: none; they are counted once a pair is nearly apart."
        return
    counts = curves({key: some[first:] for key, some in points.items()}, "iteration", "edges", False)
    yield Figure(
        counts,
        "Edges of the bodies that cross another body's surface. They are counted once a pair is nearly "
        "apart, so the first point is the first count above 0.",
    )


def _first_count(history: Any) -> int:
    """Return at which step edges were first counted to cross, or the number of steps where none were.

    Before it, a 0 may mean that they were not counted.
    """
    return next((i for i, step in enumerate(history) if step["edges crossing"]), len(history))


def _place(place: Any) -> str:
    """Return coordinates with as many decimals as the largest has of its five digits."""
    largest = max((abs(one) for one in place), default=0.0)
    digits = 4 - math.floor(math.log10(largest)) if largest > 0 else 0
    return ", ".join(f"{one:.{min(max(digits, 0), 9)}f}" for one in place)


def _is_stat(value: Any) -> bool:
    return isinstance(value, Mapping) and set(value) >= STAT


def _cell(value: Any) -> str:
    if _is_stat(value):
        low = (
            f"[{number(value['p01'])}, {number(value['p99'])}]"
            if "p01" in value
            else f"99 % {number(value['p99'])}"
        )
        return f"{number(value['median'])} {low} {number(value['maximum'])}"
    if isinstance(value, Mapping):
        if set(value) == {"before", "after"}:
            return f"{_cell(value['before'])} \u2192 {_cell(value['after'])}"
        return ", ".join(f"{words(key)}: {_cell(one)}" for key, one in value.items())
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return number(value)
    if isinstance(value, (list, tuple)):  # a place
        return _place(value) if all(isinstance(one, float) for one in value) else ", ".join(map(_cell, value))
    return "" if value is None else str(value)
