# SPDX-License-Identifier: GPL-3.0-or-later
"""``make bench``: the morph measured on real bones, beside the authors' own result.

    .venv/bin/python tests/bench/bench_morph.py [--readme]

Reads ../shared/data (or FEMORS_DATA), prints a table and writes bench_output/morph.md and morph.json.
``--readme`` puts the table into README.md. Each row runs in a process of its own with one thread:
CPU seconds are of the morph alone, memory is its peak above that of the process with its input.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("FEMORS_DATA", ROOT.parent / "shared" / "data"))
sys.path.insert(0, str(ROOT))

ROWS = {
    "aligned": "Aligned only (affine)",
    "authors": "The authors' own result (MATLAB)",
    "published": "FEMORS, *As published*",
    "standard": "FEMORS, *Standard*",
    "fine": "FEMORS, *Fine detail*",
    "gross": "FEMORS, *Gross shape*",
    "target": "The target's own mesh",
}
COLUMNS = {
    "surface_to_target": "surface, source to target",
    "target_to_surface": "surface, target to source",
    "hausdorff": "nearest vertex",
    "aspect": "aspect ratio",
    "dihedral": "dihedral angle",
}


def one(row: str) -> dict[str, object]:
    """Compute a row; run in a process of its own."""
    import numpy as np

    from femors_addon.cleaning import clean
    from femors_addon.mesh import Surface
    from femors_addon.morph import PRESETS, morph
    from femors_addon.quality import Stat, compare

    pair = DATA / "femur_pair"
    with np.load(pair / "meshes.npz") as meshes:
        source = Surface(meshes["source_vertices"], meshes["source_faces"])
        target = Surface(meshes["target_vertices"], meshes["target_faces"])
        authors = meshes["authors_morphed_vertices"]
    if row == "authors":
        cleaned = clean(source.vertices, source.faces).surface
        figures = compare(cleaned, cleaned.moved(authors), clean(target.vertices, target.faces).surface)
        return {"figures": dataclasses.asdict(figures)}
    if row == "target":
        cleaned = clean(target.vertices, target.faces).surface
        return {"figures": dataclasses.asdict(compare(cleaned, cleaned, cleaned))}
    options = {}
    if row == "published":
        for side in ("source", "target"):
            options[f"{side}_landmarks"] = np.loadtxt(pair / f"alignment_{side}.csv", delimiter=",")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.process_time()
    result = morph(source, target, PRESETS["standard" if row == "aligned" else row], **options)
    seconds = time.process_time() - started
    peak = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    if row == "aligned":
        return {"figures": result.before.as_dict()}
    marks, goals = (
        np.loadtxt(pair / f"{name}.csv", delimiter=",") for name in ("landmarks", "landmarks_authors_morphed")
    )
    apart = Stat.of(np.linalg.norm(result.apply(marks) - goals, axis=1)).as_dict()
    vertices = Stat.of(np.linalg.norm(result.vertices - authors, axis=1)).as_dict()
    return {
        "figures": result.after.as_dict(),
        "seconds": seconds,
        "megabytes": peak,
        "landmarks_from_the_authors": apart,
        "vertices_from_the_authors": vertices,
    }


def correspondence() -> dict[str, float]:
    """Error of every vertex of femur_small, whose target has the same triangles in the same order."""
    import numpy as np

    from femors_addon import meshfiles
    from femors_addon.morph import morph

    source, target = (
        meshfiles.read(DATA / "femur_small" / f"{name}.stl") for name in ("femur", "femur_target")
    )
    result = morph(source.surface(), target.surface())
    error = np.linalg.norm(result.vertices - target.vertices, axis=1)
    return {"mean": float(error.mean()), "p95": float(np.percentile(error, 95)), "max": float(error.max())}


def knee() -> list[dict[str, float | int | str]]:
    """Known maps of other bones: see `warps`."""
    import warps

    return warps.cases(DATA / "knee")


def others(found: dict[str, dict], knees: list[dict[str, float | int | str]]) -> str:
    """Return what the table has no column for."""
    import warps

    lines = ["", "From where the authors have them (median / 99th / maximum, mm):", ""]
    for row in ("published", "standard"):
        marks, vertices = (
            "{median:.2f} / {p99:.2f} / {maximum:.2f}".format(**found[row][f"{name}_from_the_authors"])
            for name in ("landmarks", "vertices")
        )
        lines.append(f"- {ROWS[row]}: their 31 landmarks {marks}, all vertices {vertices}")
    if knees:
        lines += [
            "",
            "Other bones under known smooth maps, meshed anew with 60 % of the nodes: error of every",
        ]
        lines += ["vertex in percent of the target's size, mean / 95th percentile:", "", warps.table(knees)]
    return "\n".join(lines)


def table(rows: dict[str, dict]) -> str:
    """Return the rows as a Markdown table: median / 99th / maximum."""
    head = ["", *COLUMNS.values(), "flipped", "crossing", "CPU", "memory"]
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for name, found in rows.items():
        cells = [ROWS[name]]
        for column in COLUMNS:
            stat = found["figures"][column]
            if name == "target" and column not in ("aspect", "dihedral"):
                cells.append("")
                continue
            cells.append(f"{stat['median']:.3f} / {stat['p99']:.3f} / {stat['maximum']:.2f}")
        cells += [str(found["figures"][count]) for count in ("flipped", "self_intersecting")]
        cells.append(f"{found['seconds']:.1f} s" if "seconds" in found else "")
        cells.append(f"{found['megabytes']:.0f} MB" if "megabytes" in found else "")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def into_readme(text: str) -> None:
    """Put the table between the marks in README.md."""
    path = ROOT / "README.md"
    start, stop = "<!-- bench:begin -->\n", "<!-- bench:end -->"
    readme = path.read_text(encoding="utf-8")
    before, rest = readme.split(start)
    path.write_text(before + start + text + "\n" + stop + rest.split(stop)[1], encoding="utf-8")


def main() -> int:
    """Run every row, print and write the table."""
    parser = argparse.ArgumentParser(description="Measure the morph on real bones")
    parser.add_argument("--readme", action="store_true", help="put the table into README.md")
    parser.add_argument("--row", choices=[*ROWS, "correspondence", "knee"], help=argparse.SUPPRESS)
    args = parser.parse_args()
    if not (DATA / "femur_pair" / "meshes.npz").exists():
        print(f"bench: {DATA} is not there; it needs the bones of ../shared/data (or FEMORS_DATA)")
        return 0
    if args.row:
        special = {"correspondence": correspondence, "knee": knee}.get(args.row)
        print(json.dumps(special() if special else one(args.row)))
        return 0
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    found = {}
    extra = ["correspondence"] if (DATA / "femur_small").is_dir() else []
    extra += ["knee"] if (DATA / "knee").is_dir() else []
    for row in (*ROWS, *extra):
        print(f"bench: {row}", file=sys.stderr)
        command = [sys.executable, __file__, "--row", row]
        done = subprocess.run(command, env={**os.environ, **threads}, stdout=subprocess.PIPE, check=True)
        found[row] = json.loads(done.stdout)
    small, knees = found.pop("correspondence", None), found.pop("knee", [])
    text = table(found)
    note = (
        ""
        if small is None
        else (
            "\n`femur_small`, whose target has the source's own vertices: the error of every vertex is "
            f"{small['mean']:.2f} mm in the mean, {small['p95']:.2f} at the 95th percentile, "
            f"{small['max']:.2f} at most."
        )
    )
    output = ROOT / "bench_output"
    output.mkdir(exist_ok=True)
    more = others(found, knees)
    (output / "morph.md").write_text(f"{text}\n{note}\n{more}\n", encoding="utf-8")
    (output / "morph.json").write_text(
        json.dumps({**found, "femur_small": small, "knee": knees}, indent=1), encoding="utf-8"
    )
    print(f"{text}\n{note}\n{more}\n\nwritten: {output / 'morph.md'} and morph.json")
    if args.readme:
        into_readme(f"{text}\n{note}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
