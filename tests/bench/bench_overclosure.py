# SPDX-License-Identifier: GPL-3.0-or-later
"""``make bench``: overclosure removal on the decks of a real knee, the nodal method beside it.

    .venv/bin/python tests/bench/bench_overclosure.py [--docs]

Reads ../shared/data (or FEMORS_DATA), prints a table and writes bench_output/overclosure.md and .json.
``--docs`` puts the table into docs/overclosure.md. Each row runs in a process of its own with one
thread: CPU seconds are those of the removal from meshes in memory to the certificate, memory is the
process's peak above that with its input.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

GAP = 0.01
DENSE = {"50k nodes a body": (2, 1, 6), "200k nodes a body": (3, 2, 15)}
"""Rows of patella and femur, 1 mm in: how often each is divided in four, and the CPU seconds allowed."""


def one(number: int, method: str) -> dict[str, Any]:
    """Compute a row; run in a process of its own."""
    from knee import CASES

    case = CASES[number]
    return {
        "case": case.name,
        "limit": case.seconds,
        "xor_limit": case.xor,
        **figures(case.bodies(), case.judged, method),
    }


def dense(name: str) -> dict[str, Any]:
    """Compute a row of divided meshes."""
    from knee import CASES

    from femors_addon.bodies import Body

    bodies = [
        Body(body.name, divided(body.mesh.surface()[0], times))
        for body, times in zip(CASES[2].bodies(), DENSE[name][:2], strict=True)
    ]
    return {
        "case": f"patella on femur, 1 mm, {name}",
        "limit": DENSE[name][2],
        "xor_limit": None,
        **figures(bodies, "patella", "grnn"),
    }


def divided(surface: Any, times: int) -> Any:
    """Cut each triangle in four, some times."""
    import numpy as np

    from femors_addon.mesh import Surface

    for _ in range(times):
        vertices, faces = surface.vertices, surface.faces
        sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
        keys, middle = np.unique(sides[:, 0] * len(vertices) + sides[:, 1], return_inverse=True)
        ab, bc, ca = (middle.reshape(-1, 3) + len(vertices)).T
        ends = np.column_stack(np.divmod(keys, len(vertices)))
        a, b, c = faces.T
        parts = ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))
        surface = Surface(
            np.concatenate((vertices, vertices[ends].mean(axis=1))),
            np.concatenate([np.column_stack(part) for part in parts]),
        )
    return surface


def figures(bodies: list[Any], judged: str, method: str) -> dict[str, Any]:
    """Remove the overclosure and return what the table shows."""
    from femors_addon.overclosure import OverclosureSettings, remove_overclosure

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    result = remove_overclosure(bodies, OverclosureSettings(gap=GAP, method=method))
    peak = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    body = next((body for body in result.bodies if body.name == judged), None)
    jacobians = [b.elements[1].minimum for b in result.bodies if b.elements is not None and b.moved]
    return {
        "nodes": [len(b.nodes) for b in result.bodies],
        "seconds": result.solve_seconds,
        "all_seconds": result.seconds,
        "megabytes": peak,
        "certified": result.certified,
        "xor": None if body is None else body.xor,
        "settled": None if body is None or body.settled is None else body.settled.as_dict(),
        "gap": min(finding.least for finding in result.after),
        "crossings": sum(finding.crossings for finding in result.after),
        "shared": sum(finding.shared or 0.0 for finding in result.after),
        "inverted": sum(len(b.inverted_new) for b in result.bodies),
        "jacobian": min(jacobians, default=None),
        "iterations": len(result.history),
    }


def table(rows: list[tuple[dict[str, Any], dict[str, Any] | None]]) -> str:
    """Return the rows as a Markdown table."""
    head = [
        "case",
        "CPU (allowed)",
        "memory",
        "XOR (allowed)",
        "contact afterwards, median / 99th",
        "crossing",
        "inverted",
        "scaled Jacobian",
        "nodal method: crossing / shared mm3 / inverted",
    ]
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for ours, nodal in rows:
        limit = "" if ours["limit"] is None else f" ({ours['limit']:g})"
        change = "" if ours["xor"] is None else f"{100 * ours['xor']:.3g} %"
        change += "" if ours["xor_limit"] is None else f" ({100 * ours['xor_limit']:.3g})"
        settled = "" if ours["settled"] is None else "{median:.3f} / {p99:.3f}".format(**ours["settled"])
        verdict = "" if ours["certified"] else " NOT CERTIFIED"
        jacobian = "" if ours["jacobian"] is None else f"{ours['jacobian']:.3f}"
        beside = (
            "" if nodal is None else f"{nodal['crossings']} / {nodal['shared']:.2g} / {nodal['inverted']}"
        )
        cells = [
            ours["case"] + verdict,
            f"{ours['seconds']:.1f} s{limit}",
            f"{ours['megabytes']:.0f} MB",
            change,
            settled,
            str(ours["crossings"]),
            str(ours["inverted"]),
            jacobian,
            beside,
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def run(*words: str) -> dict[str, Any]:
    """Compute a row in a process of its own, with one thread."""
    print(f"bench: overclosure {' '.join(words)}", file=sys.stderr)
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    command = [sys.executable, __file__, "--row", *words]
    done = subprocess.run(command, env={**os.environ, **threads}, stdout=subprocess.PIPE, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def main() -> int:
    """Run every row, print and write the table."""
    from knee import CASES, DATA

    parser = argparse.ArgumentParser(description="Measure overclosure removal on real decks")
    parser.add_argument("--docs", action="store_true", help="put the table into docs/overclosure.md")
    parser.add_argument("--row", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if not DATA.is_dir():
        print(f"bench: {DATA} is not there; it needs the decks of ../shared/data (or FEMORS_DATA)")
        return 0
    if args.row:
        kind, which = args.row
        print(json.dumps(dense(which) if kind == "dense" else one(int(which), kind)))
        return 0
    rows: list[tuple[dict[str, Any], dict[str, Any] | None]] = [
        (run("grnn", str(number)), run("nodal", str(number))) for number in range(len(CASES))
    ]
    rows += [(run("dense", name), None) for name in DENSE]
    text = table(rows)
    output = ROOT / "bench_output"
    output.mkdir(exist_ok=True)
    (output / "overclosure.md").write_text(text + "\n", encoding="utf-8")
    (output / "overclosure.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
    print(f"{text}\n\nwritten: {output / 'overclosure.md'} and overclosure.json")
    if args.docs:
        path = ROOT / "docs" / "overclosure.md"
        start, stop = "<!-- bench:begin -->\n", "<!-- bench:end -->"
        before, rest = path.read_text(encoding="utf-8").split(start)
        path.write_text(before + start + text + "\n" + stop + rest.split(stop)[1], encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
