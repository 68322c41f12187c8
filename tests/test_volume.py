# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume meshes against theory: volumes, scaled Jacobians, outer surfaces, parts and mid-side nodes."""

from __future__ import annotations

import collections
import itertools
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from growth import LINEAR, growth
from solids import enclosed_volume

from femors_addon import deckfiles, elements
from femors_addon.elements import KINDS, abaqus_kind, febio_kind
from femors_addon.progress import FemorsError
from femors_addon.volume import Block, VolumeMesh, carry_mid_nodes
from femors_addon.volume_quality import (
    VolumeQuality,
    element_volumes,
    inverted,
    scaled_jacobians,
)

KNEE = Path(os.environ.get("FEMORS_DATA", Path(__file__).parent.parent.parent / "shared" / "data")) / "knee"
needs_knee = pytest.mark.skipif(not KNEE.is_dir(), reason=f"there is no {KNEE}")

S = np.sqrt(3) / 2
TET = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(8)
TET = TET[[0, 2, 1, 3]] if np.linalg.det(TET[[1, 2, 3]] - TET[0]) < 0 else TET
WEDGE = np.array([[x, y, z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (0.5, S))])
CUBE = np.array([[x, y, z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))], dtype=float)
PYRAMID = np.array([*CUBE[:4], [0.5, 0.5, np.sqrt(0.5)]])
REGULAR = {"tet4": TET, "penta6": WEDGE, "hex8": CUBE, "pyra5": PYRAMID}
VOLUME = {"tet4": np.sqrt(2) / 12, "penta6": S / 2, "hex8": 1.0, "pyra5": np.sqrt(2) / 6}


def mesh_of(kind: str, nodes: np.ndarray, rows: np.ndarray | None = None, **more) -> VolumeMesh:
    rows = np.arange(len(nodes))[None] if rows is None else np.asarray(rows)
    block = Block(kind, rows, np.arange(1, len(rows) + 1))
    return VolumeMesh(nodes, (block,), np.arange(1, len(nodes) + 1), **more)


def quadratic(kind: str, nodes: np.ndarray) -> np.ndarray:
    """Return the nodes with mid-side nodes at the middle of the kind's edges."""
    return np.array([*nodes, *(nodes[[a, b]].mean(axis=0) for a, b in KINDS[kind].edges)])


def grid(n: int, jitter: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and hexahedra of n x n x n cubes, interior and border nodes shaken."""
    axis = np.arange(n + 1)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3).astype(float)
    index = np.arange(len(nodes)).reshape(n + 1, n + 1, n + 1)
    steps = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
    rows = np.stack([index[i : i + n, j : j + n, k : k + n] for i, j, k in steps], -1).reshape(-1, 8)
    return nodes + jitter * np.random.default_rng(3).normal(size=nodes.shape), rows


def mixed() -> VolumeMesh:
    """Hexahedra, of which some are cut into wedges and one into pyramids about its middle."""
    nodes, hexes = grid(3, 0.08)
    hexes = hexes.copy()
    wedges = [row[list(half)] for row in hexes[:9] for half in ((0, 1, 2, 4, 5, 6), (0, 2, 3, 4, 6, 7))]
    middle = len(nodes)
    nodes = np.vstack((nodes, nodes[hexes[26]].mean(axis=0)))
    pyramids = [[*(hexes[26][list(face)][::-1]), middle] for face in KINDS["hex8"].faces]
    blocks = (
        Block("hex8", hexes[9:26], np.arange(100, 117)),
        Block("penta6", np.array(wedges), np.arange(200, 218)),
        Block("pyra5", np.array(pyramids), np.arange(300, 306)),
    )
    return VolumeMesh(nodes, blocks, np.arange(len(nodes)) + 1)


# --- kinds ----------------------------------------------------------------------------------------
def test_faces_of_every_solid_are_closed_and_look_outward():
    for kind in KINDS.values():
        if not kind.solid:
            continue
        halves = collections.Counter()
        for face in kind.faces:
            halves.update(zip(face, face[1:] + face[:1], strict=True))
        assert set(halves.values()) == {1}, kind.name
        assert all((b, a) in halves for a, b in halves), kind.name
        assert {tuple(sorted(pair)) for pair in halves} >= {tuple(sorted(edge)) for edge in kind.edges}
        corners = REGULAR[next(name for name in REGULAR if KINDS[name].corners == kind.corners)]
        for face in kind.faces:
            a, b, c = corners[list(face[:3])]
            assert np.dot(np.cross(b - a, c - a), a - corners.mean(axis=0)) > 0, (kind.name, face)
        for corner, *ends in kind.frames:
            assert np.linalg.det(corners[ends] - corners[corner]) > 0, (kind.name, corner)
            assert all((corner, end) in halves for end in ends)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *(
            ("C3D4", "tet4"),
            ("c3d10m", "tet10"),
            ("C3D10MH", "tet10"),
            ("C3D10HS", "tet10"),
            ("C3D6", "penta6"),
        ),
        *(
            ("C3D8", "hex8"),
            ("C3D8R", "hex8"),
            ("C3D8IH", "hex8"),
            ("C3D20R", "hex20"),
            ("C3D20RHT", "hex20"),
        ),
        *(("C3D15", "penta15"), ("DC3D8", "hex8"), ("AC3D4", "tet4"), ("SC8R", "hex8"), ("C3D5", "pyra5")),
        *(
            ("S3", "tri3"),
            ("S3R", "tri3"),
            ("S4", "quad4"),
            ("S4R", "quad4"),
            ("S4R5", "quad4"),
            ("S4RS", "quad4"),
        ),
        *(("STRI3", "tri3"), ("STRI65", "tri6"), ("S8R", "quad8"), ("S8R5", "quad8"), ("R3D3", "tri3")),
        *(("R3D4", "quad4"), ("M3D3", "tri3"), ("M3D4R", "quad4"), ("M3D6", "tri6"), ("SFM3D4R", "quad4")),
        *(("CPS3", "tri3"), ("CPE4RH", "quad4"), ("CPS6M", "tri6"), ("CPE8R", "quad8"), ("CAX4R", "quad4")),
        *(
            ("C3D27", None),
            ("C3D15V", None),
            ("T3D2", None),
            ("SPRINGA", None),
            ("B31", None),
            ("COH3D8", None),
        ),
        *(("MASS", None), ("CONN3D2", None), ("U1", None), ("", None), ("S9R5", None), ("GK3D8", None)),
    ],
)
def test_names_of_abaqus(name, kind):
    found = abaqus_kind(name)
    assert (found and found.name) == kind


def test_names_of_febio_and_back():
    assert febio_kind("TET10G4RI1").name == "tet10"
    assert febio_kind(" hex8 ").name == "hex8"
    assert febio_kind("q4ans").name == "quad4"
    assert febio_kind("hex27") is febio_kind("truss2") is febio_kind("") is None
    for kind in KINDS:
        assert febio_kind(kind).name == kind
    for kind, name in elements.ABAQUS_NAMES.items():
        assert abaqus_kind(name).name == kind


# --- scaled Jacobian ------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", REGULAR)
def test_a_regular_element_has_one_and_its_mirror_image_minus_one(kind):
    rng = np.random.default_rng(1)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    nodes = 7.3 * REGULAR[kind] @ turn.T + [100, -50, 3]
    mesh = mesh_of(kind, nodes)
    assert scaled_jacobians(mesh) == pytest.approx(1.0, abs=1e-12)
    assert element_volumes(mesh) == pytest.approx(7.3**3 * VOLUME[kind], rel=1e-10)
    assert len(inverted(mesh)) == 0
    mirror = mesh.moved(nodes * [-1, 1, 1])
    assert scaled_jacobians(mirror) == pytest.approx(-1.0, abs=1e-12)
    assert element_volumes(mirror) == pytest.approx(-(7.3**3) * VOLUME[kind], rel=1e-10)
    assert inverted(mirror).tolist() == [0]


@pytest.mark.parametrize("shear", [0.0, 0.3, 1.0, 5.0])
def test_a_sheared_cube(shear):
    nodes = CUBE + shear * CUBE[:, 2:] * [1, 0, 0]
    assert scaled_jacobians(mesh_of("hex8", nodes)) == pytest.approx(1 / np.sqrt(1 + shear**2))
    assert element_volumes(mesh_of("hex8", nodes)) == pytest.approx(1.0)


def test_a_trirectangular_tetrahedron():
    # at the right-angled corner sqrt(2), at the others sqrt(2) * 1 / (1 * sqrt(2) * sqrt(2))
    nodes = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    assert scaled_jacobians(mesh_of("tet4", nodes)) == pytest.approx(np.sqrt(0.5))


def test_stretching_edges_of_a_box_costs_nothing_and_flattening_a_tetrahedron_all():
    assert scaled_jacobians(mesh_of("hex8", CUBE * [1, 10, 0.1])) == pytest.approx(1.0)
    flat = [scaled_jacobians(mesh_of("tet4", TET * [1, 1, z]))[0] for z in (1, 0.3, 0.1, 0.01, 0.0)]
    assert flat == sorted(flat, reverse=True)
    assert flat[-1] == 0.0


def test_one_corner_pushed_through_inverts_a_hexahedron_of_positive_volume():
    nodes = CUBE.copy()
    nodes[6] = [0.2, 0.2, 0.2]
    mesh = mesh_of("hex8", nodes)
    assert element_volumes(mesh)[0] > 0
    assert scaled_jacobians(mesh)[0] < 0


@pytest.mark.parametrize("kind", ["tet10", "penta15", "hex20", "pyra13"])
def test_mid_side_nodes_bend_the_edges(kind):
    corners = next(nodes for name, nodes in REGULAR.items() if len(nodes) == KINDS[kind].corners)
    nodes = quadratic(kind, corners)
    assert len(nodes) == KINDS[kind].size
    assert scaled_jacobians(mesh_of(kind, nodes)) == pytest.approx(1.0)
    bent = nodes.copy()
    bent[KINDS[kind].corners] += 0.05 * (nodes.mean(axis=0) - bent[KINDS[kind].corners])
    assert 0.5 < scaled_jacobians(mesh_of(kind, bent))[0] < 1.0
    # a mid-side node beyond the end of its edge turns that corner inside out
    one, two = KINDS[kind].edges[0]
    bent[KINDS[kind].corners] = nodes[one] + 0.5 * (nodes[one] - nodes[two])
    assert scaled_jacobians(mesh_of(kind, bent))[0] < 0
    assert len(mesh_of(kind, nodes).outer.nodes) == KINDS[kind].corners


def test_coincident_nodes_give_zero_without_a_warning():
    assert scaled_jacobians(mesh_of("hex8", np.zeros((8, 3)))).tolist() == [0.0]
    assert scaled_jacobians(mesh_of("tri3", TET[:3])).tolist() == [1.0]


# --- volumes --------------------------------------------------------------------------------------
def trilinear(nodes: np.ndarray) -> float:
    """Volume of a hexahedron by Gauss quadrature of its Jacobian, exact for the trilinear map."""
    total = 0.0
    signs = 2 * CUBE - 1
    for xi in itertools.product((-1 / np.sqrt(3), 1 / np.sqrt(3)), repeat=3):
        factors = 1 + signs * xi
        gradient = np.stack(
            [signs[:, a] * factors[:, (a + 1) % 3] * factors[:, (a + 2) % 3] / 8 for a in range(3)]
        )
        total += np.linalg.det(gradient @ nodes)
    return total


def test_a_warped_hexahedron_has_the_volume_of_its_trilinear_map():
    rng = np.random.default_rng(0)
    for _ in range(20):
        nodes = CUBE + 0.25 * rng.normal(size=(8, 3)) + 1000
        assert element_volumes(mesh_of("hex8", nodes))[0] == pytest.approx(trilinear(nodes - 1000), rel=1e-9)


def test_a_wedge_is_a_collapsed_hexahedron():
    rng = np.random.default_rng(0)
    wedge = WEDGE + 0.1 * rng.normal(size=(6, 3))
    as_hex = wedge[[0, 1, 2, 2, 3, 4, 5, 5]]
    assert element_volumes(mesh_of("penta6", wedge))[0] == pytest.approx(trilinear(as_hex))


def test_volumes_of_all_elements_are_that_of_the_surface():
    mesh = mixed()
    inside = enclosed_volume(mesh.nodes, mesh.outer)
    assert element_volumes(mesh).sum() == pytest.approx(inside, rel=1e-12)
    matrix = np.array([[1.2, 0.3, 0], [0.1, 0.9, 0.2], [0, 0.4, 1.5]])
    moved = mesh.moved(mesh.nodes @ matrix.T + 4)
    assert element_volumes(moved).sum() == pytest.approx(inside * np.linalg.det(matrix), rel=1e-12)
    assert mesh.surface()[0].volume == pytest.approx(inside, rel=0.02)


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


def test_quality_of_some_elements():
    nodes, rows = grid(2)
    nodes[13] = [0.1, 0.1, 0.1]  # the middle, pushed into one corner
    mesh = mesh_of("hex8", nodes, rows)
    whole = VolumeQuality.of(mesh)
    some = VolumeQuality.of(mesh, scaled_jacobians(mesh) > 0.5)
    assert whole.volume == pytest.approx(8)
    assert whole.minimum < some.minimum
    assert some.inverted == 0
    assert set(whole.as_dict()) == {"minimum", "p01", "median", "volume", "inverted"}
    assert VolumeQuality.of(mesh_of("tri3", TET[:3])).volume == 0


def test_figures_of_elements_grow_with_their_number_and_no_faster():
    def figures(side: int) -> VolumeMesh:
        nodes, rows = grid(side)
        mesh = mesh_of("hex8", nodes, rows)
        assert scaled_jacobians(mesh).min() == pytest.approx(1)
        assert element_volumes(mesh).sum() == pytest.approx(side**3)
        assert len(mesh.outer.sizes) == 6 * side**2
        return mesh

    assert growth(figures, 24, 48) < LINEAR


def test_figures_of_elements_are_computed_for_all_at_once():
    def calls(side: int) -> int:
        count = 0

        def called(frame: object, event: str, argument: object) -> None:
            nonlocal count
            count += event == "call"

        mesh = mesh_of("hex8", *grid(side))
        sys.setprofile(called)
        try:
            scaled_jacobians(mesh), element_volumes(mesh), mesh.outer
        finally:
            sys.setprofile(None)
        return count

    calls(2)
    assert calls(12) == calls(6)  # eight times as many, and not one call more


@needs_knee
@pytest.mark.parametrize(
    ("name", "nodes", "count", "outer", "bad", "volume"),
    [
        ("cartilage_femur_hex", 20584, 14775, 11170, 1, 14681.886),
        ("cartilage_femur_tet", 11016, 49455, 10718, 0, 16504.920),
        ("cartilage_patella_hex", 9975, 8064, 3648, 0, 2637.859),
        ("cartilage_tibia_tet", 1597, 4846, 2848, 0, 4297.464),
    ],
)
def test_cartilage(name, nodes, count, outer, bad, volume):
    mesh = deckfiles.read_deck(KNEE / f"{name}.inp").mesh
    assert (len(mesh.nodes), mesh.element_count, len(mesh.outer.sizes)) == (nodes, count, outer)
    assert len(inverted(mesh)) == bad
    assert element_volumes(mesh).sum() == pytest.approx(volume, abs=1e-3)
    assert enclosed_volume(mesh.nodes, mesh.outer) == pytest.approx(volume, abs=1e-3)
    if name == "cartilage_femur_hex":
        assert scaled_jacobians(mesh).min() == pytest.approx(-0.459, abs=5e-4)
