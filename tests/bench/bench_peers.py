# SPDX-License-Identifier: GPL-3.0-or-later
"""``make bench``: our morph and what users would pick instead, on the same pair in the same run.

    .venv/bin/python tests/bench/bench_peers.py [--quick] [--docs] [--python PATH]

Every tool starts from the same affine alignment, ours included in our time alone, each in a process of its
own with one thread. ``--python`` is the interpreter of an environment with requirements/bench.txt. Writes
bench_output/peers.md, peers.json, and plots where matplotlib is there; ``--docs`` writes them to docs/ too.
``--quick`` leaves out the peers that take a minute and more.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("FEMORS_DATA", ROOT.parent / "shared" / "data"))
OUTPUT = ROOT / "bench_output"
BENCH_PYTHON = next(Path("~/.cache/femors").expanduser().glob("bench-[0-9]*/bin/python"), None)
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "bench")]

NAMES = {
    "femors": "FEMORS, *Standard*",
    "shrinkwrap": "Blender's Shrinkwrap, nearest surface",
    "rbf": "RBF morph, SciPy's RBFInterpolator",
    "amberg_soft": "trimesh nricp_amberg, soft steps",
    "amberg": "trimesh nricp_amberg, defaults",
    "cpd": "pycpd deformable, 3k points, carried",
}
QUICK = ("femors", "shrinkwrap")
SIZES, QUICK_SIZES = (6_000, 12_000, 24_000, 48_000, 96_000), (3_000, 6_000, 12_000)
COLUMNS = {
    "surface_to_target": "surface s→t",
    "target_to_surface": "surface t→s",
    "aspect": "aspect ratio",
    "dihedral": "dihedral",
}
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def ours(where: Path) -> dict[str, Any]:
    """Morph the pair, and leave its affine alignment to the others."""
    import resource
    import time

    import numpy as np
    from counting import counting

    from femors_addon.cleaning import clean
    from femors_addon.mesh import Surface
    from femors_addon.morph import morph
    from femors_addon.transforms import transformed

    with np.load(DATA / "femur_pair" / "meshes.npz") as meshes:
        pair = [Surface(meshes[f"{side}_vertices"], meshes[f"{side}_faces"]) for side in ("source", "target")]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    cpu, wall = time.process_time(), time.perf_counter()
    result = morph(*pair)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    peak = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    with counting() as counts:
        morph(*pair)
    cleaned = [clean(surface.vertices, surface.faces).surface for surface in pair]
    np.savez(
        where / "pair.npz",
        source_vertices=transformed(result.transform, cleaned[0].vertices),
        source_faces=cleaned[0].faces,
        target_vertices=cleaned[1].vertices,
        target_faces=cleaned[1].faces,
        unaligned=cleaned[0].vertices,
    )
    figures = result.after.as_dict()
    return {"seconds": cpu, "wall": wall, "megabytes": peak, "figures": figures, "counts": dict(counts)}


def judged(where: Path, row: str) -> dict[str, Any]:
    """Measure what a peer has left."""
    import numpy as np

    from femors_addon.mesh import Surface
    from femors_addon.quality import compare

    with np.load(where / "pair.npz") as pair, np.load(where / f"{row}.npz") as moved:
        start = Surface(pair["source_vertices"], pair["source_faces"])
        target = Surface(pair["target_vertices"], pair["target_faces"])
        return compare(start, start.moved(moved["vertices"]), target).as_dict()


def grown(nodes: int) -> dict[str, Any]:
    """Morph bones of our own making with so many nodes."""
    import resource
    import time

    from femors_addon import shapes
    from femors_addon.morph import morph

    pair = shapes.pair(nodes, nodes)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    cpu = time.process_time()
    morph(pair.source, pair.target)
    cpu = time.process_time() - cpu
    peak = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    return {"nodes": len(pair.source.vertices), "seconds": cpu, "megabytes": peak}


def called(python: str | Path, *arguments: str) -> dict[str, Any]:
    """Run Python with arguments in one thread; return the last line it prints, as JSON."""
    done = subprocess.run(
        [str(python), *arguments],
        env={**os.environ, **THREADS},
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    )
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return found


def table(rows: dict[str, dict[str, Any]]) -> str:
    """Return the rows as a Markdown table: median / 99th percentile / maximum, and ratios to ours."""
    head = ["", "CPU s", "to ours", "wall s", "memory MB", *COLUMNS.values(), "flipped", "crossing"]
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for name, row in rows.items():
        figures = row["figures"]
        cells = [NAMES[name], f"{row['seconds']:.1f}", f"{row['seconds'] / rows['femors']['seconds']:.1f} x"]
        cells += [f"{row['wall']:.1f}", f"{row['megabytes']:.0f}"]
        cells += ["{median:.3f} / {p99:.3f} / {maximum:.2f}".format(**figures[column]) for column in COLUMNS]
        cells += [str(figures["flipped"]), str(figures["self_intersecting"])]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def growth(sizes: list[dict[str, Any]]) -> str:
    """Return CPU and memory by nodes as a Markdown table."""
    lines = ["| nodes of each | CPU s | growth per doubling | memory MB |", "|---|---|---|---|"]
    for before, row in zip([None, *sizes], sizes, strict=False):
        rate = ""
        if before is not None:
            doublings = _log2(row["nodes"] / before["nodes"])
            rate = f"{(row['seconds'] / before['seconds']) ** (1 / doublings):.2f} x"
        lines.append(f"| {row['nodes']:,} | {row['seconds']:.1f} | {rate} | {row['megabytes']:.0f} |")
    return "\n".join(lines)


def _log2(value: float) -> float:
    import math

    return math.log2(value)


PLOT = """
import json, sys
import matplotlib, matplotlib.ticker; matplotlib.use("Agg")
import matplotlib.pyplot as plt
found, names, out = json.load(open(sys.argv[1])), json.loads(sys.argv[2]), sys.argv[3]
figure, (one, two) = plt.subplots(1, 2, figsize=(11, 4.5))
for name, row in found["rows"].items():
    p99 = row["figures"]["target_to_surface"]["p99"]
    one.loglog(row["seconds"], p99, "o", color="C3" if name == "femors" else "C0")
    right = row["seconds"] > 10  # the names of the slow ones stand to the left, within the plot
    place = dict(xytext=(-6, -11), ha="right") if right else dict(xytext=(6, -11 if name == "femors" else 4))
    label = dict(place, textcoords="offset points", fontsize=7)
    one.annotate(names[name].replace("*", ""), (row["seconds"], p99), **label)
one.set(xlabel="CPU seconds", ylabel="target to result, 99th percentile (mm)", title="Accuracy against time")
one.margins(0.25)
nodes = [row["nodes"] for row in found["growth"]]
two.loglog(nodes, [row["seconds"] for row in found["growth"]], "o-", color="C3")
two.set(xlabel="nodes of each mesh", ylabel="CPU seconds", title="Growth")
for axis in (one.xaxis, one.yaxis, two.xaxis, two.yaxis):
    axis.set_major_locator(matplotlib.ticker.LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:,g}")
    axis.set_minor_formatter("")
figure.tight_layout(); figure.savefig(out, dpi=110)
"""


def measured(where: Path, python: Path | None, quick: bool) -> dict[str, Any]:
    """Run all rows and sizes."""
    rows = {}
    for row in QUICK if quick else NAMES:
        print(f"bench: {row}", file=sys.stderr)
        try:
            if row == "femors":
                rows[row] = called(sys.executable, __file__, "--row", row, "--where", str(where))
                continue
            tool = sys.executable if row == "shrinkwrap" else python or sys.executable
            script = str(Path(__file__).with_name("peer_tools.py"))
            rows[row] = called(tool, script, row, str(where / "pair.npz"), str(where / f"{row}.npz"))
            rows[row]["figures"] = called(sys.executable, __file__, "--row", row, "--where", str(where))
        except (OSError, subprocess.CalledProcessError) as error:
            rows.pop(row, None)
            print(f"bench: {row} left out: {error}", file=sys.stderr)
    sizes = []
    for nodes in QUICK_SIZES if quick else SIZES:
        print(f"bench: {nodes} nodes", file=sys.stderr)
        sizes.append(called(sys.executable, __file__, "--nodes", str(nodes)))
    return {"rows": rows, "growth": sizes}


def main() -> int:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description="Measure the morph beside other tools")
    parser.add_argument("--quick", action="store_true", help="without the slow peers and large meshes")
    parser.add_argument("--docs", action="store_true", help="write table and plot to docs/ too")
    parser.add_argument("--python", type=Path, default=BENCH_PYTHON, help="Python that has the peers")
    parser.add_argument("--row", help=argparse.SUPPRESS)
    parser.add_argument("--nodes", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--where", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.nodes:
        print(json.dumps(grown(args.nodes)))
        return 0
    if not (DATA / "femur_pair" / "meshes.npz").exists():
        print(f"bench: {DATA} is not there; it needs the bones of ../shared/data (or FEMORS_DATA)")
        return 0
    if args.row:
        print(json.dumps(ours(args.where) if args.row == "femors" else judged(args.where, args.row)))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        found = measured(Path(folder), args.python, args.quick)
    text = f"{table(found['rows'])}\n\n{growth(found['growth'])}\n\n| operation | count |\n|---|---|\n"
    text += "".join(f"| {name} | {n:,} |\n" for name, n in sorted(found["rows"]["femors"]["counts"].items()))
    OUTPUT.mkdir(exist_ok=True)
    (OUTPUT / "peers.md").write_text(text, encoding="utf-8")
    (OUTPUT / "peers.json").write_text(json.dumps(found, indent=1), encoding="utf-8")
    print(text + f"\nwritten: {OUTPUT}/peers.md and peers.json")
    if args.python is not None and args.python.exists():
        plot = [
            str(args.python),
            "-c",
            PLOT,
            str(OUTPUT / "peers.json"),
            json.dumps(NAMES),
            str(OUTPUT / "peers.png"),
        ]
        subprocess.run(plot, check=False)
    if args.docs:
        into_docs(text)
    return 0


def into_docs(text: str) -> None:
    """Put the tables between the marks in docs/speed.md, and the plot beside its images."""
    path, start, stop = ROOT / "docs" / "speed.md", "<!-- bench:begin -->\n", "<!-- bench:end -->"
    before, rest = path.read_text(encoding="utf-8").split(start)
    path.write_text(before + start + text + stop + rest.split(stop)[1], encoding="utf-8")
    if (OUTPUT / "peers.png").exists():
        shutil.copy(OUTPUT / "peers.png", ROOT / "docs" / "images" / "speed.png")


if __name__ == "__main__":
    raise SystemExit(main())
