# SPDX-License-Identifier: GPL-3.0-or-later
"""The figures of a mesh, on meshes whose figures are known."""

from __future__ import annotations

import json

import numpy as np
import pytest

from femors_addon.examine import examine
from femors_addon.mesh import Surface
from femors_addon.progress import Cancelled, FemorsError
from femors_addon.shapes import pair


@pytest.fixture(scope="module")
def bone() -> Surface:
    return pair(1200, 1200).source


def test_a_sound_mesh(bone):
    found = examine(bone)
    assert (found.vertices, found.faces) == (len(bone.vertices), len(bone.faces))
    assert found.given_vertices == found.vertices and "merging" not in found.summary()
    assert (found.pieces, found.open_edges, len(found.bad)) == (1, 0, 0)
    assert found.volume == pytest.approx(bone.volume) and found.volume > 0
    assert found.area == pytest.approx(bone.face_areas.sum())
    assert 0 < found.scaled_jacobian.p01 <= found.scaled_jacobian.median <= 1
    assert found.against is None and found.elements is None


def test_faults_are_told_by_the_faces_as_given(bone):
    """A spike through the surface, a face without area, a hole; the mesh unmerged and in another order."""
    rng = np.random.default_rng(3)
    order = rng.permutation(len(bone.faces))[5:]
    soup = bone.vertices[bone.faces[order]].reshape(-1, 3)
    faces = np.arange(len(soup)).reshape(-1, 3)
    middle = bone.vertices.mean(axis=0)
    across = np.array([[200.0, 0, 0], [-200.0, 0, 1], [-200.0, 1, 0]]) + middle
    flat = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]]) + middle
    spoilt = Surface(
        np.concatenate((soup, across, flat)), np.concatenate((faces, faces[-1:] + 3, faces[-1:] + 6))
    )
    found = examine(spoilt)
    assert len(bone.faces) - 5 in found.self_intersecting and len(found.self_intersecting) >= 3
    assert found.degenerate.tolist() == [len(bone.faces) - 4]
    assert len(bone.faces) - 5 in found.slender
    assert found.open_edges >= 9 and found.volume is None and found.pieces == 2
    merged = len(np.unique(spoilt.vertices, axis=0)) - len(flat)  # a face without area is left out
    assert (found.vertices, found.given_vertices) == (merged, 3 * found.faces)
    assert f"vertices before merging     {3 * found.faces}" in found.summary().splitlines()
    assert set(found.degenerate) | set(found.self_intersecting) <= set(found.bad)


def test_edges_of_three_faces_are_not_open_ones(bone):
    """A fin on an edge: two open sides, and an edge with three faces."""
    a, b, _ = bone.faces[0]
    tip = len(bone.vertices)
    away = 2.0 * bone.vertices[a] - bone.vertices.mean(axis=0)
    found = examine(Surface(np.vstack((bone.vertices, away)), np.vstack((bone.faces, [[a, b, tip]]))))
    assert (found.open_edges, found.nonmanifold_edges) == (2, 1)
    assert "open, non-manifold edges    2, 1" in found.summary().splitlines()
    assert found.as_dict()["mesh"]["nonmanifold_edges"] == 1


def test_a_folded_face_is_found(bone):
    moved = np.array(bone.vertices)
    face = bone.faces[100]
    a, b, c = moved[face]
    moved[face[0]] = a + 2.5 * (0.5 * (b + c) - a)
    assert len(examine(Surface(moved, bone.faces)).folded) > 0


def test_beside_itself_moved(bone):
    step = 0.5
    found = examine(bone.moved(bone.vertices + [step, 0, 0]), bone).against
    assert found.movement.median == pytest.approx(step) and found.flipped == 0
    assert found.mesh_to_other.maximum <= step + 1e-9 and found.hausdorff.maximum <= step + 1e-9
    assert found.crossing > 0
    # a small shift sweeps each face's share of area across the direction, twice
    normals = np.abs(bone.face_cross[:, 0]).sum() / 2
    assert found.overlap.xor == pytest.approx(step * normals, rel=0.03)
    assert 0.9 < found.overlap.dice < 1


def test_an_open_mesh_has_no_volume_and_says_so(bone):
    found = examine(Surface(bone.vertices, bone.faces[4:]), bone)
    assert found.against.overlap is None and "the first mesh is open" in found.against.no_overlap
    assert "the first mesh is open" in found.summary()


def test_the_figures_are_json_and_readable(bone):
    found = examine(bone, bone)
    text = json.dumps(found.as_dict(), allow_nan=False)
    assert 0.0 <= json.loads(text)["against"]["overlap"]["xor"] <= 1e-12 * bone.volume  # rounding
    assert "XOR volume" in found.summary() and "dihedral" in found.summary()


def test_it_can_be_cancelled_and_refuses_what_is_no_surface(bone):
    def stop(fraction, text):
        if fraction > 0.5:
            raise Cancelled

    with pytest.raises(Cancelled):
        examine(bone, bone, progress=stop)
    with pytest.raises(FemorsError, match="no faces"):
        examine(Surface(np.zeros((3, 3)), np.zeros((0, 3), int)))
