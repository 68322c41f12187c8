# SPDX-License-Identifier: GPL-3.0-or-later
"""The files that the manual's tutorials start from: made-up bones, cartilage, sites and landmarks, in mm.

    .venv/bin/python demo/tutorial.py [FOLDER]        (FOLDER is `tutorial` where nothing is said)

Writes femur.stl and scan.stl (two subjects' bones, meshed independently), landmarks.csv and two sites of
muscles on the first, cartilage.inp (an Abaqus deck on the first) and scan_cartilage.stl (the other's, as
a surface), and the bodies of a knee: knee_femur.stl, knee_tibia.stl, knee_patella.stl,
knee_cartilage_femur.inp, knee_cartilage_tibia.inp, which overlap.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from femors_addon import isosurface, landmarkfiles, shapes
from femors_addon.isosurface import Implicit
from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.volume import Block, VolumeMesh

MARKS = {
    "head": (-14.0, 4.0, 400.0),
    "greater_trochanter": (57.0, -5.0, 352.0),
    "lesser_trochanter": (19.0, -21.0, 301.0),
    "epicondyle_medial": (-39.0, -12.0, 24.0),
    "epicondyle_lateral": (40.0, -10.0, 24.0),
    "notch": (0.0, -12.0, 12.0),
}
"""Landmarks of the femur: laid on its surface from here."""
SITES = {"gluteus": ((54.0, -8.0, 348.0), 15.0), "iliopsoas": ((19.0, -20.0, 301.0), 11.0)}
"""Sites of muscles on the femur: what lies within a distance of a place."""
THICK = 2.5
"""Of a cartilage, in mm."""
LAYERS = 2
"""Of elements."""
JOINT = 4.0
"""Between femur and tibia, in mm: less than two cartilages need."""


def femur(points: np.ndarray) -> np.ndarray:
    """Implicit femur, as in `shapes.bone`."""
    return shapes._femur(points, shapes._Form())


def knee_femur(points: np.ndarray) -> np.ndarray:
    """The lower end of it."""
    return np.maximum(femur(points), points[:, 2] - 105.0)


def tibia(points: np.ndarray) -> np.ndarray:
    """A plateau that follows the femur at a distance, on a shaft."""
    plateau = shapes._ellipsoid(points, (0.0, -10.0, -14.0), (40.0, 30.0, 17.0))
    shaft = shapes._capsule(points, (0.0, -8.0, -28.0), (0.0, -12.0, -95.0), 20.0, 13.0)
    whole = shapes._join(plateau, shaft, 30.0)
    return np.maximum(shapes._carve(whole, femur(points) - JOINT, 3.0), -90.0 - points[:, 2])


def patella(points: np.ndarray) -> np.ndarray:
    """A kneecap before the groove, as far from the bone as 1.7 mm."""
    cap = shapes._ellipsoid(points, (0.0, 26.0, 38.0), (20.0, 13.0, 21.0))
    return shapes._carve(cap, femur(points) - 1.7, 3.0)


def raised(value: Implicit, low: np.ndarray, high: np.ndarray, thickness: np.ndarray) -> np.ndarray:
    """Return a cartilage's nodes: layers of a grid (k, u, v, 3), from the bone's surface outward.

    Parameters
    ----------
    value : callable
        The bone, implicit.
    low, high : (u, v, 3)
        Inside and outside the bone: the surface lies between.
    thickness : (u, v)
    """
    inside, outside = low.reshape(-1, 3).copy(), high.reshape(-1, 3).copy()
    for _ in range(40):
        middle = (inside + outside) / 2
        within = (value(middle) < 0)[:, None]
        inside, outside = np.where(within, middle, inside), np.where(within, outside, middle)
    slope = np.stack([value(inside + d) - value(inside - d) for d in 1e-3 * np.eye(3)], axis=1)
    normal = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    steps = np.arange(LAYERS + 1)[:, None, None] / LAYERS * thickness.reshape(1, -1, 1)
    return (inside + steps * normal).reshape(LAYERS + 1, *low.shape)


def femoral(across: int, along: int) -> np.ndarray:
    """Return the nodes of the femur's cartilage: from the groove over both condyles to their backs."""
    side, angle = np.meshgrid(np.linspace(-31.0, 32.0, across), np.linspace(0.75, -2.4, along), indexing="ij")
    ray = np.stack((0 * angle, np.cos(angle), np.sin(angle)), axis=-1)
    axis = np.stack((side, 0 * side - 6.0, 0 * side + 24.0), axis=-1)
    return raised(femur, axis, axis + 60.0 * ray, thinning(across, along))


def tibial(middle: float, cells: int) -> np.ndarray:
    """Return the nodes of a half of the tibia's cartilage: a rounded square seen from above."""
    u, v = np.meshgrid(*[np.linspace(-1.0, 1.0, cells)] * 2, indexing="ij")
    x, y = (12.0 * u * np.sqrt(1 - 0.3 * v**2), 14.0 * v * np.sqrt(1 - 0.3 * u**2))
    low = np.stack((x + middle, y - 13.0, 0 * x - 20.0), axis=-1)
    high = np.stack((x + middle, y - 13.0, 0 * x + 12.0), axis=-1)
    return raised(tibia, low, high, thinning(cells, cells))


def thinning(across: int, along: int) -> np.ndarray:
    """Return a thickness for each node of a grid: full inside, less towards the rim."""
    u, v = (np.minimum(np.linspace(0, 1, n), np.linspace(1, 0, n)) for n in (across, along))
    rim = np.minimum(np.minimum.outer(u, v) / 0.12, 1.0)
    return THICK * (0.45 + 0.55 * rim * (2 - rim))


def hexahedra(nodes: np.ndarray) -> np.ndarray:
    """Return the elements (m, 8) of a grid of nodes (k, u, v, 3), the outermost layer last."""
    n = np.arange(nodes[..., 0].size).reshape(nodes.shape[:3])
    low = n[:-1, :-1, :-1], n[:-1, 1:, :-1], n[:-1, 1:, 1:], n[:-1, :-1, 1:]
    high = n[1:, :-1, :-1], n[1:, 1:, :-1], n[1:, 1:, 1:], n[1:, :-1, 1:]
    rows = np.column_stack([corner.ravel() for corner in (*low, *high)])
    corners = nodes.reshape(-1, 3)[rows]
    edge = corners[:, [1, 3, 4]] - corners[:, [0]]
    left = np.linalg.det(edge).mean() < 0
    return rows[:, [0, 3, 2, 1, 4, 7, 6, 5]] if left else rows


def part(name: str, nodes: np.ndarray) -> list[str]:
    """Return the lines of a part of hexahedra, with sets, a surface and a section."""
    rows = hexahedra(nodes)
    lines = [f"*PART, NAME={name}", "*NODE"]
    lines += [f"{i}, {x:.6f}, {y:.6f}, {z:.6f}" for i, (x, y, z) in enumerate(nodes.reshape(-1, 3), 1)]
    lines.append("*ELEMENT, TYPE=C3D8, ELSET=SOFT")
    lines += [f"{i}, {', '.join(map(str, row + 1))}" for i, row in enumerate(rows, 1)]
    lines += [f"*NSET, NSET=BONE, GENERATE\n1, {nodes[0, ..., 0].size}, 1"]
    lines += [f"*ELSET, ELSET=OUTER, GENERATE\n{len(rows) - len(rows) // LAYERS + 1}, {len(rows)}, 1"]
    lines += ["*SURFACE, NAME=CONTACT, TYPE=ELEMENT\nOUTER, S2"]
    return [*lines, "*SOLID SECTION, ELSET=SOFT, MATERIAL=CARTILAGE", "*END PART"]


def deck(parts: dict[str, np.ndarray]) -> str:
    """Return an Abaqus deck with an assembly, a material and a step."""
    lines = ["*HEADING", "cartilage, made up for the manual of FEMORS; mm, N, MPa"]
    for name, nodes in parts.items():
        lines += part(name, nodes)
    lines.append("*ASSEMBLY, NAME=KNEE")
    for name in parts:
        lines += [f"*INSTANCE, NAME={name}-1, PART={name}", "*END INSTANCE"]
    lines += [
        "*END ASSEMBLY",
        "*MATERIAL, NAME=CARTILAGE",
        "*ELASTIC\n12., 0.45",
        "*STEP",
        "*STATIC\n0.1, 1.",
    ]
    lines += ["*BOUNDARY", *(f"{name}-1.BONE, 1, 3" for name in parts), "*END STEP"]
    return "\n".join(lines) + "\n"


def write_stl(path: Path, surface: Surface) -> None:
    """Write a binary STL."""
    corners = surface.vertices[surface.faces].astype("<f4")
    record = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    record["normal"] = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    record["corners"] = corners
    head = b"made up for the manual of FEMORS".ljust(80) + np.uint32(len(corners)).astype("<u4").tobytes()
    path.write_bytes(head + record.tobytes())


def centres(surface: Surface) -> np.ndarray:
    """Return the middles of the faces (m, 3)."""
    return surface.vertices[surface.faces].mean(axis=1)


def bones(out: Path) -> None:
    """Write the two femora, and what belongs to the first."""
    steps = (*shapes.differences(2, 1.5), ("turn", 0.4), ("shift", 0.3))
    one, two = shapes.bone(3000), shapes.bone(3400, lattice=1)
    write_stl(out / "femur.stl", one)
    write_stl(out / "scan.stl", Surface(shapes.warp(two.vertices, *steps), two.faces))
    index = SurfaceIndex(one)
    points = index.closest(np.array(list(MARKS.values()))).point
    marks = landmarkfiles.Landmarks(points, tuple(MARKS))
    (out / "landmarks.csv").write_bytes(landmarkfiles.encoded("landmarks.csv", marks))
    for name, (centre, reach) in SITES.items():
        near = np.linalg.norm(centres(one) - centre, axis=1) < reach
        patch, faces = np.unique(one.faces[near], return_inverse=True)
        lifted = one.vertices[patch] + 0.4 * one.vertex_normals[patch]
        write_stl(out / f"{name}.stl", Surface(lifted, faces.reshape(-1, 3)))
    (out / "cartilage.inp").write_text(deck({"CARTILAGE": femoral(38, 52)}))
    nodes = femoral(34, 47)
    write_stl(out / "scan_cartilage.stl", skin(shapes.warp(nodes.reshape(-1, 3), *steps), hexahedra(nodes)))


def skin(nodes: np.ndarray, rows: np.ndarray) -> Surface:
    """Return the outer surface of hexahedra."""
    block = Block("hex8", rows, np.arange(len(rows)) + 1)
    return VolumeMesh(nodes, (block,), np.arange(len(nodes)) + 1).surface()[0]


def knee(out: Path) -> None:
    """Write the bodies of a knee."""
    box = np.array([-60.0, -65.0, -110.0]), np.array([60.0, 60.0, 115.0])
    for number, (name, value) in enumerate(
        (("femur", knee_femur), ("tibia", tibia), ("patella", patella)), 4
    ):
        count = {"femur": 4000, "tibia": 3000, "patella": 900}[name]
        write_stl(out / f"knee_{name}.stl", isosurface.meshed(value, *box, count, number))
    (out / "knee_cartilage_femur.inp").write_text(deck({"FEMORAL": femoral(36, 50)}))
    sides = {"TIBIAL-MED": tibial(-23.0, 18), "TIBIAL-LAT": tibial(24.0, 18)}
    (out / "knee_cartilage_tibia.inp").write_text(deck(sides))


def main() -> int:
    """Write all files and say what they are."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "tutorial")
    out.mkdir(parents=True, exist_ok=True)
    bones(out)
    knee(out)
    for path in sorted(out.iterdir()):
        print(f"{path}  ({path.stat().st_size / 1024:.0f} kB)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
