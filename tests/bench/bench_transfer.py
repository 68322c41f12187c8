# SPDX-License-Identifier: GPL-3.0-or-later
"""What the field carries, measured: sites and landmarks of real femora, and warps with known answers.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python tests/bench/bench_transfer.py

Prints Markdown, and writes it to bench_output/transfer.md. Real bones are left out where they are not.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from femors_addon import meshfiles, shapes  # noqa: E402
from femors_addon.carry import Carrier  # noqa: E402
from femors_addon.mesh import Surface, clean  # noqa: E402
from femors_addon.morph import MorphSettings, morph  # noqa: E402
from femors_addon.nearest import SurfaceIndex  # noqa: E402
from femors_addon.regions import RegionMap  # noqa: E402

DATA = Path(os.environ.get("FEMORS_DATA", ROOT.parent / "shared" / "data"))
PAIR, SMALL = DATA / "femur_pair", DATA / "femur_small"
WARPS = {
    "bend": (("bend", 0.15),),
    "twist": (("twist", 0.2),),
    "stretch": (("stretch", 0.06),),
    "bump": (("bump", 0.015),),
    "all of them": shapes.differences(1),
}
Float = NDArray[np.float64]


def loaded(path: Path) -> tuple[Surface, SurfaceIndex]:
    """Return a mesh of triangles, and its cleaned surface to be searched."""
    surface = meshfiles.read(path).surface()
    return surface, SurfaceIndex(clean(surface.vertices, surface.faces).surface)


def pair() -> list[str]:
    """Sites and landmarks of the authors' pair."""
    source, before = loaded(PAIR / "source.stl")
    target, after = loaded(PAIR / "target.stl")
    carrier = Carrier(morph(source, target).kept())
    ways = RegionMap(before.surface.moved(carrier.carry(before.surface.vertices).points), after.surface)
    lines = [
        "`femur_pair`, sites: median distance of the nodes from the bone. Area: the site painted on the",
        "source's vertices, on the target's mesh against the same carried.",
        "",
        "| site | on the source | the authors', on the target | ours | area | centroid |",
        "|---|---|---|---|---|---|",
    ]
    for path in sorted((PAIR / "sites").glob("*.stl")):
        patch, index = loaded(path)
        theirs = meshfiles.read(PAIR / "sites_authors_morphed" / path.name).vertices
        cells = [
            float(np.median(surface.closest(np.unique(points, axis=0)).distance))
            for surface, points in (
                (before, patch.vertices),
                (after, theirs),
                (after, carrier.carry(patch.vertices).points),
            )
        ]
        weights = (index.closest(before.surface.vertices).distance < 0.8).astype(float)
        area = ["", ""]
        if weights.sum() > 3:
            region = ways.region(weights)
            area = [f"{region.area_error:+.1%}", f"{region.centroid_error:.2f}"]
        lines.append("| " + " | ".join([path.stem, *(f"{cell:.3f}" for cell in cells), *area]) + " |")
    marks, theirs = (
        np.loadtxt(PAIR / f"{name}.csv", delimiter=",") for name in ("landmarks", "landmarks_authors_morphed")
    )
    ours = carrier.carry(marks).points
    offset = before.signed(marks)
    lines += [
        "",
        "The 31 landmarks: signed distance from the bone, on the source and carried, and how far ours are",
        "from the authors'.",
        "",
        "| landmark | source | the authors' | ours | apart |",
        "|---|---|---|---|---|",
    ]
    rows = np.column_stack((offset, after.signed(theirs), after.signed(ours)))
    apart = np.linalg.norm(ours - theirs, axis=1)
    for number, (row, far) in enumerate(zip(rows, apart, strict=True), 1):
        lines.append(f"| {number} | {row[0]:.2f} | {row[1]:.2f} | {row[2]:.2f} | {far:.2f} |")
    change = np.abs(rows[:, 1:] - rows[:, :1]).mean(axis=0)
    lines.append(
        f"| mean change of it | | {change[0]:.2f} | {change[1]:.2f} | median {np.median(apart):.2f} |"
    )
    return lines


def small() -> list[str]:
    """200 vertices of a femur whose target has the same vertices."""
    source, target = (loaded(SMALL / f"{name}.stl")[0] for name in ("femur", "femur_target"))
    rows = np.random.default_rng(0).choice(len(source.vertices), 200, replace=False)
    got = morph(source, target).apply(source.vertices[rows])
    error = np.linalg.norm(got - target.vertices[rows], axis=1)
    return [
        f"`femur_small`, 200 random vertices as landmarks: error {error.mean():.2f} in the mean, "
        f"{np.percentile(error, 95):.2f} at the 95th percentile, {error.max():.2f} at most."
    ]


def warps(nodes: int) -> list[str]:
    """Landmark errors of warps with known answers, without and with five steering landmarks."""
    lines = [
        f"Made-up femora of {nodes} nodes under known warps, meshed anew: mean error of 200 random landmarks",
        "in percent of the size; steered by five landmarks as far from each other as can be (residual: mm).",
        "",
        "| warp | not steered | steered | their residual, not steered | steered |",
        "|---|---|---|---|---|",
    ]
    source, other = shapes.bone(nodes), shapes.bone(nodes, lattice=1)
    rows = [int(np.argmax(source.vertices[:, 2]))]
    while len(rows) < 5:
        away = np.min([np.linalg.norm(source.vertices - source.vertices[r], axis=1) for r in rows], axis=0)
        rows.append(int(np.argmax(away)))
    marks = np.random.default_rng(0).choice(len(source.vertices), 200, replace=False)
    for name, steps in WARPS.items():
        target = other.moved(shapes.warp(other.vertices, *steps))
        truth = shapes.warp(source.vertices, *steps)
        errors, left = [], []
        for steer in (False, True):
            result = morph(
                source,
                target,
                MorphSettings(steer=steer),
                source_landmarks=source.vertices[rows],
                target_landmarks=truth[rows],
            )
            apart = np.linalg.norm(result.apply(source.vertices[marks]) - truth[marks], axis=1)
            errors.append(f"{100 * apart.mean() / target.diagonal:.2f}")
            assert result.steering is not None
            left.append(f"{result.steering.residual.mean():.2f}")
        lines.append("| " + " | ".join([name, *errors, *left]) + " |")
    return lines


def main() -> int:
    """Measure, print and write."""
    parts = [pair()] if (PAIR / "source.stl").exists() else []
    parts += [small()] if (SMALL / "femur.stl").exists() else []
    parts.append(warps(4000))
    text = "\n\n".join("\n".join(lines) for lines in parts)
    print(text)
    output = ROOT / "bench_output"
    output.mkdir(exist_ok=True)
    (output / "transfer.md").write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
