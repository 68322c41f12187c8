# SPDX-License-Identifier: GPL-3.0-or-later
"""Figures of finite elements against theory: scaled Jacobians and volumes."""

from __future__ import annotations

import itertools
import sys

import numpy as np
import pytest
from growth import LINEAR, growth
from solids import enclosed_volume
from volumecases import CUBE, KNEE, REGULAR, TET, VOLUME, WEDGE, grid, mesh_of, mixed, needs_knee, quadratic

from femors_addon import deckfiles
from femors_addon.elements import KINDS
from femors_addon.volume import VolumeMesh
from femors_addon.volume_quality import (
    VolumeQuality,
    element_volumes,
    inverted,
    scaled_jacobians,
)


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


# --- the rest -------------------------------------------------------------------------------------
def test_quality_of_some_elements():
    nodes, rows = grid(2)
    nodes[13] = [0.1, 0.1, 0.1]  # the middle, pushed into one corner
    mesh = mesh_of("hex8", nodes, rows)
    whole = VolumeQuality.of(mesh)
    some = VolumeQuality.of(mesh, scaled_jacobians(mesh) > 0.5)
    assert whole.volume == pytest.approx(8)
    assert whole.minimum < some.minimum
    assert some.inverted == 0
    assert set(whole.as_dict()) == {"minimum", "p01", "median", "volume", "inverted", "worst"}
    assert scaled_jacobians(mesh)[whole.worst - 1] == whole.minimum and mesh.element_ids[0] == 1
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
