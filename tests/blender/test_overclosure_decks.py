# SPDX-License-Identifier: GPL-3.0-or-later
"""Overclosure removal on parts of FE decks in Blender, and on a real knee."""

from __future__ import annotations

import os
from pathlib import Path

import bpy
import numpy as np
import pytest
from body_cases import TRANSFORMS, base, findings, refused, remove, seen, triangles

DATA = Path(os.environ.get("FEMORS_DATA") or Path(__file__).resolve().parents[3] / "shared" / "data")
KNEE = DATA / "knee"


# --- FE models -----------------------------------------------------------------------------------------
COUNTS = (8, 8, 2)


def plate(low, high, first) -> str:
    """Return the nodes and hexes of a plate as a deck, with more digits than single precision has."""
    axes = [np.linspace(a, b, k + 1) for a, b, k in zip(low, high, COUNTS, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) + 1e-3 / 3
    strides = np.array([(COUNTS[1] + 1) * (COUNTS[2] + 1), COUNTS[2] + 1, 1])
    at = np.stack(np.meshgrid(*map(np.arange, COUNTS), indexing="ij"), axis=-1).reshape(-1, 3)
    offsets = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    hexes = np.stack([(at + offset) @ strides for offset in offsets], axis=1) + first
    lines = [f"{first + i}, {x!r}, {y!r}, {z!r}\n" for i, (x, y, z) in enumerate(nodes.tolist())]
    rows = [f"{first + i}, {', '.join(map(str, row))}\n" for i, row in enumerate(hexes.tolist())]
    return "*NODE\n" + "".join(lines) + f"*ELEMENT, TYPE=C3D8, ELSET=PLATE{first}\n" + "".join(rows)


@pytest.fixture()
def plates(tmp_path, empty):
    """A deck of two plates of hexes that overlap by 0.1; its path, and the objects by name."""
    path = tmp_path / "plates.inp"
    path.write_text(plate((0, 0, 0), (8, 8, 1), 1) + plate((0.5, 0.5, 0.9), (2.5, 2.5, 2), 1001))
    assert bpy.ops.femors.import_deck(filepath=str(path)) == {"FINISHED"}
    return path, bpy.data.objects["PLATE1"], bpy.data.objects["PLATE1001"]


def export(path: Path, item) -> None:
    assert bpy.ops.femors.export_deck(filepath=str(path), object=item.name) == {"FINISHED"}


def read_bodies(core, path: Path, names):
    """Return the parts of a deck as the core's bodies."""
    deck = core("deckfiles").read_deck(path)
    return deck, [core("overclosure").Body(n, deck.submesh(deck.part(n))[0]) for n in names]


@pytest.mark.parametrize("kind", ["SHAPE_KEY", "IN_PLACE"])
def test_parts_of_a_deck_are_moved_saved_and_exported(plates, core, tmp_path, kind):
    path, one, two = plates
    names = (one.name, two.name)
    figures = remove(bodies="PLATE1;PLATE1001", gap=0.01, result=kind)
    assert figures["certified"]
    assert all(body["newly_inverted"] == [] for body in figures["bodies"])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    export(tmp_path / "out.inp", bpy.data.objects[names[0]])
    before, _ = read_bodies(core, path, names)
    after, bodies = read_bodies(core, tmp_path / "out.inp", names)
    settings = core("overclosure_settings").OverclosureSettings(gap=0.01)
    (finding,) = core("overclosure").check_overclosure(bodies, settings)
    assert finding.clear and finding.least >= 0.01 - 1e-5
    assert (core("volume_quality").scaled_jacobians(after.mesh) > 0.5).all()
    moved = (after.coordinates != before.coordinates).any(axis=1)
    shown = [o.data.attributes["femors_gap"] for o in (bpy.data.objects[n] for n in names)]
    assert all(len(held.data) == 9 * 9 * 3 for held in shown)
    inner = np.isclose(before.coordinates[:, 2], 0.5, atol=1e-2)
    assert moved.any() and moved[inner].any(), "nodes inside follow"
    # what did not move has its very digits
    lines = [f.read_text().splitlines() for f in (path, tmp_path / "out.inp")]
    changed = sum(one != two for one, two in zip(*lines, strict=True))
    assert changed == moved.sum() < len(moved)


def test_a_rigid_part_keeps_every_digit(plates, core, tmp_path):
    path, one, two = plates
    one.femors.role = "RIGID"
    assert remove(bodies="PLATE1;PLATE1001", gap=0.01)["certified"]
    export(tmp_path / "out.inp", two)
    before, _ = read_bodies(core, path, ())
    after, _ = read_bodies(core, tmp_path / "out.inp", ())
    moved = (after.coordinates != before.coordinates).any(axis=1)
    assert not moved[: 9 * 9 * 3].any() and moved[9 * 9 * 3 :].any()


@pytest.mark.parametrize("name", ["turned", "mirrored"])
def test_parts_of_decks_with_a_transform(plates, core, name):
    _, one, two = plates
    for item in (one, two):
        item.matrix_world = TRANSFORMS[name]
    bpy.context.view_layer.update()
    figures = remove(bodies="PLATE1;PLATE1001", gap=0.01)
    assert figures["certified"]
    assert all(body["inverted_on_input"] == [] for body in figures["bodies"])
    assert all(body["scaled_jacobian"]["after"]["minimum"] > 0.5 for body in figures["bodies"])
    mesh = core("mesh")
    shells = [mesh.Surface(seen(item), triangles(item)) for item in (one, two)]
    assert len(core("intersect").crossings(*shells)) == 0


def test_parts_that_share_nodes_are_an_excluded_pair(tmp_path, empty, tools):
    path = tmp_path / "tied.inp"
    text = plate((0, 0, 0), (8, 8, 1), 1)
    half = text.replace("*ELEMENT, TYPE=C3D8, ELSET=PLATE1\n", "*ELEMENT, TYPE=C3D8, ELSET=LOW\n")
    rows = half.splitlines(keepends=True)
    middle = len(rows) - 64
    path.write_text("".join([*rows[:middle], "*ELEMENT, TYPE=C3D8, ELSET=HIGH\n", *rows[middle:]]))
    bpy.ops.femors.import_deck(filepath=str(path))
    refused("share 27 nodes .* exclude the pair", tools, bodies="LOW;HIGH")
    assert remove(bodies="LOW;HIGH", exclude="LOW,HIGH")["certified"]


# --- the knee -------------------------------------------------------------------------------------------
@pytest.mark.skipif(not KNEE.is_dir(), reason=f"needs {KNEE}")
def test_patella_and_its_cartilage_on_the_femurs(empty, core, tmp_path):
    """A rigid bone, its cartilage, and the cartilage that they are pressed into, by 1 mm."""
    for name in ("bone_patella", "cartilage_patella_hex", "cartilage_femur_hex"):
        bpy.ops.femors.import_deck(filepath=str(KNEE / f"{name}.inp"))
    items = [bpy.data.objects[name] for name in ("BONE-PATELLA", "CART-PATELLA", "CART-FEMUR")]
    for item in items[:2]:
        item.location = (-9.702, 71.403 + 1.0, -46.832)
    bpy.context.view_layer.update()
    items[0].femors.role = "RIGID"
    before = base(items[0])
    figures = remove(bodies=";".join(item.name for item in items), gap=0.01)
    assert figures["certified"] and figures["pairs"]["before"][0]["depth"] > 0.9
    assert all(body["newly_inverted"] == [] for body in figures["bodies"])
    assert base(items[0]) == before and items[0].data.shape_keys is None
    for finding in findings(core, *items, gap=0.01):
        assert finding.crossings == 0 and finding.least >= 0.01 - 2e-5
    export(tmp_path / "patella.inp", items[1])
    read = core("deckfiles").read_deck
    moved = read(tmp_path / "patella.inp").coordinates - read(KNEE / "cartilage_patella_hex.inp").coordinates
    assert 0.5 < np.abs(moved).max() < 3.0
