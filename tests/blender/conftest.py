# SPDX-License-Identifier: GPL-3.0-or-later
"""The checkout, or an installed package, as an enabled extension, in the bpy wheel or ``blender -b``."""

from __future__ import annotations

import atexit
import importlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

# before NumPy is loaded: with several threads each, small matrices cost ten times more on a busy machine
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "demo"))

from checkout import INSTALLED, PACKAGE, Checkout

checkout = Checkout()
bpy = pytest.importorskip("bpy", reason="needs the bpy wheel or a blender binary")
atexit.register(checkout.disable)
collect_ignore = [] if INSTALLED else ["test_installed.py"]


@pytest.fixture(scope="session")
def extension() -> Iterator[ModuleType]:
    """The enabled extension's root module."""
    yield checkout.enable()
    checkout.disable()


@pytest.fixture()
def part(extension: ModuleType):
    """A function that imports a module of the extension by its path below the root."""
    return lambda name: importlib.import_module(f"{PACKAGE}.{name}")


@pytest.fixture()
def empty(extension: ModuleType) -> Iterator[None]:
    """An empty file in Object Mode, with the extension enabled."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
    yield
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)


def sphere(rings: int = 12, segments: int = 16, radii: tuple[float, float, float] = (1.0, 1.0, 1.0)):
    """Return vertices (n, 3) and faces (lists: quads, triangles at the poles) of an ellipsoid."""
    theta = np.linspace(0, np.pi, rings + 1)[1:-1]
    phi = np.arange(segments) * 2 * np.pi / segments
    ring = np.stack(
        [
            np.sin(theta)[:, None] * np.cos(phi),
            np.sin(theta)[:, None] * np.sin(phi),
            np.cos(theta)[:, None] + 0 * phi,
        ],
        axis=-1,
    ).reshape(-1, 3)
    vertices = np.concatenate((ring, [[0, 0, 1.0], [0, 0, -1.0]])) * radii
    faces = []
    for i in range(rings - 2):
        for j in range(segments):
            a, b = i * segments + j, i * segments + (j + 1) % segments
            faces.append([a, a + segments, b + segments, b])
    north, south, last = len(ring), len(ring) + 1, (rings - 2) * segments
    for j in range(segments):
        faces.append([north, j, (j + 1) % segments])
        faces.append([south, last + (j + 1) % segments, last + j])
    return vertices, faces


def add_object(name: str, vertices, faces, collection=None):
    """Make a mesh object in the scene and return it."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([tuple(map(float, v)) for v in vertices], [], faces)
    mesh.update()
    item = bpy.data.objects.new(name, mesh)
    (collection or bpy.context.scene.collection).objects.link(item)
    return item


@pytest.fixture()
def pair(empty: None):
    """Two ellipsoids of different size and mesh: (source with quads, target)."""
    source = add_object("Femur", *sphere(14, 20, (1.0, 0.8, 2.0)))
    vertices, faces = sphere(20, 24, (1.2, 0.9, 2.2))
    vertices[:, 0] += 0.15 * vertices[:, 2] ** 2 / 4
    target = add_object("Scan", vertices, faces)
    bpy.context.view_layer.update()
    return source, target


def world(item) -> np.ndarray:
    """Return the object's base vertices in world coordinates, float64 (n, 3)."""
    out = np.empty(3 * len(item.data.vertices), dtype=np.float32)
    item.data.vertices.foreach_get("co", out)
    matrix = np.array(item.matrix_world, dtype=np.float64)
    return out.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def census() -> dict[str, int]:
    """Count the file's data-blocks."""
    return {
        p.identifier: len(getattr(bpy.data, p.identifier))
        for p in bpy.data.bl_rna.properties
        if p.type == "COLLECTION"
    }


@pytest.fixture()
def tools():
    """The helpers above, for test modules (which cannot import a conftest by name)."""

    class Tools:
        pass

    for function in (sphere, add_object, world, census):
        setattr(Tools, function.__name__, staticmethod(function))
    return Tools


@pytest.fixture()
def deck(tmp_path, empty):
    """A function that writes a deck, imports it, and returns its path and the objects."""

    def make(text: str, name: str = "model.inp"):
        path = tmp_path / name
        path.write_text(text)
        before = set(bpy.data.objects)
        assert bpy.ops.femors.import_deck(filepath=str(path)) == {"FINISHED"}
        return path, [item for item in bpy.data.objects if item not in before]

    return make


@pytest.fixture()
def core(part):
    """The core's modules by name."""
    return lambda name: part(f"femors_addon.{name}")


@pytest.fixture()
def balls(empty, tools):
    """Two balls of radius 1 and 0.8 that overlap by 0.3 along x, with a third far away."""
    from body_cases import ball

    one = ball(tools, "Ball", 1.0, (0, 0, 0))
    two = ball(tools, "Cup", 0.8, (1.5, 0.02, 0.01))
    ball(tools, "Far", 1.0, (9, 0, 0))
    bpy.context.view_layer.update()
    return one, two


@pytest.fixture()
def morphed(pair, tools):
    """The pair after a morph; on the source two landmarks, and a region with partial weights."""
    from field_cases import put_group

    source, target = pair
    points = tools.world(source)
    far = np.linalg.norm(points - points[100], axis=1)
    put_group(source, "tip", {100: 1.0})
    put_group(
        source, "site", {int(i): float(np.clip(1.6 - far[i] / 0.5, 0, 1)) for i in np.flatnonzero(far < 0.8)}
    )
    put_group(source, "pole", {len(points) - 1: 1.0})
    assert bpy.ops.femors.morph(source="Femur", target="Scan") == {"FINISHED"}
    return source, target, bpy.data.objects["Femur morphed to Scan"]
