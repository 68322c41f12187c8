# SPDX-License-Identifier: GPL-3.0-or-later
"""A bone, a field that carries it elsewhere, and what lies on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from femors_addon import meshfiles, shapes
from femors_addon.carry import Carrier
from femors_addon.keptfield import KeptField
from femors_addon.mesh import Surface
from femors_addon.meshfiles import MeshFile
from femors_addon.transforms import homogeneous, transformed
from femors_addon.volume import Block, VolumeMesh

BONE = shapes.bone(1500)
STEPS = shapes.differences(2)
SHIFT = homogeneous(np.eye(3), np.array([300.0, 0.0, 0.0]))


def field() -> KeptField:
    """From the bone to its warped self, far enough away that the two cannot be mixed up."""
    centres = transformed(SHIFT, BONE.vertices)
    goal = transformed(SHIFT, shapes.warp(BONE.vertices, *STEPS))
    residual = np.full(len(centres), 0.25)
    return KeptField(
        SHIFT, centres, goal - centres, BONE.faces, residual, 0.75 * BONE.mean_edge, "bone", "other"
    )


CARRIER = Carrier(field())
TARGET = field().morphed
MARKS = BONE.vertices[[10, 400, 900]]


def site(distance: float = 0.0, count: int = 60) -> Surface:
    """A patch of the bone, at some distance from it."""
    near = np.argsort(np.linalg.norm(BONE.vertices - BONE.vertices[200], axis=1), kind="stable")[:count]
    inside = np.isin(BONE.faces, near).all(axis=1)
    used, faces = np.unique(BONE.faces[inside], return_inverse=True)
    return Surface((BONE.vertices + distance * BONE.vertex_normals)[used], faces.reshape(-1, 3))


def slab() -> VolumeMesh:
    """Wedges between two offsets of a patch: cartilage of 3 mm."""
    inner, outer = site(0.0), site(3.0)
    count = len(inner.vertices)
    nodes = np.concatenate((inner.vertices, outer.vertices))
    wedges = np.column_stack((inner.faces, inner.faces + count))
    block = Block("penta6", wedges, np.arange(len(wedges)) + 1)
    return VolumeMesh(nodes, (block,), np.arange(len(nodes)) + 1)


def write_files(tmp_path: Path) -> Path:
    """A field, a site, a deck and landmarks, in a folder."""
    field().save(tmp_path / "f.npz")
    meshfiles.write(tmp_path / "site.stl", MeshFile.of(site()))
    meshfiles.write(tmp_path / "target.ply", MeshFile.of(TARGET))
    meshfiles.write(tmp_path / "bone.ply", MeshFile.of(BONE))
    deck = ["*NODE"]
    deck += [f"{n}, {x:.12g}, {y:.12g}, {z:.12g}" for n, (x, y, z) in enumerate(slab().nodes, 1)]
    deck += ["*ELEMENT, TYPE=C3D6, ELSET=CART"]
    deck += [", ".join(map(str, [n, *(row + 1)])) for n, row in enumerate(slab().blocks[0].nodes, 1)]
    (tmp_path / "cart.inp").write_text("\n".join([*deck, "*END STEP", ""]))
    lines = [f"{name},{x!r},{y!r},{z!r}" for name, (x, y, z) in zip("abc", MARKS.tolist(), strict=True)]
    (tmp_path / "marks.csv").write_text("\n".join(["name,x,y,z", *lines, ""]))
    return tmp_path
