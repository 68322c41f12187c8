# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes follow their surface: known warps come back, and no element is ever inverted."""

from __future__ import annotations

import numpy as np
import pytest
from anatomy import DATA

from femors_addon.interior import harmonic, stiffness
from femors_addon.mesh import Surface
from femors_addon.morph_settings import MorphSettings
from femors_addon.nearest import SurfaceIndex
from femors_addon.progress import Cancelled, FemorsError
from femors_addon.volume import Block, VolumeMesh
from femors_addon.volume_morph import kept_valid, morph_volume
from femors_addon.volume_quality import scaled_jacobians
from femors_addon.volume_shapes import reshaped


def plate(cells: tuple[int, int, int] = (14, 10, 3)) -> VolumeMesh:
    """A curved plate of hexes with sharp rims, about 28 x 20 x 3 in size and without symmetry."""
    nx, ny, nz = (c + 1 for c in cells)
    number = np.arange(nx * ny * nz).reshape(nx, ny, nz)
    x, y, z = np.meshgrid(*(np.linspace(-1, 1, n) for n in (nx, ny, nz)), indexing="ij")
    nodes = np.column_stack([(14 * x + 2 * y).ravel(), (10 * y).ravel(), (1.5 * z).ravel()])
    nodes[:, 2] += 0.02 * nodes[:, 0] ** 2 - 0.015 * nodes[:, 1] ** 2 + 0.05 * nodes[:, 0]
    low = number[:-1, :-1, :-1], number[1:, :-1, :-1], number[1:, 1:, :-1], number[:-1, 1:, :-1]
    high = number[:-1, :-1, 1:], number[1:, :-1, 1:], number[1:, 1:, 1:], number[:-1, 1:, 1:]
    hexes = np.column_stack([corner.ravel() for corner in (*low, *high)])
    return VolumeMesh(nodes, (Block("hex8", hexes, np.arange(len(hexes)) + 1),), np.arange(len(nodes)) + 1)


def warp(nodes: np.ndarray) -> np.ndarray:
    """A smooth map that moves nodes by up to 3."""
    x, y, _ = nodes.T
    return nodes + np.column_stack([1.5 * np.sin(y / 8), 2 * np.cos(x / 12), 1.5 * np.sin(x / 9 + y / 11)])


def test_a_known_warp_comes_back_inside_and_out():
    mesh = plate()
    truth = warp(mesh.nodes)
    surface, at = mesh.surface()
    result = morph_volume(mesh, Surface(truth[at], surface.faces))
    assert not len(result.inverted_new)
    error = np.linalg.norm(result.nodes - truth, axis=1)
    assert np.median(error) < 0.1 * surface.mean_edge
    own = scaled_jacobians(mesh.moved(truth)).min()
    assert scaled_jacobians(mesh.moved(result.nodes)).min() > 0.8 * own
    assert result.after.volume == pytest.approx(
        float(np.sum(np.abs(Surface(truth[at], surface.faces).volume))), rel=0.01
    )


def test_the_harmonic_interior_reproduces_a_translation():
    mesh = plate()
    inside = np.ones(len(mesh.nodes), dtype=bool)
    inside[mesh.surface()[1]] = False
    step = np.array([1.0, -2.0, 3.0])
    start = np.where(inside[:, None], 0.0, step)
    assert inside.sum() > 100
    found = harmonic(stiffness(mesh), start, inside)
    assert found == pytest.approx(np.tile(step, (len(inside), 1)), abs=1e-4)
    assert np.array_equal(found[~inside], start[~inside])


@pytest.mark.parametrize("size", [0.3, 3.0, 300.0])
def test_no_goal_inverts_a_valid_element(size):
    mesh = plate((6, 5, 2))
    rng = np.random.default_rng(1)
    goal = mesh.nodes + size * rng.normal(size=mesh.nodes.shape)
    valid = scaled_jacobians(mesh) > 0
    nodes, held, by = kept_valid(mesh, goal, valid)
    assert (scaled_jacobians(mesh.moved(nodes))[valid] > 0).all()
    free = np.setdiff1d(np.arange(len(goal)), held)
    assert np.array_equal(nodes[free], goal[free])
    assert (by > 0) == bool(len(held))


def test_a_valid_goal_is_taken_as_it_is():
    mesh = plate((6, 5, 2))
    goal = warp(mesh.nodes)
    nodes, held, by = kept_valid(mesh, goal, np.ones(mesh.element_count, bool))
    assert np.array_equal(nodes, goal) and not len(held) and by == 0


def test_elements_inverted_on_input_are_left_alone_and_named():
    mesh = plate((6, 5, 2))
    nodes = mesh.nodes.copy()
    inner = np.setdiff1d(np.arange(len(nodes)), mesh.surface()[1])
    nodes[inner[0]] += [0, 0, 40.0]
    broken = mesh.moved(nodes)
    bad = scaled_jacobians(broken) <= 0
    assert bad.any()
    surface, at = broken.surface()
    result = morph_volume(broken, Surface(warp(nodes)[at], surface.faces))
    assert np.array_equal(result.inverted_input, broken.element_ids[bad])
    assert not len(result.inverted_new)
    told = result.report()["volume"]
    assert told["before"]["inverted"] == told["after"]["inverted"] == bad.sum()  # as the summary has it
    assert ["inverted", "elements", str(bad.sum()), str(bad.sum())] in [
        line.split() for line in result.summary().splitlines()
    ]


def test_an_inverted_element_that_becomes_valid_is_not_counted_afterwards():
    mesh = plate((6, 5, 2))
    nodes = mesh.nodes.copy()
    inner = np.setdiff1d(np.arange(len(nodes)), mesh.surface()[1])
    nodes[inner[0]] += [0, 0, 1.6]  # just out of its plate, which the target makes thicker
    broken = mesh.moved(nodes)
    bad = int((scaled_jacobians(broken) <= 0).sum())
    surface, at = broken.surface()
    result = morph_volume(broken, Surface(warp(nodes * [1, 1, 1.5])[at], surface.faces))
    left = int((scaled_jacobians(broken.moved(result.nodes)) <= 0).sum())
    assert bad > left == result.inverted
    told = result.report()["volume"]
    assert (told["before"]["inverted"], told["after"]["inverted"]) == (bad, left)
    assert len(told["inverted_on_input"]) == bad
    said = result.summary().splitlines()
    assert ["inverted", "elements", str(bad), str(left)] in [line.split() for line in said]
    were = "element that was" if bad == 1 else "elements that were"
    assert f"these scaled Jacobians leave out the {bad} {were} inverted before" in said


def test_reshaping_lifts_the_worst_element():
    mesh = plate()
    _, at = mesh.surface()
    jacobian = scaled_jacobians(mesh)
    inner = np.setdiff1d(np.arange(len(mesh.nodes)), at)
    spoilt = mesh.nodes.copy()
    spoilt[inner[40]] += [0.6, 0.5, 0.3]
    before = scaled_jacobians(mesh.moved(spoilt)).min()
    nodes = reshaped(mesh, spoilt, at, jacobian, None, lambda fraction, text: None)
    assert scaled_jacobians(mesh.moved(nodes)).min() > max(0.85 * jacobian.min(), before)
    assert np.array_equal(nodes[at], spoilt[at])


def test_mid_side_nodes_stay_on_their_edges():
    corners = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4], [4, 4, 4]], float)
    tets = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
    pairs = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
    edges = sorted({tuple(sorted((int(t[a]), int(t[b])))) for t in tets for a, b in pairs})
    nodes = np.vstack([corners, [corners[list(edge)].mean(axis=0) for edge in edges]])
    number = {edge: 5 + i for i, edge in enumerate(edges)}
    full = [[*t, *(number[tuple(sorted((int(t[a]), int(t[b]))))] for a, b in pairs)] for t in tets]
    mesh = VolumeMesh(nodes, (Block("tet10", full, [1, 2]),), np.arange(len(nodes)) + 1)
    goal = nodes + np.random.default_rng(0).normal(size=nodes.shape) * 0.2
    moved, _, _ = kept_valid(mesh, goal, scaled_jacobians(mesh) > 0)
    for edge, mid in number.items():
        assert moved[mid] == pytest.approx(moved[list(edge)].mean(axis=0), abs=1e-12)


def test_bad_input_is_one_line():
    mesh = plate((6, 5, 2))
    surface, at = mesh.surface()
    shell = VolumeMesh(mesh.nodes, (Block("quad4", [[0, 1, 2, 3]], [1]),), mesh.node_ids)
    with pytest.raises(FemorsError, match="no solid elements"):
        morph_volume(shell, surface)
    mirrored = Surface(warp(mesh.nodes)[at] * [-1, 1, 1], surface.faces)
    assert any("mirror image" in warning for warning in morph_volume(mesh, mirrored).surface.warnings)
    with pytest.raises(FemorsError, match="inside out"):
        morph_volume(mesh, mirrored, MorphSettings(fix_mirror=True))


def test_cancel_at_any_word():
    mesh = plate((6, 5, 2))
    surface, at = mesh.surface()
    target = Surface(warp(mesh.nodes)[at], surface.faces)
    texts: list[str] = []
    morph_volume(mesh, target, progress=lambda fraction, text: texts.append(text))
    assert any(text.startswith("volume") for text in texts)
    for stop in (0, len(texts) // 2, len(texts) - 2):
        seen = 0

        def progress(fraction: float, text: str, stop: int = stop) -> None:
            nonlocal seen
            seen += 1
            if seen > stop:
                raise Cancelled

        with pytest.raises(Cancelled):
            morph_volume(mesh, target, progress=progress)


# --- real decks -------------------------------------------------------------------------------------
def known_warp(kind: str, centre: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """A smooth warp of 5 to 6 mm an axis, or an affine stretch of 20 %."""
    x, y, z = (nodes - centre).T
    if kind == "stretch":
        return centre + np.column_stack([1.2 * x, y, z])
    return nodes + np.column_stack([6 * np.sin(y / 25 + 0.5), 5 * np.cos(z / 30), 6 * np.sin(x / 28)])


@pytest.mark.parametrize("kind", ["smooth", "stretch"])
@pytest.mark.parametrize("name", ["cartilage_femur_hex", "cartilage_femur_tet"])
def test_knee_cartilage_follows_a_known_warp(name, kind):
    path = DATA / "knee" / f"{name}.inp"
    if not path.exists():
        pytest.skip(f"{path} is not there")
    inp = pytest.importorskip("femors_addon.inp")
    mesh = inp.read(path).mesh
    surface, at = mesh.surface()
    truth = known_warp(kind, mesh.nodes.mean(axis=0), mesh.nodes)
    target = Surface(truth[at], surface.faces)
    result = morph_volume(mesh, target)
    valid = scaled_jacobians(mesh) > 0
    assert np.percentile(SurfaceIndex(target).closest(result.nodes[at]).distance, 99) < 0.1
    assert not len(result.inverted_new)
    own = scaled_jacobians(mesh.moved(truth))[valid].min()
    assert scaled_jacobians(mesh.moved(result.nodes))[valid].min() >= 0.8 * own
    assert result.surface.converged


def test_nodes_of_no_weight_stay_and_the_figures_are_of_the_end():
    mesh = plate()
    surface, at = mesh.surface()
    target = Surface(warp(mesh.nodes)[at], surface.faces)
    weights = (mesh.nodes[:, 0] > 0).astype(float)
    result = morph_volume(mesh, target, MorphSettings(alignment="none"), weights=weights)
    assert np.array_equal(result.nodes[weights == 0], mesh.nodes[weights == 0])
    assert np.abs(result.nodes[weights == 1] - mesh.nodes[weights == 1]).max() > 1.0
    whole = morph_volume(mesh, target)
    distance = SurfaceIndex(target).closest(whole.nodes[at]).distance
    assert whole.surface.surface_distance == pytest.approx(distance, abs=1e-9)
    assert np.array_equal(whole.surface.vertices, whole.nodes[at])
    # elements that hold nodes back leave the target's corners uncovered: the field's residual says so
    moved = surface.moved(whole.nodes[at])
    uncovered = SurfaceIndex(moved).closest(target.vertices).distance
    assert whole.surface.residual.max() >= 0.99 * uncovered.max() > 0.0
    assert f"{whole.surface.after.target_to_surface.p99:.3g}" in whole.surface.stop_reason
    with pytest.raises(FemorsError, match="one for each node"):
        morph_volume(mesh, target, weights=weights[:5])


def bent_tet10() -> VolumeMesh:
    """A plate of quadratic tetrahedra whose mid-side nodes stand up to 0.2 off their edges."""
    mesh = plate((6, 4, 2))
    corners = [[0, 1, 3, 4], [1, 2, 3, 6], [1, 3, 4, 6], [4, 5, 6, 1], [4, 6, 7, 3]]
    tets = np.vstack([mesh.blocks[0].nodes[:, corner] for corner in corners])
    a, b, c, d = np.moveaxis(mesh.nodes[tets], 1, 0)
    wrong = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    tets[wrong] = tets[wrong][:, [0, 2, 1, 3]]
    rng, nodes, number, full = np.random.default_rng(0), list(mesh.nodes), {}, []
    for tet in tets.tolist():
        row = list(tet)
        for i, j in PAIRS:
            edge = tuple(sorted((tet[i], tet[j])))
            if edge not in number:
                number[edge] = len(nodes)
                nodes.append(mesh.nodes[list(edge)].mean(axis=0) + rng.uniform(-0.2, 0.2, 3))
            row.append(number[edge])
        full.append(row)
    block = Block("tet10", full, np.arange(len(full)) + 1)
    return VolumeMesh(np.array(nodes), (block,), np.arange(len(nodes)) + 1)


PAIRS = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))


def gauss_determinants(mesh: VolumeMesh) -> np.ndarray:
    """Smallest determinant at the four Gauss points, from the shape functions written out."""
    positions, near, far = mesh.nodes[mesh.blocks[0].nodes], 0.58541020, 0.13819660
    worst = np.full(len(positions), np.inf)
    for point in range(4):
        share = np.where(np.arange(4) == point, near, far)
        slope = np.zeros((10, 4))
        slope[range(4), range(4)] = 4 * share - 1
        for row, (i, j) in enumerate(PAIRS):
            slope[4 + row, i], slope[4 + row, j] = 4 * share[j], 4 * share[i]
        jacobian = np.einsum("ekc,kl->ecl", positions, slope)
        worst = np.minimum(worst, np.linalg.det(jacobian[:, :, 1:] - jacobian[:, :, :1]))
    return worst


@pytest.mark.parametrize("thin", [0.3, 0.5])
def test_no_quadratic_element_is_inverted_where_it_is_integrated(thin):
    mesh = bent_tet10()
    surface, _ = mesh.surface()
    target = Surface(surface.vertices * [1, 1, thin], surface.faces)
    valid = scaled_jacobians(mesh) > 0
    assert (gauss_determinants(mesh)[valid] > 0).all() and valid.mean() > 0.9
    result = morph_volume(mesh, target, MorphSettings(alignment="none"))
    assert (gauss_determinants(mesh.moved(result.nodes))[valid] > 0).all()
    assert not len(result.inverted_new)
