# SPDX-License-Identifier: GPL-3.0-or-later
"""One format as another."""

from __future__ import annotations

import importlib.util
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from commands import refused, run
from solids import enclosed_volume

from femors_addon import deckfiles, meshfiles
from femors_addon.meshfiles import MeshFile

KNEE = Path(os.environ.get("FEMORS_DATA", Path(__file__).parent.parent.parent / "shared" / "data")) / "knee"
needs_knee = pytest.mark.skipif(not KNEE.is_dir(), reason=f"there is no {KNEE}")
needs_meshio = pytest.mark.skipif(
    importlib.util.find_spec("meshio") is None, reason="meshio is not installed"
)
THROUGH_MESHIO = [pytest.param(suffix, marks=needs_meshio) for suffix in (".vtk", ".vtu", ".msh", ".mesh")]

BOX = """*HEADING
*NODE, NSET=ALL
11, 0,0,0
12, 1,0,0
13, 1,1,0
14, 0,1,0
15, 0,0,1
16, 1,0,1
17, 1,1,1
18, 0,1,1
19, 0.5,0.5,2
20, 9,9,9
*ELEMENT, TYPE=C3D8, ELSET=CUBE
1, 11,12,13,14,15,16,17,18
*ELEMENT, TYPE=C3D4, ELSET=ROOF
2, 15,16,17,19
3, 15,17,18,19
*NSET, NSET=FOOT
11,12,13,14
*ELSET, ELSET=TOP
2,3
*SOLID SECTION, ELSET=CUBE, MATERIAL=M
"""


@pytest.fixture()
def box(tmp_path):
    (tmp_path / "box.inp").write_text(BOX)
    return tmp_path / "box.inp"


# --- formats --------------------------------------------------------------------------------------
@pytest.mark.parametrize("suffix", [".inp", ".feb", ".bdf", *THROUGH_MESHIO])
def test_a_deck_as_another_and_the_same_again(box, tmp_path, capsys, suffix):
    out = tmp_path / f"out{suffix}"
    code, said, err = run(capsys, "convert", box, out)
    assert (code, said) == (0, f"{box} -> {out}\n"), err
    assert ("materials" in err) == (suffix != ".inp")
    assert ("sets" in err) == (suffix not in (".inp", ".feb"))
    before, after = deckfiles.read_deck(box), deckfiles.read_deck(out)
    assert np.array_equal(before.coordinates, after.coordinates)
    assert sorted((b.kind, b.nodes.tolist()) for b in after.mesh.blocks) == sorted(
        (b.kind, b.nodes.tolist()) for b in before.mesh.blocks
    )
    assert sorted(len(part.elements) for part in after.parts.values()) == [1, 2]
    if suffix in (".inp", ".feb", ".bdf", ".vtk", ".vtu"):
        assert np.array_equal(before.mesh.node_ids, after.mesh.node_ids)
        assert sorted(after.mesh.element_ids) == [1, 2, 3]
    else:
        assert "the numbers of nodes and elements" in err
    if suffix in (".inp", ".feb"):
        assert after.mesh.node_sets["FOOT"].tolist() == [0, 1, 2, 3]
        assert after.mesh.element_sets["TOP"].tolist() == [1, 2]
    same = tmp_path / f"same{suffix}"
    assert run(capsys, "convert", out, same, "--quiet") == (0, "", "")
    assert same.read_bytes() == out.read_bytes()
    # and back, by way of a deck made from scratch
    back = tmp_path / "back.inp"
    assert run(capsys, "convert", out, back, "--quiet") == (0, "", "")
    assert np.array_equal(deckfiles.read_deck(back).coordinates, before.coordinates)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_a_deck_as_a_surface(box, tmp_path, capsys, suffix):
    out = tmp_path / f"out{suffix}"
    code, _, err = run(capsys, "convert", box, out)
    assert code == 0
    assert "not written: 1 node that is no corner of the surface" in err
    mesh = meshfiles.read(out)
    # the top of the cube is a quad, the roof's foot two triangles: both belong to the surface
    assert mesh.surface().volume == pytest.approx(1 + 1 / 3)
    if suffix != ".stl":
        assert sorted(mesh.sizes.tolist()) == [3] * 6 + [4] * 6
    same = tmp_path / f"same{suffix}"
    assert run(capsys, "convert", out, same)[0] == 0
    assert same.read_bytes() == out.read_bytes()


@pytest.mark.parametrize("source", [".stl", ".ply", ".obj"])
@pytest.mark.parametrize("suffix", [".inp", ".feb", ".bdf"])
def test_a_surface_as_a_deck_of_shells(tmp_path, capsys, source, suffix):
    corners = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    meshfiles.write(tmp_path / f"in{source}", MeshFile(points, np.full(4, 3), corners))
    code, _, err = run(capsys, "convert", tmp_path / f"in{source}", tmp_path / f"out{suffix}")
    assert code == 0, err
    assert ("8 vertices that stood where another stands" in err) == (source == ".stl")
    deck = deckfiles.read_deck(tmp_path / f"out{suffix}")
    assert len(deck.coordinates) == 4
    assert deck.mesh.surface()[0].volume == pytest.approx(1 / 6)


def test_a_part_alone(box, tmp_path, capsys):
    code, _, err = run(capsys, "convert", box, "--part", "roof", "-o", tmp_path / "roof.inp")
    assert code == 0, err
    deck = deckfiles.read_deck(tmp_path / "roof.inp")
    assert deck.mesh.node_ids.tolist() == [15, 16, 17, 18, 19]
    assert deck.mesh.element_ids.tolist() == [2, 3]
    assert list(deck.parts) == ["ROOF"]
    assert "no part or set 'wall'" in refused(capsys, "convert", box, tmp_path / "o.stl", "--part", "wall")


def test_numbers_of_several_parts_become_unique(tmp_path, capsys):
    part = "*PART, NAME={}\n*NODE\n1,0,0,{z}\n2,1,0,{z}\n3,0,1,{z}\n*ELEMENT,TYPE=S3\n1,1,2,3\n*END PART\n"
    text = part.format("A", z=0) + part.format("B", z=1)
    text += "*ASSEMBLY,NAME=X\n*INSTANCE,NAME=I,PART=A\n1,2,3\n*END INSTANCE\n*END ASSEMBLY\n"
    (tmp_path / "two.inp").write_text(text)
    code, _, err = run(capsys, "convert", tmp_path / "two.inp", tmp_path / "two.feb")
    assert code == 0
    assert "the placing of parts by the assembly" in err
    assert "the numbers of nodes and elements" in err
    deck = deckfiles.read_deck(tmp_path / "two.feb")
    assert deck.mesh.node_ids.tolist() == [1, 2, 3, 4, 5, 6]
    assert {name: part.elements.tolist() for name, part in deck.parts.items()} == {"A": [0], "B": [1]}


@needs_meshio
def test_node_data_from_vtk_to_vtu_and_back(tmp_path, capsys):
    import meshio

    points = np.eye(4, 3)
    data = {"point_data": {"t": np.arange(4.0)}, "cell_data": {"s": [np.array([7.5])]}}
    meshio.vtk.write(tmp_path / "a.vtk", meshio.Mesh(points, [("tetra", [[0, 1, 2, 3]])], **data))
    assert run(capsys, "convert", tmp_path / "a.vtk", tmp_path / "b.vtu")[2] == ""
    assert run(capsys, "convert", tmp_path / "b.vtu", tmp_path / "c.vtk")[2] == ""
    again = meshio.read(tmp_path / "c.vtk")
    assert again.point_data["t"].tolist() == [0, 1, 2, 3]
    assert again.cell_data["s"][0].tolist() == [7.5]
    assert (
        "not written: node and cell data" in run(capsys, "convert", tmp_path / "a.vtk", tmp_path / "a.inp")[2]
    )


def test_odd_names_survive(tmp_path, capsys):
    text = BOX.replace("ELSET=ROOF", 'ELSET="a <b> & c"').replace("NSET=FOOT", 'NSET="1 foot"')
    (tmp_path / "odd.inp").write_text(text)
    for one, two in (("odd.inp", "odd.feb"), ("odd.feb", "back.inp")):
        assert run(capsys, "convert", tmp_path / one, tmp_path / two)[0] == 0
    deck = deckfiles.read_deck(tmp_path / "back.inp")
    assert "a <b> & c" in deck.parts
    assert "1 foot" in deck.mesh.node_sets


def test_what_convert_refuses(box, tmp_path, capsys):
    before = sorted(tmp_path.iterdir())
    (tmp_path / "broken.inp").write_text(BOX.replace("15,17,18,19", "15,17,18,99"))
    (tmp_path / "empty.vtu").write_text("")
    for argv, words in (
        ((box, tmp_path / "o.step"), "'.step' is not a known kind of file"),
        ((box, tmp_path / "o"), "the name has no ending, which says the kind of file"),
        ((tmp_path / "none.inp", tmp_path / "o.stl"), "no such file"),
        ((box, box), "also an input"),
        ((box, tmp_path / "nowhere" / "o.stl"), "no folder"),
        ((tmp_path / "broken.inp", tmp_path / "o.stl"), "line 17: element 3 names node 99"),
        ((tmp_path / "empty.vtu", tmp_path / "o.stl"), "is empty"),
        ((box,), "-o OUT is needed (see 'femors convert --help')"),
        ((box, tmp_path / "a.stl", "-o", tmp_path / "b.stl"), "two outputs"),
    ):
        assert words in refused(capsys, "convert", *argv)
    (tmp_path / "broken.inp").unlink()
    (tmp_path / "empty.vtu").unlink()
    assert sorted(tmp_path.iterdir()) == before


def test_includes_go_along_and_inputs_are_never_overwritten(tmp_path, capsys):
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    head, tail = BOX.split("*ELEMENT", 1)
    (tmp_path / "in" / "box.inp").write_text(head + "*INCLUDE, INPUT=elements.inc\n")
    (tmp_path / "in" / "elements.inc").write_text("*ELEMENT" + tail)
    code, said, err = run(capsys, "convert", tmp_path / "in" / "box.inp", tmp_path / "out" / "new.inp")
    assert code == 0, err
    assert said.count(str(tmp_path / "out")) == 2
    assert (tmp_path / "out" / "elements.inc").read_text() == "*ELEMENT" + tail
    assert deckfiles.read_deck(tmp_path / "out" / "new.inp").mesh.element_count == 3
    target = tmp_path / "in" / "elements.inc"
    err = refused(
        capsys, "convert", tmp_path / "in" / "box.inp", target.with_suffix(".inp").parent / "elements.inc"
    )
    assert "not a known kind" in err


@needs_knee
@pytest.mark.parametrize("path", sorted(KNEE.glob("*.inp")) or [None], ids=lambda path: path and path.stem)
def test_decks_of_the_knee_stay_as_they_are(path, tmp_path, capsys):
    out = tmp_path / path.name
    assert run(capsys, "convert", path, out, "--quiet") == (0, "", "")
    assert out.read_bytes() == path.read_bytes()


@needs_knee
@needs_meshio
@pytest.mark.parametrize("suffix", [".feb", ".vtu"])
def test_a_deck_of_the_knee_through_other_formats(tmp_path, capsys, suffix):
    path = KNEE / "cartilage_tibia_tet.inp"
    assert run(capsys, "convert", path, tmp_path / f"a{suffix}", "--quiet") == (0, "", "")
    assert run(capsys, "convert", tmp_path / f"a{suffix}", tmp_path / f"b{suffix}", "--quiet") == (0, "", "")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
    one, two = deckfiles.read_deck(path), deckfiles.read_deck(tmp_path / f"a{suffix}")
    assert np.array_equal(one.coordinates, two.coordinates)
    assert np.array_equal(one.mesh.element_ids, two.mesh.element_ids)
    volume = enclosed_volume(one.mesh.nodes, one.mesh.outer)
    assert enclosed_volume(two.mesh.nodes, two.mesh.outer) == pytest.approx(volume, rel=1e-12)


# --- coordinates that are none ----------------------------------------------------------------------
@pytest.mark.parametrize(
    ("suffix", "words"),
    [
        (".stl", "corner 1 of triangle 2, counted from 1"),
        (".ply", "vertex 3, counted from 0"),
        (".obj", "vertex 4, counted from 1"),
        (".inp", "line 6: the coordinates of node 4"),
        (".feb", "line 8: x,y,z of node 4"),
        (".bdf", "line 9: a coordinate was expected, not 'nan"),
        *(
            pytest.param(suffix, words, marks=needs_meshio)
            for suffix, words in (
                (".vtk", "first: node 4"),  # it brings ids along
                (".msh", "first: node 4"),
                (".mesh", "first: node 4"),
            )
        ),
    ],
)
def test_a_vertex_that_is_not_finite_is_called_what_the_file_calls_it(tmp_path, capsys, suffix, words):
    number = 777.25
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, number]], dtype=float)
    faces = np.array([[0, 2, 1], [3, 0, 1], [3, 1, 2], [3, 2, 0]])
    path = tmp_path / f"in{suffix}"
    mesh = MeshFile(vertices, np.full(4, 3), faces.ravel())
    for place, data in deckfiles.written(mesh, path).files.items():
        spoilt = data.replace(b"7.7725000000000000e+02", b"nan").replace(b"777.25", b"nan")
        for code in ("<f", ">f", "<d", ">d"):
            spoilt = spoilt.replace(struct.pack(code, number), struct.pack(code, np.nan))
        assert spoilt != data
        Path(place).write_bytes(spoilt)
    assert words in refused(capsys, "convert", path, "-o", tmp_path / "out.ply")


@pytest.mark.parametrize(
    ("kind", "cells"),
    [
        ("POLYDATA", "POLYGONS 1 4\n3 0 1 2\n"),
        pytest.param("UNSTRUCTURED_GRID", "CELLS 1 4\n3 0 1 2\nCELL_TYPES 1\n5\n", marks=needs_meshio),
    ],
)
def test_a_point_of_vtk_without_ids_is_counted_from_zero_as_cells_do(tmp_path, capsys, kind, cells):
    path = tmp_path / "in.vtk"
    head = f"# vtk DataFile Version 3.0\nx\nASCII\nDATASET {kind}\nPOINTS 3 double\n"
    path.write_text(f"{head}0 0 0 1 0 0 0 nan 0\n{cells}")
    assert "point 2, counted from 0" in refused(capsys, "convert", path, "-o", tmp_path / "out.ply")
