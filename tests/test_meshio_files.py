# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that meshio reads: data kept, variants kept, and a sentence where meshio is missing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from femors_addon import deckfiles, meshio_files
from femors_addon.elements import KINDS
from femors_addon.progress import FemorsError
from femors_addon.volume import Block, VolumeMesh
from femors_addon.volume_quality import scaled_jacobians

meshio = pytest.importorskip("meshio", reason="meshio is not installed")

NODES = np.array([[x, y, z] for z in (0, 1, 2) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))], dtype=float)
NODES = NODES + 0.1 * np.random.default_rng(0).normal(size=NODES.shape)
CELLS = [
    ("hexahedron", np.array([[0, 1, 2, 3, 4, 5, 6, 7]])),
    ("wedge", np.array([[4, 5, 6, 8, 9, 10], [4, 6, 7, 8, 10, 11]])),
    ("triangle", np.array([[0, 2, 1]])),
    ("line", np.array([[0, 1], [1, 2]])),
]


def made(**more) -> meshio.Mesh:
    data = {
        "point_data": {"temperature": np.linspace(0, 1, 12), "u": np.arange(36.0).reshape(12, 3)},
        "cell_data": {"stress": [np.arange(len(rows)) + 0.5 for _, rows in CELLS]},
    }
    return meshio.Mesh(NODES, CELLS, **(data | more))


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.vtk", {"binary": True}),
        ("a.vtk", {"binary": False}),
        ("a.vtk", {"binary": True, "fmt_version": "4.2"}),
        ("a.vtu", {"binary": True}),
        ("a.vtu", {"binary": True, "compression": None}),
        ("a.vtu", {"binary": False}),
    ],
)
def test_node_and_cell_data_are_kept(tmp_path, name, options):
    path = tmp_path / name
    getattr(meshio, {"vtk": "vtk", "vtu": "vtu", "msh": "gmsh"}[path.suffix[1:]]).write(
        path, made(), **options
    )
    content = path.read_bytes()
    deck = deckfiles.read_deck(path)
    assert np.allclose(deck.coordinates, NODES, atol=1e-10)
    assert [block.kind for block in deck.mesh.blocks] == ["hex8", "penta6", "tri3"]
    assert (scaled_jacobians(deck.mesh) > 0.3).all()  # each format's own order of nodes is undone
    assert deck.encoded() == content
    assert deck.with_coordinates(deck.coordinates).encoded() == content
    moved = deck.with_coordinates(deck.coordinates * 1.7 + np.pi)
    moved.write(tmp_path / f"out{path.suffix}")
    again = deckfiles.read_deck(tmp_path / f"out{path.suffix}")
    assert np.array_equal(again.coordinates, moved.coordinates)  # in double precision
    for one, two in zip(deck.mesh.blocks, again.mesh.blocks, strict=True):
        assert np.array_equal(one.nodes, two.nodes)
    read = meshio.read(tmp_path / f"out{path.suffix}")
    expected = made()
    assert [(c.type, len(c.data)) for c in read.cells] == [(c.type, len(c.data)) for c in expected.cells]
    for key, values in expected.point_data.items():
        assert np.allclose(np.squeeze(read.point_data[key]), values)
    stress = np.concatenate([np.ravel(part) for part in read.cell_data["stress"]])
    assert np.allclose(stress, np.concatenate(expected.cell_data["stress"]))
    if path.suffix != ".vtu" and options["binary"] is False:  # text stays text
        (tmp_path / f"out{path.suffix}").read_bytes().decode("ascii")


@pytest.mark.parametrize("version", ["2.2", "4.1"])
@pytest.mark.parametrize("binary", [True, False])
def test_gmsh_files_change_in_place(tmp_path, version, binary):
    mesh = made()
    if version == "4.1":  # of which meshio writes one type of elements
        mesh = meshio.Mesh(NODES, CELLS[:1], {"t": np.arange(12.0)}, {"s": [np.array([1.5])]})
    meshio.gmsh.write(tmp_path / "a.msh", mesh, fmt_version=version, binary=binary)
    content = (tmp_path / "a.msh").read_bytes()
    if not binary:  # numbers of nodes that are not 1, 2, 3 ... are kept too
        assert content.count(b"\n12 ") + content.count(b"\n12\n") >= 1
    deck = deckfiles.read_deck(tmp_path / "a.msh")
    assert deck.notes == () or all("tag data" in note for note in deck.notes)
    assert deck.encoded() == content
    assert [block.kind for block in deck.mesh.blocks][:1] == ["hex8"]
    moved = np.array(deck.coordinates)
    moved[3] = [np.pi, -1e-7, 1e300]
    moved[11, 1] = 0.5
    deck.with_coordinates(moved).write(tmp_path / "b.msh")
    out = (tmp_path / "b.msh").read_bytes()
    assert np.array_equal(deckfiles.read_deck(tmp_path / "b.msh").coordinates, moved)
    if binary:
        assert len(out) == len(content)
        different = np.flatnonzero(np.frombuffer(out, np.uint8) != np.frombuffer(content, np.uint8))
        assert 0 < len(different) <= 32
    else:
        lines = zip(content.split(b"\n"), out.split(b"\n"), strict=True)
        changed = [(one, two) for one, two in lines if one != two]
        assert len(changed) == 2
        assert [one.split()[0] == two.split()[0] for one, two in changed] == [version == "2.2", True]


def test_gmsh_keeps_its_numbers(tmp_path):
    (tmp_path / "a.msh").write_text(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
        "$Nodes\n4\n 10\t0 0 0\n7  1 0 0 \n8 0 1 0\n99 0 0 1\n$EndNodes\n"
        "$Elements\n1\n5 4 2 3 3 10 7 8 99\n$EndElements\n$Periodic\n0\n$EndPeriodic\n$Mine\nx\n$EndMine\n"
    )
    deck = deckfiles.read_deck(tmp_path / "a.msh")
    assert deck.mesh.node_ids.tolist() == [10, 7, 8, 99]
    assert deck.mesh.blocks[0].nodes.tolist() == [[0, 1, 2, 3]]
    out = deck.with_coordinates(deck.coordinates + [0, 0, 0.25]).encoded().decode()
    assert out == (tmp_path / "a.msh").read_text().replace("\t0 0 0\n", "\t0 0 0.25\n").replace(
        "1 0 0 \n", "1 0 0.25 \n"
    ).replace("8 0 1 0\n", "8 0 1 0.25\n").replace("99 0 0 1\n", "99 0 0 1.25\n")


def test_single_precision_becomes_double_where_nodes_move(tmp_path):
    mesh = made()
    mesh.points = mesh.points.astype(np.float32)
    meshio.write(tmp_path / "a.vtu", mesh)
    deck = deckfiles.read_deck(tmp_path / "a.vtu")
    moved = deck.coordinates + 1e-12
    deck.with_coordinates(moved).write(tmp_path / "b.vtu")
    assert np.array_equal(deckfiles.read_deck(tmp_path / "b.vtu").coordinates, moved)


def test_parts_and_sets(tmp_path):
    tags = [np.array([5]), np.array([5, 7]), np.array([7]), np.array([1, 1])]
    mesh = made(
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"bone": np.array([5, 3]), "cartilage": np.array([7, 3])},
    )
    meshio.gmsh.write(tmp_path / "a.msh", mesh, fmt_version="2.2", binary=False)
    deck = deckfiles.read_deck(tmp_path / "a.msh")
    assert {name: part.elements.tolist() for name, part in deck.parts.items()} == {
        "bone": [0, 1],
        "cartilage": [2, 3],
    }
    deck.with_coordinates(2 * deck.coordinates).write(tmp_path / "b.msh")
    assert deckfiles.read_deck(tmp_path / "b.msh").parts.keys() == deck.parts.keys()


@pytest.mark.parametrize("suffix", [".vtk", ".vtu", ".msh", ".mesh"])
def test_from_scratch_and_back(tmp_path, suffix):
    kinds = ["tet4", "hex8", "penta6", "tri3", "quad4"]
    kinds += ["tet10", "hex20"] if suffix != ".mesh" else []
    rng = np.random.default_rng(0)
    nodes = rng.normal(size=(25, 3))
    blocks = tuple(
        Block(kind, rng.permutation(25)[: KINDS[kind].size][None], np.array([number + 100]))
        for number, kind in enumerate(kinds)
    )
    mesh = VolumeMesh(nodes, blocks, np.arange(25) + 1000)
    (tmp_path / f"a{suffix}").write_bytes(
        meshio_files.fresh(mesh, {"solid": np.arange(3), "shell": np.array([3, 4])}, suffix)
    )
    deck = deckfiles.read_deck(tmp_path / f"a{suffix}")
    assert np.array_equal(deck.coordinates, nodes)
    there = sorted((b.kind, b.nodes.tolist()) for b in deck.mesh.blocks)
    assert there == sorted((b.kind, b.nodes.tolist()) for b in blocks)
    if suffix in (".vtk", ".vtu"):
        assert np.array_equal(deck.mesh.node_ids, mesh.node_ids)
        assert np.array_equal(deck.mesh.element_ids, mesh.element_ids)
    sizes = sorted(len(part.elements) for part in deck.parts.values())
    assert sizes == sorted([3, 2] + [len(kinds) - 5] * (len(kinds) > 5))
    if suffix == ".msh":
        assert {"solid", "shell"} <= set(deck.parts)


@pytest.mark.parametrize("suffix", [".vtk", ".vtu", ".msh", ".mesh"])
@pytest.mark.parametrize("kind", list(KINDS))
def test_every_kind_comes_back_or_is_refused(tmp_path, suffix, kind):
    """Beside a tetrahedron, so that what is left out does not leave the file empty; also where nodes move."""
    rng = np.random.default_rng(0)
    rows = [(name, rng.permutation(25)[: KINDS[name].size]) for name in ("tet4", kind)]
    blocks = tuple(Block(name, row[None], np.array([index])) for index, (name, row) in enumerate(rows, 1))
    mesh = VolumeMesh(rng.normal(size=(25, 3)), blocks, np.arange(1, 26))
    path = tmp_path / f"a{suffix}"
    if suffix == ".mesh" and KINDS[kind].edges:
        with pytest.raises(FemorsError, match=rf"^\.mesh files hold no elements like {kind}; write \.vtu or"):
            meshio_files.fresh(mesh, {}, suffix)
        return
    path.write_bytes(meshio_files.fresh(mesh, {}, suffix))
    deck = deckfiles.read_deck(path)
    deck.with_coordinates(deck.coordinates + 1).write(tmp_path / f"b{suffix}")
    for again in (deck, deckfiles.read_deck(tmp_path / f"b{suffix}")):
        there = [(block.kind, row) for block in again.mesh.blocks for row in block.nodes.tolist()]
        assert there == [(name, row.tolist()) for name, row in rows]


@pytest.mark.parametrize(
    ("kind", "number", "edges"),
    [
        ("penta15", "18", ((0, 1), (0, 2), (0, 3), (1, 2), (1, 4), (2, 5), (3, 4), (3, 5), (4, 5))),
        ("pyra13", "19", ((0, 1), (0, 3), (0, 4), (1, 2), (1, 4), (2, 3), (2, 4), (3, 4))),
    ],
)
def test_mid_side_nodes_stand_where_gmsh_has_them(kind, number, edges):
    """Gmsh's reference manual, "Node ordering"."""
    shape = KINDS[kind]
    mesh = VolumeMesh(
        np.random.default_rng(0).normal(size=(shape.size, 3)),
        (Block(kind, np.arange(shape.size)[None], np.array([1])),),
        np.arange(shape.size) + 1,
    )
    words = (
        meshio_files.fresh(mesh, {}, ".msh").decode().partition("$Elements\n1\n")[2].split("\n")[0].split()
    )
    nodes = [int(word) - 1 for word in words[-shape.size :]]
    assert words[1] == number
    assert nodes[: shape.corners] == list(range(shape.corners))
    assert [set(shape.edges[node - shape.corners]) for node in nodes[shape.corners :]] == list(
        map(set, edges)
    )


def test_one_line_where_meshio_is_missing(tmp_path, monkeypatch):
    meshio.write(tmp_path / "a.vtu", made())
    for name in [name for name in sys.modules if name.split(".")[0] == "meshio"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(FemorsError, match=r"need the Python package meshio.*pip install meshio=="):
        deckfiles.read_deck(tmp_path / "a.vtu")


def test_meshio_is_imported_only_when_it_is_needed():
    code = "import sys, femors_addon.cli; sys.exit('meshio' in sys.modules or 'rich' in sys.modules)"
    root = Path(__file__).parent.parent
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(root), *sys.path])}
    assert subprocess.run([sys.executable, "-c", code], env=environment, check=False).returncode == 0


def test_the_readers_do_without_compiled_packages(monkeypatch):
    """h5py, netCDF4 and lxml are not needed by any of the formats on the list."""
    for name in ("h5py", "netCDF4", "lxml"):
        monkeypatch.setitem(sys.modules, name, None)
    assert set(meshio_files.FORMATS.values()) == {"vtk", "vtu", "gmsh", "medit"}


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.vtk", b"", "is empty"),
        ("a.vtk", b"hello\n", "line 1: '# vtk' was expected, not 'hello'"),
        (
            "a.vtk",
            b"# vtk DataFile Version 4.2\nt\nASCII\nDATASET STRUCTURED_POINTS\n",
            "an UNSTRUCTURED_GRID",
        ),
        (
            "a.vtk",
            b"# vtk DataFile Version 4.2\nt\nASCII\nDATASET UNSTRUCTURED_GRID\n",
            "cannot be read|can be read",
        ),
        ("a.vtu", b"# vtk", "'<' was expected"),
        ("a.vtu", b"<a/>", "can be read"),
        ("a.vtu", b"<!DOCTYPE a []><a/>", "DOCTYPE"),
        ("a.msh", b'(0 "ansys")', r"'\$' was expected"),
        ("a.msh", b"$MeshFormat\n9.9 0 8\n$EndMeshFormat\n", "can be read"),
        ("a.mesh", b"nothing", "can be read"),
        (
            "a.mesh",
            b"MeshVersionFormatted 2\nDimension 3\nRidges\n99999999999999\n",
            "announces 99999999999999",
        ),
    ],
)
def test_faults_are_one_line(tmp_path, name, content, words, capsys):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FemorsError, match=words) as caught:
        deckfiles.read_deck(tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path / name))
    assert "\n" not in str(caught.value)
    assert capsys.readouterr() == ("", "")


def test_cells_that_name_nodes_that_are_not_there(tmp_path):
    mesh = made()
    mesh.cells[0].data[0, 0] = 99
    meshio.vtu.write(tmp_path / "a.vtu", mesh)
    with pytest.raises(FemorsError, match="names node 99"):
        deckfiles.read_deck(tmp_path / "a.vtu")
