# SPDX-License-Identifier: GPL-3.0-or-later
"""How near two surfaces are to each other between edges: against theory, and points along all edges."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from solids import box, gaps, moved, sphere

from femors_addon.bodies import Body
from femors_addon.edge_gaps import least_between
from femors_addon.findings import Finding
from femors_addon.mesh import Surface
from femors_addon.overclosure import OverclosureSettings, check_overclosure, remove_overclosure


def beam(shift: float, turn: float) -> Surface:
    """A beam that stands on its edge, from -5 to 5 along x, turned about z and lifted."""
    unit = box(1, 2.0)
    points = Rotation.from_euler("xz", [45.0, turn], degrees=True).apply(unit.vertices * [5.0, 1.0, 1.0])
    return Surface(points + [0.0, 0.0, shift], unit.faces)


def nodes_apart(one: Surface, two: Surface) -> float:
    return float(min(gaps(one.vertices, two).min(), gaps(two.vertices, one).min()))


@pytest.mark.parametrize("turn", [90.0, 40.0])
def test_two_ridges_that_cross_are_as_near_as_they_are(turn):
    apart = 0.05
    low, high = beam(0.0, 0.0), beam(8**0.5 + apart, turn)
    assert nodes_apart(low, high) > 4 * apart
    assert least_between(low, high, nodes_apart(low, high)) == pytest.approx(apart, abs=1e-9)


def test_where_no_edges_are_nearer_the_nodes_have_it():
    low, high = beam(0.0, 0.0), beam(8**0.5 + 0.05, 0.0)  # edges along each other
    assert least_between(low, high, 0.05) == 0.05


@pytest.mark.parametrize("seed", range(6))
def test_no_two_points_of_edges_are_nearer(seed):
    rng = np.random.default_rng(seed)
    one = sphere(1)
    turned = Rotation.random(random_state=seed).apply(one.vertices) * rng.uniform(0.5, 1.5)
    way = rng.normal(size=3)
    way *= (np.linalg.norm(turned, axis=1).max() + 10.3) / np.linalg.norm(way)
    two = Surface(turned + way, one.faces)
    at = np.linspace(0.0, 1.0, 61)[:, None]
    near = [np.concatenate([a + at * (b - a) for a, b in each.vertices[each.edges]]) for each in (one, two)]
    sampled = min(np.linalg.norm(near[1] - point, axis=1).min() for point in near[0])
    nodes = nodes_apart(one, two)
    found = least_between(one, two, nodes)
    assert found <= sampled
    assert found == pytest.approx(min(sampled, nodes), rel=0.02)


@pytest.mark.parametrize("turn", [90.0, 40.0])
def test_ridges_that_cross_are_told_as_deep_as_their_edges(turn):
    """No node is inside; the middle of what a ridge of each cuts out is at the height h under the other's.

    From there it is h / sqrt(2) to the slopes of 45 degrees, whatever the turn.
    """
    deep = 0.3
    low, high = Body("low", beam(0.0, 0.0)), Body("high", beam(8**0.5 - deep, turn))
    (found,) = check_overclosure([low, high], OverclosureSettings(gap=0.0))
    assert found.state == "overlap" and found.depth == 0.0
    assert found.edge_depth == pytest.approx(deep / 2**0.5, abs=1e-6)
    assert ": overlap, 0.2121 deep on edges, " in str(found)


def test_edges_that_are_less_deep_than_nodes_go_without_a_word():
    (found,) = check_overclosure([Body("a", sphere(3)), Body("b", moved(sphere(2), (19.0, 0.3, 0.2)))])
    assert 0.04 < found.edge_depth < found.depth
    assert f": overlap, {found.depth:.4g} deep, " in str(found)


@pytest.mark.parametrize(("edge", "words"), [(0.3, "0.1 deep at nodes, 0.3 on edges"), (0.1005, "0.1 deep")])
def test_edges_that_are_deeper_than_nodes_are_told_beside_them(edge, words):
    place = (0.0, 0.0, 0.0)
    found = Finding("a", "b", 0.0, -0.1, (1, 0), 1, "", place, None, "overlap", edge_depth=edge)
    assert found.deep == words and f": overlap, {words}, 1 node closer" in str(found)


def test_the_deepest_pair_comes_first_by_nodes_or_where_there_are_none_by_edges():
    low, high = Body("low", beam(0.0, 0.0)), Body("high", beam(8**0.5 - 1.0, 90.0))
    balls = [Body(f"ball{n}", moved(sphere(2), (100.0 + 19.6 * n, 0.3, 0.2))) for n in range(2)]
    found = check_overclosure([*balls, low, high])
    assert [finding.one for finding in found] == ["low", "ball0"]
    assert found[0].depth == 0.0 and found[0].edge_depth > found[1].depth > 0.0


def test_a_certificate_says_how_near_edges_come_beside_the_gap_of_nodes():
    low, high = Body("low", beam(0.0, 0.0)), Body("high", beam(8**0.5 + 0.05, 90.0))
    (found,) = check_overclosure([low, high], OverclosureSettings(gap=0.2, band=20.0))
    assert found.clear and found.least > 0.2
    assert found.surfaces_apart == pytest.approx(0.05, abs=1e-6)
    assert str(found).endswith("apart at nodes, 0.05 between edges")
    result = remove_overclosure([low, high], OverclosureSettings(gap=0.2, band=20.0))
    assert result.certified and result.untouched
    assert f"gap of a node to a surface is {found.least:.5g}, of two edges 0.05;" in result.certificate
    assert result.report()["pairs"]["after"][0]["surfaces_apart"] == found.surfaces_apart
