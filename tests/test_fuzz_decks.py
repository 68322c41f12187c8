# SPDX-License-Identifier: GPL-3.0-or-later
"""Whatever stands in a deck, reading it ends, in a deck or in one line; and decks survive being moved."""

from __future__ import annotations

import functools
import importlib.util
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from femors_addon import deckfiles
from femors_addon.progress import FemorsError

pytestmark = [
    pytest.mark.filterwarnings("ignore::RuntimeWarning:meshio"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning:meshio"),
]

INP = b"""*HEADING
two
*PART, NAME=P
*NODE, NSET=ALL
1, 0., 0., 0.
2, 1., 0., 0
** comment
3, 0, 1.D0, 0
4, 0, 0, 1
5, 1, 1, 1
*ELEMENT, TYPE=C3D4, ELSET=E
1, 1, 2, 3, 4
2, 2, 3,
4, 5
*ELEMENT, TYPE=S3
3, 1, 2, 3
*NSET, NSET=N, GENERATE
1, 5, 2
*ELSET, ELSET=B
E, 3
*SURFACE, NAME=S
E, S1
*END PART
*ASSEMBLY, NAME=A
*INSTANCE, NAME=I, PART=P
1., 2., 3.
0,0,0, 0,0,1, 45.
*END INSTANCE
*NSET, NSET=M, INSTANCE=I
1, 2
*END ASSEMBLY
*INCLUDE, INPUT=more.inc
*STEP
"""
FEB = b"""<?xml version="1.0"?>
<febio_spec version="4.0"><Mesh>
<Nodes name="n"><node id="1">0,0,0</node><node id="2">1,0,0</node>
<node id="3">0,1,0</node><node id="4"> 0 , 0,1.e0</node></Nodes>
<Elements type="tet4" name="p"><elem id="1">1,2,3,4</elem></Elements>
<NodeSet name="s">1,2:4:1</NodeSet><NodeSet name="t"><n id="1"/></NodeSet>
<Surface name="u"><tri3 id="1">1,2,3</tri3></Surface>
</Mesh></febio_spec>
"""
BDF = b"""BEGIN BULK
GRID    1               0.      0.0     .0              123456
GRID           2      0 1.      0.      -0.
GRID,3,,0.,1.+0,0.
GRID*                  4                             0.0             0.0
*                  1.0D0               0
CTETRA  1       7       1       2       3       4
CTRIA3,2,8,1,2,3
ENDDATA
"""
VTK = b"""# vtk DataFile Version 4.2
t
ASCII
DATASET UNSTRUCTURED_GRID
POINTS 4 double
0 0 0 1 0 0 0 1 0 0 0 1
CELLS 1 5
4 0 1 2 3
CELL_TYPES 1
10
POINT_DATA 4
SCALARS a float 1
LOOKUP_TABLE default
1 2 3 4
"""
VTU = b"""<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian"><UnstructuredGrid>
<Piece NumberOfPoints="4" NumberOfCells="1"><Points>
<DataArray type="Float64" NumberOfComponents="3" format="ascii">0 0 0 1 0 0 0 1 0 0 0 1</DataArray></Points>
<Cells><DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 3</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">4</DataArray>
<DataArray type="Int64" Name="types" format="ascii">10</DataArray></Cells>
<PointData><DataArray type="Float32" Name="a" format="ascii">1 2 3 4</DataArray></PointData>
</Piece></UnstructuredGrid></VTKFile>
"""
MSH = b"""$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
1
3 1 "bone"
$EndPhysicalNames
$Nodes
4
1 0 0 0
2 1 0 0
3 0 1 0
4 0 0 1
$EndNodes
$Elements
2
1 4 2 1 1 1 2 3 4
2 2 2 2 2 1 2 3
$EndElements
"""
MSH4 = b"""$MeshFormat
4.1 0 8
$EndMeshFormat
$Nodes
1 4 1 4
3 1 0 4
1
2
3
4
0 0 0
1 0 0
0 1 0
0 0 1
$EndNodes
$Elements
1 1 1 1
3 1 4 1
1 1 2 3 4
$EndElements
"""
MESH = b"""MeshVersionFormatted 2
Dimension 3
Vertices
4
0 0 0 1
1 0 0 1
0 1 0 1
0 0 1 1
Tetrahedra
1
1 2 3 4 1
End
"""
SOURCES = b"""$NodeData
1
"a"
1
0.0
3
0
1
4
1 1.
2 1.
3 1.
4 1.
$EndNodeData
"""
OURS = {".inp": INP, ".feb": FEB, ".bdf": BDF}
THEIRS = [(".vtk", VTK), (".vtu", VTU), (".msh", MSH), (".msh", MSH4 + SOURCES), (".mesh", MESH)]

edit = st.tuples(
    st.floats(0, 1),
    st.sampled_from(["insert", "replace", "delete", "copy", "cut"]),
    st.integers(0, 40),
    st.sampled_from(
        [b"", b"0", b"-1", b"99999999999999999999", b"1e400", b"nan", b",", b",,", b"*", b"\n", b"\r"]
    )
    | st.sampled_from(
        [b"<", b">", b'"', b"&a;", b"\0", b"\xff", b" ", b"\t", b"*NODE\n", b"</Nodes>", b"+", b"$"]
    )
    | st.binary(max_size=4),
)


def mutated(data: bytes, edits: list[tuple[float, str, int, bytes]]) -> bytes:
    """Return the data after some insertions, deletions, repetitions and cuts."""
    for where, what, length, piece in edits:
        at = int(where * len(data))
        rest = {"insert": at, "replace": at + len(piece), "delete": at + length, "copy": at, "cut": len(data)}
        inserted = data[at : at + length] if what == "copy" else b"" if what in ("delete", "cut") else piece
        data = data[:at] + inserted + data[rest[what] :]
    return data


def limited(test):
    """Make a hang a failure."""

    @functools.wraps(test)
    def wrapped(*args, **kwargs):
        if not hasattr(signal, "alarm"):
            return test(*args, **kwargs)

        def late(*_):
            raise TimeoutError("reading does not come to an end")

        before = signal.signal(signal.SIGALRM, late)
        signal.alarm(max(60, EXAMPLES // 5))
        try:
            return test(*args, **kwargs)
        finally:
            signal.alarm(0)
            signal.signal(signal.SIGALRM, before)

    return wrapped


def check(suffix: str, data: bytes, moves: bool) -> None:
    path = Path(f"deck{suffix}")
    files = {path: data, Path("more.inc"): b"*MATERIAL\n"}

    def load(name: Path) -> bytes:
        if name not in files:
            raise FemorsError(f"{name}: there is no such file")
        return files[name]

    try:
        deck = deckfiles.read_deck(path, load)
    except FemorsError as error:
        text = str(error)
        assert text.startswith(("deck", "more")), text
        assert "\n" not in text
        return
    assert deck.encoded() == data
    if moves:
        with np.errstate(over="ignore"):
            moved = deck.with_coordinates(np.clip(deck.coordinates * 0.5 + 1.0, -1e200, 1e200))
        files[path] = moved.encoded()
        again = deckfiles.read_deck(path, load)
        assert np.allclose(again.coordinates, moved.coordinates, rtol=1e-8, atol=1e-12)
        assert len(again.mesh.blocks) == len(deck.mesh.blocks)
        for one, two in zip(again.mesh.blocks, deck.mesh.blocks, strict=True):
            assert np.array_equal(one.nodes, two.nodes)
            assert np.array_equal(one.ids, two.ids)
        assert again.parts.keys() == deck.parts.keys()


EXAMPLES = int(os.environ.get("FEMORS_FUZZ", "200"))
"""How many to try; FEMORS_FUZZ=10000 for a night."""
SLOW = settings(
    deadline=None,
    max_examples=EXAMPLES,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


@pytest.fixture(autouse=True)
def _include(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "more.inc").write_bytes(b"*MATERIAL\n")


@pytest.mark.parametrize("suffix", OURS)
@limited
@settings(SLOW)
@given(edits=st.lists(edit, max_size=4))
def test_changed_decks_of_ours(suffix, edits):
    check(suffix, mutated(OURS[suffix], edits) or b" ", moves=True)


@pytest.mark.parametrize("suffix", OURS)
@limited
@settings(SLOW)
@given(data=st.binary(min_size=1, max_size=300))
def test_random_bytes(suffix, data):
    start = {".inp": b"*NODE\n", ".feb": b"<febio_spec>", ".bdf": b"GRID"}[suffix]
    check(suffix, data, moves=True)
    check(suffix, start + data, moves=True)


@pytest.mark.skipif(importlib.util.find_spec("meshio") is None, reason="meshio is not installed")
@pytest.mark.parametrize(("suffix", "data"), THEIRS)
@limited
@settings(SLOW, max_examples=EXAMPLES // 2)
@given(edits=st.lists(edit, max_size=4))
def test_changed_files_that_meshio_reads(suffix, data, edits):
    check(suffix, mutated(data, edits) or b" ", moves=suffix == ".msh")


@pytest.mark.parametrize("suffix", OURS)
def test_cut_short_at_every_byte(suffix):
    data = OURS[suffix]
    for length in range(1, len(data)):
        check(suffix, data[:length], moves=False)
    check(suffix, data, moves=True)
