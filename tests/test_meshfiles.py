# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh files of every format: one as another, and whatever bytes there are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from meshtexts import (
    ASCII,
    BINARY,
    CUBE,
    CUBE_QUADS,
    FACE,
    OBJ,
    TETRA,
    TETRA_FACES,
    XYZ,
    header,
    ply_bytes,
    refused,
    saved,
    stl_bytes,
)

from femors_addon import meshfiles
from femors_addon.mesh import Surface
from femors_addon.meshfiles import MeshFile
from femors_addon.progress import FemorsError


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
@pytest.mark.parametrize("origin", [".stl", ".ply", ".obj", ".OBJ"])
def test_any_format_becomes_any_other(tmp_path, origin, suffix):
    sizes, corners = [4] * 6 + [5], [*CUBE_QUADS.ravel(), 0, 1, 3, 2, 4]
    first = MeshFile(CUBE, np.array(sizes), np.array(corners))
    meshfiles.write(tmp_path / f"a{origin}", first)
    read = meshfiles.read(tmp_path / f"a{origin}")
    meshfiles.write(tmp_path / f"b{suffix}", read)
    again = meshfiles.read(tmp_path / f"b{suffix}")
    shape, expected = again.surface(), first.surface()
    assert np.array_equal(shape.vertices[shape.faces], expected.vertices[expected.faces])
    if ".stl" not in (origin, suffix):
        assert again.sizes.tolist() == sizes
        assert np.array_equal(again.vertices, CUBE)


def test_of_surface_and_wrong_shape():
    mesh = MeshFile.of(Surface(TETRA, TETRA_FACES))
    assert np.array_equal(mesh.surface().faces, TETRA_FACES)
    with pytest.raises(ValueError, match=r"\(4, 3\)"):
        mesh.with_vertices(TETRA[:3])


def test_polygons_of_more_corners_than_a_byte_counts(tmp_path):
    angle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    disc = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(300))).astype(np.float32)
    meshfiles.write(tmp_path / "disc.ply", MeshFile(disc, np.array([300]), np.arange(300)))
    again = meshfiles.read(tmp_path / "disc.ply")
    assert again.sizes.tolist() == [300]
    assert np.array_equal(again.vertices, disc)


@pytest.mark.parametrize("suffix", [".stl", ".ply"])
def test_coordinates_beyond_single_precision_are_refused(tmp_path, suffix):
    mesh = MeshFile.of(Surface(1e300 * TETRA, TETRA_FACES))
    with pytest.raises(FemorsError, match="too large"):
        meshfiles.write(tmp_path / f"big{suffix}", mesh)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_missing_folder_empty_and_unknown(tmp_path, suffix):
    refused(tmp_path / f"missing{suffix}", "no such file")
    (tmp_path / f"folder{suffix}").mkdir()
    refused(tmp_path / f"folder{suffix}", "folder")
    refused(saved(tmp_path / f"empty{suffix}", b""), "empty")
    refused(tmp_path / "mesh.step", "'.step'", ".stl, .ply, .obj")
    refused(tmp_path / "noending", "the name has no ending", ".stl, .ply, .obj")


PREFIXES = [
    *(b"", b"solid x\n", ASCII.encode()[:150], b"v 0 0 0\nf 1 ", OBJ, b"ply\n"),
    *(ply_bytes(order)[:-30] for order in ("ascii", "binary_little_endian", "binary_big_endian")),
    header(BINARY, "element vertex 1", *XYZ, "element face 3", FACE, body=bytes(12)),
    stl_bytes(TETRA[TETRA_FACES])[:-50],
]
WORDS = [b"facet normal 0 0 1", b"outer loop", b"vertex", b"solid", b"endsolid", b"\n", b" ", b"v", b"f"]
WORDS += [
    b"1/1/1",
    b"-1",
    b"\\\n",
    b"element vertex 99999999999",
    b"end_header\n",
    b"1e999",
    b"nan",
    b"#",
    b"3",
]


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
@settings(
    max_examples=150,
    deadline=2000,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    prefix=st.sampled_from(PREFIXES),
    tail=st.one_of(st.binary(max_size=200), st.lists(st.sampled_from(WORDS), max_size=25).map(b" ".join)),
)
@example(prefix=b"v 0 0 0\n", tail=b"f 1" + b"/" * 10)
@example(prefix=b"ply\r\n", tail=b"format ascii 1.0\r\nend_header\r\n")
def test_no_bytes_give_anything_but_a_mesh_or_one_line(tmp_path, suffix, prefix, tail):
    path = saved(tmp_path / f"fuzz{suffix}", prefix + tail)
    try:
        mesh = meshfiles.read(path)
        meshfiles.encoded(path, mesh.with_vertices(mesh.vertices + 1.0))
    except FemorsError as error:
        assert len(str(error).splitlines()) == 1
