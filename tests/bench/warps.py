# SPDX-License-Identifier: GPL-3.0-or-later
"""Real bones under known smooth maps: how far each vertex ends from where it truly belongs.

The target is the bone itself, warped by a random smooth map (seeded), posed, and reduced to fewer
nodes, so that the two share none. What the alignment alone leaves, and what is left when its nodes are
laid on the nearest points of the target, stand beside.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from femors_addon.cleaning import clean
from femors_addon.mesh import Surface
from femors_addon.morph import morph
from femors_addon.nearest import SurfaceIndex
from femors_addon.reduce import reduced
from femors_addon.transforms import transformed

BONES = ("bone_femur", "bone_patella", "bone_tibia_fibula")
SEEDS = (1, 2)
SHARE = 0.6  # of the nodes that the target keeps
Float = NDArray[np.float64]


def read_shell(path: Path) -> Surface:
    """Read the nodes and the R3D3 triangles of an Abaqus deck; nothing else of it."""
    nodes: dict[int, list[float]] = {}
    faces: list[list[int]] = []
    keyword = ""
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("*"):
            if not line.startswith("**"):
                keyword = line.upper().replace(" ", "")
            continue
        fields = [field for field in line.split(",") if field.strip()]
        if keyword.startswith("*NODE") and len(fields) == 4:
            nodes[int(fields[0])] = [float(field) for field in fields[1:]]
        elif keyword.startswith("*ELEMENT,TYPE=R3D3") and len(fields) == 4:
            faces.append([int(field) for field in fields[1:]])
    rank = {name: i for i, name in enumerate(nodes)}
    surface = Surface(list(nodes.values()), [[rank[name] for name in face] for face in faces])
    return clean(surface.vertices, surface.faces, path.name).surface


def warped(points: Float, size: float, centre: Float, seed: int) -> Float:
    """A random map: up to 10 % of stretch and shear, and smooth bumps of 1 to 4 % of the size."""
    rng = np.random.default_rng(seed)
    local = (points - centre) / size
    out = local @ (np.eye(3) + rng.uniform(-0.1, 0.1, (3, 3)))
    for _ in range(8):
        place, width = rng.uniform(-0.5, 0.5, 3), rng.uniform(0.15, 0.35)
        bump = rng.normal(size=3)
        bump *= rng.uniform(0.01, 0.04) / np.linalg.norm(bump)
        out = out + np.exp(-0.5 * np.sum((local - place) ** 2, axis=1) / width**2)[:, None] * bump
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    return (out @ turn) * size + centre + rng.normal(size=3) * size


def case(path: Path, seed: int) -> dict[str, float | int | str]:
    """Morph one bone onto its warped self; errors in percent of the target's size."""
    source = read_shell(path)
    low, high = source.bounds
    truth = warped(source.vertices, source.diagonal, (low + high) / 2, seed)
    whole = source.moved(truth)
    target = reduced(whole, int(SHARE * len(source.vertices)))
    result = morph(source, target)
    aligned = transformed(result.transform, source.vertices)
    projected = SurfaceIndex(target).closest(aligned).point
    errors = {
        "aligned": aligned,
        "projected": projected,
        "morphed": result.vertices,
    }
    out: dict[str, float | int | str] = {"bone": path.stem, "seed": seed, "nodes": len(source.vertices)}
    for name, points in errors.items():
        error = 100.0 * np.linalg.norm(points - truth, axis=1) / target.diagonal
        out[f"{name}_mean"], out[f"{name}_p95"] = float(error.mean()), float(np.percentile(error, 95))
    out["folded"] = result.after.flipped + result.after.self_intersecting
    out["seconds"] = result.seconds
    return out


def cases(folder: Path) -> list[dict[str, float | int | str]]:
    """Run all bones under all maps."""
    return [case(folder / f"{bone}.inp", seed) for bone in BONES for seed in SEEDS]


def table(found: list[dict[str, float | int | str]]) -> str:
    """Return the cases as a Markdown table: mean / 95th percentile of the error."""
    lines = [
        "| bone, map | nodes | aligned | and projected | morphed | folded or crossing | CPU |",
        "|---" * 7 + "|",
    ]
    for row in found:
        cells = [f"{row['bone']}, {row['seed']}", str(row["nodes"])]
        cells += [
            f"{row[f'{name}_mean']:.2f} / {row[f'{name}_p95']:.2f}"
            for name in ("aligned", "projected", "morphed")
        ]
        cells += [str(row["folded"]), f"{row['seconds']:.1f} s"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
