# SPDX-License-Identifier: GPL-3.0-or-later
"""Legacy VTK surfaces: read in every variant, and written with only the coordinates changed."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from femors_addon import deckfiles
from femors_addon.progress import FemorsError

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0.125], [0, 1, 0], [0.5, 0.5, 1.1]])
DATA = b"POINT_DATA 5\nSCALARS a double 1\nLOOKUP_TABLE default\n1 2 3 4 5\n"
ROWS = [(0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]


def text(version: str) -> bytes:
    head = f"# vtk DataFile Version {version}\na box\nASCII\nDATASET POLYDATA\nPOINTS 5 double\n"
    lines = ["0 0 0  1.0 0 0 1 1 0.125", "0 1 0 .5 5e-1 1.1", ""]
    if version == "5.1":
        lines.insert(0, "")
        cells = ["METADATA", "INFORMATION 0", "", "POLYGONS 6 16", "OFFSETS vtktypeint64", "0 4 7 10 13 16"]
        cells += ["CONNECTIVITY vtktypeint64", " ".join(str(i) for row in ROWS for i in row), ""]
    else:
        cells = [
            "LINES 1 3",
            "2 0 1",
            "POLYGONS 5 21",
            *(f"{len(r)} {' '.join(map(str, r))}" for r in ROWS),
            "",
        ]
    return head.encode() + "\n".join(lines + cells).encode() + DATA


def binary(version: str) -> bytes:
    out = f"# vtk DataFile Version {version}\na box\nBINARY\nDATASET POLYDATA\n".encode()
    if version == "5.1":
        out += b"FIELD FieldData 1\ntime 1 1 double\n" + struct.pack(">d", 0.5) + b"\n"
    out += b"POINTS 5 float\n" + POINTS.astype(">f4").tobytes() + b"\n"
    flat = [i for row in ROWS for i in row]
    if version == "5.1":
        out += b"POLYGONS 6 16\nOFFSETS vtktypeint64\n" + np.array([0, 4, 7, 10, 13, 16], ">i8").tobytes()
        out += b"\nCONNECTIVITY vtktypeint64\n" + np.array(flat, ">i8").tobytes() + b"\n"
    else:
        counted = [i for row in ROWS for i in (len(row), *row)]
        out += b"POLYGONS 5 21\n" + np.array(counted, ">i4").tobytes() + b"\n"
    return out + DATA


FILES = {f"{make.__name__} {version}": make(version) for make in (text, binary) for version in ("3.0", "5.1")}


def deck(tmp_path: Path, data: bytes):
    path = tmp_path / "box.vtk"
    path.write_bytes(data)
    return deckfiles.read(path)


@pytest.mark.parametrize("name", FILES)
def test_every_variant_is_read(tmp_path, name):
    found = deck(tmp_path, FILES[name])
    single = "binary" in name
    assert np.array_equal(found.coordinates, POINTS.astype(np.float32) if single else POINTS)
    assert list(found.parts) == ["box"]
    surface, _ = found.mesh.surface()
    assert len(surface.faces) == 6
    assert surface.volume == pytest.approx(1.1 / 3 - 0.125 / 6, rel=1e-6)  # a pyramid, one corner raised


@pytest.mark.parametrize("name", FILES)
def test_only_what_moved_changes(tmp_path, name):
    data = FILES[name]
    found = deck(tmp_path, data)
    assert found.encoded() == data
    nodes = np.array(found.coordinates)
    nodes[4, 2] = 1.25
    new = found.with_coordinates(nodes).encoded()
    assert np.array_equal(deck(tmp_path, new).coordinates, nodes)
    assert new.endswith(DATA)
    if "text" in name:
        assert new == data.replace(b"1.1", b"1.25")
    else:
        assert len(new) == len(data)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ((b"POINTS 5", b"POINTS 6"), "numbers were announced"),
        ((b"POINTS 5 double", b"POINTS 5 char"), "float or double"),
        ((b"4 0 3 2 1", b"4 0 3 2 9"), "does not have"),
        ((b"4 0 3 2 1", b"7 0 3 2 1"), "do not fit"),
        ((b"4 0 3 2 1", b"4 0 3 2 x"), "a word where a number|numbers were announced"),
        ((b"POLYGONS", b"POLYGRONS"), "is not known"),
        ((b"1.1", b"nan"), "not finite"),
    ],
)
def test_what_is_broken_is_one_line(tmp_path, change, said):
    with pytest.raises(FemorsError, match=said) as error:
        deck(tmp_path, text("3.0").replace(*change))
    assert "\n" not in str(error.value)
    assert "box.vtk" in str(error.value)


def test_a_file_cut_short_anywhere_is_an_error_or_whole(tmp_path):
    for data in FILES.values():
        for stop in range(60, len(data) - len(DATA) - 1, 7):
            with pytest.raises(FemorsError):
                deck(tmp_path, data[:stop])
