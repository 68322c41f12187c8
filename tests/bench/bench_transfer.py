# SPDX-License-Identifier: GPL-3.0-or-later
"""What the field carries, measured: sites and landmarks of real femora, and warps with known answers.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python tests/bench/bench_transfer.py [--docs]

Prints Markdown, and writes it to bench_output/transfer.md; ``--docs`` puts it into docs/landmarks.md. Real
bones are left out where they are not.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

sys.path.insert(0, str(Path(__file__).resolve().parent))

import warps as random_maps  # noqa: E402

from femors_addon import deckfiles, meshfiles, shapes  # noqa: E402
from femors_addon.carry import Carrier  # noqa: E402
from femors_addon.cleaning import clean  # noqa: E402
from femors_addon.mesh import Surface  # noqa: E402
from femors_addon.morph import MorphSettings, morph  # noqa: E402
from femors_addon.nearest import SurfaceIndex  # noqa: E402
from femors_addon.reduce import reduced  # noqa: E402
from femors_addon.regions import RegionMap  # noqa: E402

DATA = Path(os.environ.get("FEMORS_DATA", ROOT.parent / "shared" / "data"))
PAIR, SMALL, KNEE = DATA / "femur_pair", DATA / "femur_small", DATA / "knee"
WARPS = {
    "bend": (("bend", 0.15),),
    "twist": (("twist", 0.2),),
    "stretch": (("stretch", 0.06),),
    "bump": (("bump", 0.015),),
    "all of them": shapes.differences(1),
    "bend, twice": (("bend", 0.3),),
    "twist, 2.5 times": (("twist", 0.5),),
    "bump, twice": (("bump", 0.03),),
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
        "source's vertices, weighted on the target's mesh against the same carried; and what the target has",
        "with a weight of 0.5 and more.",
        "",
        "| site | on the source | the authors', on the target | ours | area | of 0.5 and more | centroid |",
        "|---|---|---|---|---|---|---|",
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
        area = ["", "", ""]
        if weights.sum() > 3:
            region = ways.region(weights)
            half = (region.weights >= 0.5)[after.surface.faces].mean(axis=1)
            hard = float(after.surface.face_areas @ half) / region.goal - 1.0
            area = [f"{region.area_error:+.1%}", f"{hard:+.1%}", f"{region.centroid_error:.2f}"]
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
    known = farthest(marks, 5)
    steered = morph(
        source,
        target,
        MorphSettings(steer=True),
        source_landmarks=marks[known],
        target_landmarks=theirs[known],
    )
    rest = np.setdiff1d(np.arange(len(marks)), known)
    far = np.linalg.norm(steered.apply(marks[rest]) - theirs[rest], axis=1)
    lines += [
        "",
        f"Steered by 5 of them as far from each other as can be, the other {len(rest)} are "
        f"{np.median(far):.2f} from the authors' in the median, and {np.median(apart[rest]):.2f} without.",
    ]
    return lines


def farthest(points: Float, count: int) -> list[int]:
    """Return rows of points as far from each other as can be, the highest first."""
    rows = [int(np.argmax(points[:, 2]))]
    while len(rows) < count:
        away = np.min([np.linalg.norm(points - points[r], axis=1) for r in rows], axis=0)
        rows.append(int(np.argmax(away)))
    return rows


def cartilage() -> list[str]:
    """A cartilage carried onto its bone under a random map, whose mesh is the same or reduced."""
    bone = random_maps.read_shell(KNEE / "bone_femur.inp")
    deck = deckfiles.read_deck(KNEE / "cartilage_femur_hex.inp")
    low, high = bone.bounds
    nodes = deck.coordinates

    def there(points: Float) -> Float:
        return random_maps.warped(points, bone.diagonal, (low + high) / 2, 1)

    whole = bone.moved(there(bone.vertices))
    lines = [
        f"A femoral cartilage of {len(nodes)} nodes, carried by the field of its bone onto the bone under",
        f"the random map 1 of `tests/bench/warps.py` (size {bone.diagonal:.0f} mm); how far the nodes are",
        "from where that map takes them:",
        "",
        "| target's mesh | mean | 95th percentile | at most |",
        "|---|---|---|---|",
    ]
    for words, target in (
        ("that of the source", whole),
        ("reduced to 60 %", reduced(whole, int(0.6 * len(whole.vertices)))),
    ):
        got = Carrier(morph(bone, target).kept()).carry(nodes).points
        far = np.linalg.norm(got - there(nodes), axis=1)
        lines.append(f"| {words} | {far.mean():.2f} | {np.percentile(far, 95):.2f} | {far.max():.2f} |")
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


def at_the_ends(points: Float) -> list[int]:
    """Return five rows of points where people put landmarks: three at the condyles, two at the top."""
    height = (points[:, 2] - points[:, 2].min()) / np.ptp(points[:, 2])
    low, high = np.flatnonzero(height < 0.12), np.flatnonzero(height > 0.85)
    chosen = [low[np.argmax(points[low] @ way)] for way in ([1, 0, 0], [-1, 0, 0], [0, 1, 0])]
    chosen += [high[np.argmax(points[high] @ way)] for way in ([0, 0, 1], [-1, 0, 0])]
    return [int(row) for row in chosen]


def warps(nodes: int) -> list[str]:
    """Landmark errors of warps with known answers, without and with five steering landmarks."""
    source, other = shapes.bone(nodes), shapes.bone(nodes, lattice=1)
    points = source.vertices
    places = {"none": [], "apart": farthest(points, 5), "ends": at_the_ends(points)}
    lines = [
        f"Made-up femora of {nodes} nodes under known warps, meshed anew: mean error of 400 random landmarks",
        "in percent of the size, all (at the ends, along the shaft); steered by five landmarks as far from",
        "each other as can be, or by five at the ends; their mean residual in mm.",
        "",
        "| warp | not steered | five far apart | residual | five at the ends | residual |",
        "|---|---|---|---|---|---|",
    ]
    marks = np.random.default_rng(7).choice(len(points), 400, replace=False)
    height = (points[marks, 2] - points[:, 2].min()) / np.ptp(points[:, 2])
    shaft = (height > 0.2) & (height < 0.8)
    for name, steps in WARPS.items():
        target = other.moved(shapes.warp(other.vertices, *steps))
        truth = shapes.warp(points, *steps)
        cells = []
        for rows in places.values():
            pairs = {"source_landmarks": points[rows], "target_landmarks": truth[rows]} if rows else {}
            result = morph(source, target, MorphSettings(steer=bool(rows)), **pairs)
            far = np.linalg.norm(result.apply(points[marks]) - truth[marks], axis=1) / target.diagonal * 100
            cells.append(f"{far.mean():.2f} ({far[~shaft].mean():.2f}, {far[shaft].mean():.2f})")
            if result.steering is not None:
                cells.append(f"{result.steering.residual.mean():.2f}")
        lines.append("| " + " | ".join([name, *cells]) + " |")
    return lines


def main() -> int:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--docs", action="store_true", help="put it into docs/landmarks.md")
    docs = parser.parse_args().docs
    parts = [pair()] if (PAIR / "source.stl").exists() else []
    parts += [small()] if (SMALL / "femur.stl").exists() else []
    parts += [cartilage()] if (KNEE / "bone_femur.inp").exists() else []
    parts.append(warps(4000))
    text = "\n\n".join("\n".join(lines) for lines in parts)
    print(text)
    output = ROOT / "bench_output"
    output.mkdir(exist_ok=True)
    (output / "transfer.md").write_text(text + "\n", encoding="utf-8")
    if docs:
        path = ROOT / "docs" / "landmarks.md"
        start, stop = "<!-- bench:begin -->\n", "<!-- bench:end -->"
        before, rest = path.read_text(encoding="utf-8").split(start)
        path.write_text(before + start + text + "\n" + stop + rest.split(stop)[1], encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
