# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume meshes: outer surfaces, parts, mid-side nodes."""

from __future__ import annotations

import collections

import numpy as np
import pytest
from solids import enclosed_volume
from volumecases import CUBE, TET, grid, mesh_of, mixed, quadratic

from femors_addon.progress import FemorsError
from femors_addon.volume import Block, VolumeMesh, carry_mid_nodes
from femors_addon.volume_quality import (
    element_volumes,
)


# --- surfaces -------------------------------------------------------------------------------------
def outer_by_hand(mesh: VolumeMesh) -> set[tuple[frozenset[int], int, int]]:
    """Return (corners, element, face) of the faces that stand once, face by face."""
    faces = []
    element = 0
    for block in mesh.blocks:
        for row in block.nodes.tolist():
            for number, face in enumerate(block.shape.faces):
                corners = frozenset(row[i] for i in face)
                if len(corners) >= 3:
                    faces.append((corners, element, number))
            element += 1
    count = collections.Counter(corners for corners, _, _ in faces)
    return {face for face in faces if count[face[0]] == 1}


def as_set(polygons) -> set[tuple[frozenset[int], int, int]]:
    ends = np.cumsum(polygons.sizes)
    rows = [polygons.corners[e - s : e].tolist() for e, s in zip(ends, polygons.sizes, strict=True)]
    assert all(len(set(row)) == len(row) for row in rows)
    return {
        (frozenset(row), e, f)
        for row, e, f in zip(rows, polygons.element.tolist(), polygons.face.tolist(), strict=True)
    }


def test_outer_faces_are_those_that_stand_once():
    mesh = mixed()
    assert as_set(mesh.outer) == outer_by_hand(mesh)
    assert set(mesh.outer.sizes.tolist()) == {3, 4}
    surface, nodes = mesh.surface()
    assert len(nodes) == 4**3 - 2**3
    half = np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(half, axis=0, return_counts=True)[1] == 2).all()  # closed


def test_a_hole_has_an_outer_surface_too():
    nodes, rows = grid(3)
    mesh = mesh_of("hex8", nodes, np.delete(rows, 13, axis=0))
    assert len(mesh.outer.sizes) == 6 * 9 + 6
    assert enclosed_volume(nodes, mesh.outer) == pytest.approx(26)


def test_collapsed_hexahedra():
    """Wedges written as hexahedra with double nodes, as many programs do, beside true wedges."""
    nodes, rows = grid(2)
    first, second = rows[0][[0, 1, 2, 2, 4, 5, 6, 6]], rows[0][[0, 2, 3, 4, 6, 7]]
    blocks = (
        Block("hex8", np.vstack((first, rows[1:])), np.arange(8)),
        Block("penta6", second[None], np.array([9])),
    )
    mesh = VolumeMesh(nodes, blocks, np.arange(len(nodes)))
    assert as_set(mesh.outer) == outer_by_hand(mesh)
    assert enclosed_volume(nodes, mesh.outer) == pytest.approx(8)
    assert element_volumes(mesh).sum() == pytest.approx(8)


def test_shells_are_their_own_surface():
    blocks = (
        Block("quad4", np.array([[0, 1, 2, 3], [4, 5, 6, 6]]), np.array([1, 2])),
        Block("tri6", np.array([[0, 1, 5, 6, 7, 4]]), np.array([3])),
    )
    mesh = VolumeMesh(CUBE, blocks, np.arange(8))
    assert not mesh.solid
    assert mesh.boundary.sizes.tolist() == [4, 3, 3]
    assert mesh.boundary.corners.tolist() == [0, 1, 2, 3, 4, 5, 6, 0, 1, 5]
    assert mesh.surface()[1].tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert element_volumes(mesh).tolist() == [0, 0, 0]
    assert mesh.mid_nodes.tolist() == [[7, 1, 5]]  # 4 and 6 are corners elsewhere


def test_shells_beside_solids_are_not_the_boundary():
    nodes, rows = grid(1)
    blocks = (Block("tri3", np.array([[0, 1, 2]]), np.array([1])), Block("hex8", rows, np.array([2])))
    mesh = VolumeMesh(nodes, blocks, np.arange(8))
    assert mesh.boundary is mesh.outer
    assert mesh.outer.element.tolist() == [1] * 6
    assert mesh.outer.face.tolist() == [0, 1, 2, 3, 4, 5]


# --- the rest -------------------------------------------------------------------------------------
def test_mid_side_nodes_go_with_their_edges():
    nodes = quadratic("tet10", TET)
    mesh = mesh_of("tet10", nodes)
    assert sorted(map(tuple, mesh.mid_nodes[:, 1:].tolist())) == [
        (0, 1),
        (0, 2),
        (0, 3),
        (1, 2),
        (1, 3),
        (2, 3),
    ]
    matrix = np.array([[1.2, 0.3, 0], [0.1, 0.9, 0.2], [0, 0.4, 1.5]])
    wanted = nodes @ matrix.T + 5
    start = wanted.copy()
    start[4:] = np.nan
    assert np.allclose(carry_mid_nodes(mesh, start), wanted)
    # one on a curved edge keeps its offset, which turns with the whole where that is given
    curved = nodes.copy()
    curved[4] += [0.1, 0, 0]
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    start = curved @ turn.T
    start[:4] += 0.5
    carried = carry_mid_nodes(mesh.moved(curved), start, curved @ turn.T)
    assert np.allclose(
        carried[4], carried[:4][[mesh.mid_nodes[0, 1], mesh.mid_nodes[0, 2]]].mean(0) + [0, 0.1, 0]
    )
    assert np.array_equal(carry_mid_nodes(mesh.moved(curved), curved), curved)


def test_parts_bodies_and_sets():
    nodes, rows = grid(2)
    blocks = (
        Block("hex8", rows[:4], np.arange(4) + 1),
        Block("hex8", rows[4:] + len(nodes), np.arange(4) + 5),
    )
    two = VolumeMesh(
        np.vstack((nodes, nodes + 10)),
        blocks,
        np.arange(2 * len(nodes)) + 1,
        {"low": np.array([0, 1, 30])},
        {"e": np.array([1, 5]), "gone": np.array([0])},
        {"s": np.array([40])},
    )
    assert two.bodies.tolist() == [0, 0, 0, 0, 1, 1, 1, 1]
    assert two.element_ids.tolist() == list(range(1, 9))
    assert len(two.used_nodes) == 36
    part, index = two.restricted([1, 4, 5])
    assert part.element_ids.tolist() == [2, 5, 6]
    assert np.array_equal(part.nodes, two.nodes[index])
    assert np.array_equal(part.node_ids, two.node_ids[index])
    assert part.element_sets == {"e": pytest.approx([0, 2])}
    assert index[part.node_sets["low"]].tolist() == [i for i in (0, 1, 30) if i in index]
    assert np.array_equal(index[part.blocks[0].nodes[0]], rows[1])


def test_moving_keeps_the_topology_and_checks_shapes():
    mesh = mixed()
    outer = mesh.outer
    assert mesh.moved(2 * mesh.nodes).outer is outer
    with pytest.raises(ValueError, match="shape"):
        mesh.moved(mesh.nodes[1:])
    with pytest.raises(ValueError, match="read-only"):
        mesh.nodes[0] = 0


def test_what_is_no_mesh_is_refused():
    with pytest.raises(FemorsError, match=r"not finite \(first: node 2\)"):
        mesh_of("tet4", np.vstack((TET[0], [np.nan, 0, 0], TET[2:])))
    with pytest.raises(FemorsError, match="names a node"):
        mesh_of("tet4", TET, np.array([[0, 1, 2, 4]]))
    with pytest.raises(FemorsError, match="no elements with a surface"):
        VolumeMesh(TET, (), np.arange(4)).surface()
