# SPDX-License-Identifier: GPL-3.0-or-later
"""The pictures of the manual's tutorials, made from their own files by the command line and Cycles.

    .venv/bin/python demo/pictures.py [--out docs/images] [--only bone,deck,sites,knee]

Runs the tutorials' commands on the files of ``tutorial.py`` in a folder of its own and renders what goes
in and what comes out. No picture needs a window; those of Blender's window are made by
``window_pictures.py``.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

# isort: off
import bpy  # first: it brings the next ones
import bmesh
from mathutils import Matrix, Vector

# isort: on
import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
sys.path.insert(0, str(HERE))

import picture  # noqa: E402
from run import silenced  # noqa: E402
from smallpng import shrink  # noqa: E402

from femors_addon import deckfiles, landmarkfiles  # noqa: E402
from femors_addon.deck import Deck  # noqa: E402

BONE, SOFT, OTHER = (0.86, 0.78, 0.64, 1.0), (0.13, 0.45, 0.55, 1.0), (0.80, 0.42, 0.12, 1.0)
RED = (0.75, 0.09, 0.06, 1.0)
KNEE = (
    *("knee_femur.stl", "knee_tibia.stl", "knee_patella.stl"),
    *("knee_cartilage_femur.inp", "knee_cartilage_tibia.inp"),
)


def femors(folder: Path, *arguments: str) -> None:
    """Run the command line in a folder."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(HERE.parent)}
    command = [sys.executable, "-m", "femors_addon", *arguments, "--quiet"]
    subprocess.run(command, cwd=folder, env=environment, check=True)


def polygons(path: Path) -> list[tuple[np.ndarray, list[tuple[int, ...]]]]:
    """Return the vertices and outer faces of each part of a file, quadrilaterals as such."""
    thing = deckfiles.read(path)
    if not isinstance(thing, Deck):
        surface = thing.surface()
        points, index = np.unique(surface.vertices, axis=0, return_inverse=True)
        return [(points, [tuple(face) for face in index.reshape(-1)[surface.faces].tolist()])]
    found = []
    for part in thing.parts.values():
        mesh, _ = thing.submesh(part)
        outer = mesh.boundary
        ends = np.cumsum(outer.sizes)
        corners = np.split(outer.corners, ends[:-1])
        found.append((mesh.nodes, [tuple(face.tolist()) for face in corners]))
    return found


class Stage:
    """A scene that is lit and seen from one side, without perspective."""

    def __init__(self, name: str, width: float, height: float, look: Matrix, pixels: int = 1100) -> None:
        bpy.ops.wm.read_homefile(use_empty=True)
        self.scene = bpy.data.scenes.new(name)
        self.look, self.pixels, self.shape = look.to_3x3().to_4x4(), pixels, (width, height)
        picture.light(self.scene)
        lens = bpy.data.cameras.new("Camera")
        lens.type, lens.ortho_scale, lens.clip_end = "ORTHO", max(width, height), 5000.0
        self.camera = bpy.data.objects.new("Camera", lens)
        self.scene.collection.objects.link(self.camera)
        self.scene.camera = self.camera
        self.camera.matrix_world = self.look @ Matrix.Translation((width / 2, height / 2, 1500))
        for item in self.scene.collection.objects:
            if item.type == "LIGHT":  # those of the demonstration look along -y
                item.data.energy *= 1.6
                item.matrix_world = self.look @ picture.FACING.inverted() @ item.matrix_world
        self.scene.render.resolution_x = pixels
        self.scene.render.resolution_y = 2 * round(pixels * height / width / 2)

    def at(self, x: float, y: float, motion: Matrix | None = None, deep: float = 0.0) -> Matrix:
        """Return where a thing goes whose own frame is moved to a place of the picture."""
        return self.look @ Matrix.Translation((x, y, deep)) @ self.look.inverted() @ (motion or Matrix())

    def show(self, path: Path, where: Matrix, colour: Any, wire: float = 0.0, smooth: bool = True) -> None:
        """Put a file's surfaces into the picture."""
        for points, faces in polygons(path):
            self.mesh(points, faces, where, colour, wire, smooth)

    def mesh(
        self, points: Any, faces: Any, where: Matrix, colour: Any, wire: float = 0.0, smooth: bool = True
    ) -> Any:
        """Put a mesh into the picture, its edges over it where a thickness is given."""
        mesh = bpy.data.meshes.new("Mesh")
        mesh.from_pydata([tuple(point) for point in points], [], faces)
        if smooth:
            mesh.shade_smooth()
        mesh.materials.append(material(colour))
        item = bpy.data.objects.new("Thing", mesh)
        item.matrix_world = where
        self.scene.collection.objects.link(item)
        if wire:
            edges = item.copy()
            self.scene.collection.objects.link(edges)
            modifier = edges.modifiers.new("Edges", "WIREFRAME")
            modifier.thickness, modifier.use_even_offset, modifier.offset = wire, False, 0.3
            edges.material_slots[0].link = "OBJECT"
            edges.material_slots[0].material = material((0.05, 0.04, 0.03, 1.0))
        return item

    def ball(self, point: Any, where: Matrix, radius: float) -> None:
        """Put a small red ball at a landmark."""
        mesh = bpy.data.meshes.new("Ball")
        drawn = bmesh.new()
        bmesh.ops.create_uvsphere(drawn, u_segments=24, v_segments=12, radius=radius)
        drawn.to_mesh(mesh)
        drawn.free()
        mesh.shade_smooth()
        mesh.materials.append(material(RED))
        item = bpy.data.objects.new("Ball", mesh)
        item.matrix_world = where @ Matrix.Translation(Vector(point))
        self.scene.collection.objects.link(item)

    def words(self, text: str, x: float, y: float, size: float, faint: bool = False) -> None:
        """Write a line, centred."""
        curve = bpy.data.curves.new("Text", "FONT")
        curve.body, curve.size, curve.align_x = text, size, "CENTER"
        curve.materials.append(material((0.16, 0.17, 0.2, 1.0) if faint else picture.INK, glow=True))
        item = bpy.data.objects.new("Text", curve)
        item.matrix_world = self.look @ Matrix.Translation((x, y, 600))
        self.scene.collection.objects.link(item)

    def render(self, path: Path, samples: int = 16) -> None:
        """Write the PNG."""
        with silenced():
            picture.render(self.scene, path, samples, picture.WIDTH)
            shrink(path)
        print(f"{path}  ({path.stat().st_size / 1024:.0f} kB)", flush=True)


def material(colour: Any, glow: bool = False) -> Any:
    """Return the material of a colour; one for all that have it."""
    name = f"{colour} {glow}"
    found = bpy.data.materials.get(name[:60])
    if found is not None:
        return found
    made = picture.plain(name[:60], colour, 0.55)
    if glow:
        nodes, links = made.node_tree.nodes, made.node_tree.links
        shader = nodes.new("ShaderNodeEmission")
        shader.inputs["Color"].default_value = colour
        links.new(shader.outputs["Emission"], nodes["Material Output"].inputs["Surface"])
    return made


FRONT = picture.FACING
"""Looks along -y: what is in front is seen from the front."""


def bone(folder: Path, out: Path) -> None:
    """Two bones as they come, and the first in the other's shape, in the other's place."""
    stage = Stage("bone", 660.0, 510.0, FRONT, 1000)
    stage.show(folder / "femur.stl", stage.at(110, 40), BONE, 0.45)
    stage.show(folder / "scan.stl", stage.at(395, 175), OTHER, 0.45)
    stage.show(folder / "femur_as_scan.stl", stage.at(615, 175), BONE, 0.45)
    for x, title, line in (
        (110, "femur.stl", "source: 3018 nodes"),
        (320, "scan.stl", "target: 3424 nodes, in its own pose"),
        (540, "femur_as_scan.stl", "result: the source's 3018 nodes"),
    ):
        stage.words(title, x, 492, 17)
        stage.words(line, x, 473, 11, faint=True)
    stage.render(out / "tutorial_bone.png")


def cartilage(folder: Path, out: Path) -> None:
    """A deck before and after, and the shape that it was to take."""
    stage = Stage("deck", 300.0, 108.0, FRONT)
    back = np.linalg.inv(placement(folder))
    home = Matrix(back.tolist())
    for x, name, where, colour, title, line in (
        (50, "cartilage.inp", None, SOFT, "cartilage.inp", "5928 nodes, 3774 C3D8"),
        (150, "scan_cartilage.stl", home, OTHER, "scan_cartilage.stl", "a surface of triangles"),
        (250, "cartilage_as_scan.inp", home, SOFT, "cartilage_as_scan.inp", "the same nodes and elements"),
    ):
        tilt = Matrix.Rotation(np.radians(20), 4, "X") @ Matrix.Rotation(np.radians(-25), 4, "Z")
        motion = where or Matrix()
        points = np.concatenate([found for found, _ in polygons(folder / name)])
        centre = Matrix.Translation(-(motion @ Vector(points.mean(axis=0))))
        stage.show(folder / name, stage.at(x, 40, tilt @ centre @ motion), colour, 0.22, False)
        stage.words(title, x, 98, 6.4)
        stage.words(line, x, 90.5, 4.4, faint=True)
    stage.render(out / "tutorial_deck.png")


def placement(folder: Path) -> np.ndarray:
    """Return the motion (4, 4) that the morph of the bones has found, without its scaling."""
    a = deckfiles.read(folder / "femur.stl").surface().vertices
    b = deckfiles.read(folder / "femur_as_scan.stl").surface().vertices
    u, _, vt = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    turn = vt.T @ np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn, b.mean(0) - turn @ a.mean(0)
    return out


def sites(folder: Path, out: Path) -> None:
    """Sites and landmarks on the source, and carried onto the target."""
    stage = Stage("sites", 460.0, 480.0, FRONT, 1000)
    home = Matrix(np.linalg.inv(placement(folder)).tolist())
    for x, bone_file, marks, where, title in (
        (115, "femur.stl", ".", Matrix(), "known on femur.stl"),
        (345, "scan.stl", "carried", home, "carried to scan.stl"),
    ):
        place = stage.at(x, 30, Matrix.Rotation(np.radians(160), 4, "Z") @ where)
        stage.show(folder / bone_file, place, BONE)
        stage.show(folder / marks / "gluteus.stl", place, SOFT, 0.5)
        stage.show(folder / marks / "iliopsoas.stl", place, OTHER, 0.5)
        for point in landmarkfiles.read(folder / marks / "landmarks.csv").points:
            stage.ball(point, place, 4.0)
        stage.words(title, x, 456, 15)
    stage.render(out / "tutorial_sites.png")


def knee(folder: Path, out: Path) -> None:
    """The knee from the front, and cut through its inner half before and after."""
    stage = Stage("knee", 330.0, 226.0, FRONT)
    turn = Matrix.Rotation(np.radians(-30), 4, "Z")
    for name in KNEE:
        soft = "cartilage" in name
        colour = OTHER if "tibia.inp" in name else SOFT if soft else BONE
        stage.show(folder / name, stage.at(60, 100, turn), colour, 0.18 if soft else 0.0, not soft)
    stage.words("five files, six bodies", 60, 2, 6, faint=True)
    stage.words("the knee", 60, 213, 8)
    stage.words("cut through the inner half, from the side", 232, 213, 8)
    for y, where, line in (
        (158, folder, "before: 0.89 mm into each other"),
        (62, folder / "free", "after: 0.01 mm apart"),
    ):
        for name in KNEE:
            for points, faces in polygons(where / name):
                cut(stage, points, faces, (232, y), name)
        stage.words(line, 232, y - 46, 6, faint=True)
    stage.render(out / "tutorial_knee.png")


def cut(stage: Stage, points: Any, faces: Any, at: tuple[float, float], name: str, zoom: float = 5.2) -> None:
    """Draw where a plane through the inner half of the joint cuts a body, seen from the side."""
    drawn = bmesh.new()
    corners = [drawn.verts.new(point) for point in points]
    for face in faces:
        drawn.faces.new([corners[i] for i in face])
    found = bmesh.ops.bisect_plane(
        drawn, geom=[*drawn.verts, *drawn.edges, *drawn.faces], plane_co=(-23.5, 0, 0), plane_no=(1, 0, 0)
    )["geom_cut"]
    segments = [
        [(-v.co.y, v.co.z) for v in edge.verts] for edge in found if isinstance(edge, bmesh.types.BMEdge)
    ]
    drawn.free()
    soft = "cartilage" in name
    colour = OTHER if "tibia.inp" in name else SOFT if soft else (0.35, 0.30, 0.22, 1.0)
    curve = bpy.data.curves.new("Cut", "CURVE")
    curve.dimensions, curve.bevel_depth = "3D", 0.45 if soft else 0.3
    middle = np.array((13.0, -2.5))
    for segment in segments:
        ends = (np.array(segment) - middle) * zoom
        if np.abs(ends[:, 0]).max() > 96 or np.abs(ends[:, 1]).max() > 42:
            continue
        spline = curve.splines.new("POLY")
        spline.points.add(1)
        for corner, end in zip(spline.points, ends, strict=True):
            corner.co = (*end, 0, 1)
    curve.materials.append(material(colour, glow=True))
    item = bpy.data.objects.new("Cut", curve)
    item.matrix_world = stage.look @ Matrix.Translation((*at, 300))
    stage.scene.collection.objects.link(item)


def main() -> int:
    """Make the files, run the commands, render."""
    parser = argparse.ArgumentParser(description="Render the pictures of the tutorials")
    parser.add_argument("--out", type=Path, default=HERE.parent / "docs" / "images")
    parser.add_argument("--only", default="bone,deck,sites,knee")
    parser.add_argument("--work", type=Path, help="a folder to keep the files in")
    options = parser.parse_args()
    out = options.out.resolve()
    with tempfile.TemporaryDirectory() as temporary:
        folder = (options.work or Path(temporary)).resolve()
        if not (folder / "free").exists():
            prepare(folder)
        made = {"bone": bone, "deck": cartilage, "sites": sites, "knee": knee}
        for name in options.only.split(","):
            made[name](folder, out)
    return 0


def prepare(folder: Path) -> None:
    """Run the tutorials' commands."""
    subprocess.run([sys.executable, str(HERE / "tutorial.py"), str(folder)], check=True)
    femors(
        folder, "morph", "femur.stl", "scan.stl", "-o", "femur_as_scan.stl", "--field", "femur_to_scan.npz"
    )
    femors(folder, "morph", "cartilage.inp", "scan_cartilage.stl", "-o", "cartilage_as_scan.inp")
    sources = ("gluteus.stl", "iliopsoas.stl", "landmarks.csv")
    femors(folder, "transfer", "femur_to_scan.npz", *sources, "-o", "carried")
    rigid = [f"--rigid=knee_{name}" for name in ("femur", "tibia", "patella")]
    tied = ["--exclude=knee_femur,knee_cartilage_femur"]
    tied += [f"--exclude=knee_tibia,knee_cartilage_tibia:TIBIAL-{side}" for side in ("MED", "LAT")]
    femors(folder, "overclosure", *KNEE, *rigid, *tied, "-o", "free")


if __name__ == "__main__":
    sys.exit(main())
