# SPDX-License-Identifier: GPL-3.0-or-later
"""Overclosure removal: what is certified is true, what cannot be done is said, and nothing else moves."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from solids import box, gaps, hexes, moved, sphere
from spheres import GAP, TILT, assert_apart, pair, plates, smallest_gap, surface_of

from femors_addon.bodies import Body
from femors_addon.elements import KINDS
from femors_addon.intersect import crossings
from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.overclosure import OverclosureSettings, check_overclosure, remove_overclosure
from femors_addon.progress import FemorsError
from femors_addon.volume import Block, VolumeMesh


@pytest.mark.parametrize("depth", [0.01, 0.1, 1.0, 3.0, 8.0])
def test_spheres_come_apart_to_the_gap(depth):
    result = remove_overclosure(pair((20.0 - depth, 0.3, 0.2)), OverclosureSettings(gap=GAP))
    assert_apart(result)
    assert result.before[0].depth == pytest.approx(depth, abs=0.12)  # the spheres are of flat faces


def test_contact_is_close_afterwards():
    """What overlapped ends near the gap, not somewhere far from it."""
    result = remove_overclosure(pair(), OverclosureSettings(gap=GAP))
    for body in result.bodies:
        assert body.settled is not None
        assert body.settled.p01 >= GAP - 1e-5
        assert body.settled.median < GAP + 0.1  # of 2.85


def test_nothing_moves_away_from_contact():
    result = remove_overclosure(pair(), OverclosureSettings(gap=GAP))
    for before, after in zip(pair(), result.bodies, strict=True):
        same = (after.nodes == before.nodes).all(axis=1)
        other = next(b for b in pair() if b.name != before.name)
        inside = SurfaceIndex(other.mesh).signed(before.nodes) < GAP
        away = np.linalg.norm(before.nodes[:, None] - before.nodes[inside][None], axis=2).min(axis=1)
        assert same[away > 3.0 * result.spread].all()
        assert (away > 3.0 * result.spread).sum() > 100
        assert not same[inside].any()


@pytest.mark.parametrize("alpha", [0.0, 0.2, 0.5, 1.0])
def test_each_body_takes_its_share(alpha):
    result = remove_overclosure(pair(one=alpha), OverclosureSettings(gap=GAP))
    assert_apart(result)
    given = pair(one=alpha)
    result = remove_overclosure(given, OverclosureSettings(gap=GAP))
    one, two = result.bodies
    assert (one.share, two.share) == (alpha, 1.0 - alpha)
    total = one.movement.maximum + two.movement.maximum
    assert one.movement.maximum / total == pytest.approx(alpha, abs=0.05)
    if alpha == 0.0:
        assert one.mesh is given[0].mesh
        assert np.array_equal(one.nodes, given[0].nodes)  # not one bit changed


def test_the_order_of_the_bodies_does_not_matter_much():
    forth = remove_overclosure(pair()).bodies
    back = remove_overclosure(pair()[::-1]).bodies[::-1]
    for one, two in zip(forth, back, strict=True):
        assert np.abs(one.nodes - two.nodes).max() < 0.2  # of 1.4 moved


def test_the_same_input_gives_the_same_bits():
    one, two = (remove_overclosure(pair()).bodies for _ in range(2))
    assert all(np.array_equal(a.nodes, b.nodes) for a, b in zip(one, two, strict=True))


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_the_unit_of_length_does_not_matter(unit):
    """Up to rounding and to the tolerance, which is absolute: the paths may part in the last steps."""
    bodies = [Body(b.name, Surface(unit * b.nodes, b.mesh.faces)) for b in pair()]
    result = remove_overclosure(bodies, OverclosureSettings(gap=unit * GAP))
    assert result.certified
    plain = remove_overclosure(pair(), OverclosureSettings(gap=GAP))
    for one, two in zip(result.bodies, plain.bodies, strict=True):
        assert np.abs(one.nodes / unit - two.nodes).max() < 0.02


@pytest.mark.parametrize("gap", [0.0, 0.5, 3.0])
def test_any_gap(gap):
    result = remove_overclosure(pair(), OverclosureSettings(gap=gap))
    assert_apart(result, gap)


def test_far_from_the_origin_the_gap_holds_in_single_precision():
    bodies = [Body(b.name, moved(b.mesh, (900.0, -700.0, 800.0))) for b in pair()]
    assert_apart(remove_overclosure(bodies, OverclosureSettings(gap=GAP)))


@pytest.mark.parametrize("levels", [(2, 5), (5, 2)])
def test_a_coarse_mesh_against_a_fine_one(levels):
    bodies = [Body("one", sphere(levels[0])), Body("two", moved(sphere(levels[1]), TILT))]
    assert_apart(remove_overclosure(bodies, OverclosureSettings(gap=GAP)))


def test_sharp_bodies():
    for by in ((9.5, 3.0, 2.0), (9.0, 9.0, 9.0)):
        bodies = [Body("one", box(8, 10.0)), Body("two", box(7, 10.0, by))]
        assert_apart(remove_overclosure(bodies, OverclosureSettings(gap=GAP)))


def test_coplanar_faces_that_touch_are_parted():
    bodies = [Body("one", box(6, 10.0)), Body("two", box(6, 10.0, (10.0, 0.0, 0.0)))]
    assert check_overclosure(bodies)[0].state == "too near"
    assert_apart(remove_overclosure(bodies, OverclosureSettings(gap=GAP)))


# --- elements -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("depth", [0.1, 0.8])
def test_volumes_come_apart_and_their_elements_stay_valid(depth):
    result = remove_overclosure(plates(depth), OverclosureSettings(gap=GAP))
    assert_apart(result)
    for before, after in zip(plates(depth), result.bodies, strict=True):
        assert after.elements is not None
        assert after.elements[1].minimum > 0.3
        assert not np.array_equal(after.nodes, before.nodes)
        _, on = before.mesh.surface()
        inner = np.setdiff1d(np.arange(len(after.nodes)), on)
        assert (after.nodes[inner] != before.nodes[inner]).any()  # the inside follows


@pytest.mark.parametrize("depth", [1.3, 1.6])
def test_plates_deeper_than_half_their_thickness_do_not_pass_through_each_other(depth):
    """Without parting them first, nodes leave by the far side: this is what the continuation is for."""
    result = remove_overclosure(plates(depth), OverclosureSettings(gap=GAP))
    assert_apart(result)
    low, high = (body.mesh for body in result.bodies)
    # column by column the low plate is below the high one
    for x, y in itertools.product((-6.0, 0.0, 5.0), (-5.0, 0.0, 5.0)):
        column = [np.hypot(m.nodes[:, 0] - x, m.nodes[:, 1] - y) < 1.5 for m in (low, high)]
        assert low.nodes[column[0], 2].max() < high.nodes[column[1], 2].min() + 0.8
        assert low.nodes[column[0], 2].mean() < high.nodes[column[1], 2].mean() - 0.7


def quadratic(mesh: VolumeMesh, bulge: float) -> VolumeMesh:
    """The same hexahedra with mid-side nodes, those on the topmost edges raised by `bulge`."""
    rows = mesh.blocks[0].nodes
    ends = np.sort(np.stack([rows[:, edge] for edge in KINDS["hex20"].edges], axis=1).reshape(-1, 2), axis=1)
    edges, which = np.unique(ends, axis=0, return_inverse=True)
    middle = mesh.nodes[edges].mean(axis=1)
    middle[middle[:, 2] > mesh.nodes[:, 2].max() - 1e-9, 2] += bulge
    rows = np.column_stack((rows, len(mesh.nodes) + which.reshape(len(rows), -1)))
    nodes = np.concatenate((mesh.nodes, middle))
    return VolumeMesh(nodes, (Block("hex20", rows, mesh.blocks[0].ids),), np.arange(len(nodes)) + 1)


@pytest.mark.parametrize(("bulge", "place"), [(0.06, "0.04 away from"), (0.13, "0.03 deep in")])
def test_mid_side_nodes_that_are_nearer_than_the_corners_are_told(bulge, place):
    low, high = hexes((6, 6, 2), (20, 20, 2)), hexes((5, 5, 2), (18, 18, 2), centre=(0.3, 0.2, 2.1))
    told: list[str] = []
    bodies = [Body("low", quadratic(low, bulge)), Body("high", high)]
    (found,) = check_overclosure(bodies, OverclosureSettings(gap=0.09), tell=told.append)
    assert found.clear and found.least == pytest.approx(0.1, abs=1e-5)
    assert told == [
        f"gaps are those of corner nodes: a mid-side node of 'low' is {place} 'high', where 0.09 is asked for"
    ]
    told.clear()
    check_overclosure([Body("low", low), Body("high", high)], OverclosureSettings(gap=0.09), tell=told.append)
    if bulge < 0.1:  # nearer than corners, but no nearer than is asked for
        check_overclosure(bodies, OverclosureSettings(gap=0.03), tell=told.append)
    assert not told


def test_mid_side_nodes_are_told_where_a_removal_has_left_them():
    low, high = quadratic(hexes((6, 6, 2), (20, 20, 2)), 0.01), hexes((5, 5, 2), (18, 18, 2), 0.004)
    high = high.moved(high.nodes + (0.3, 0.2, 1.7))
    result = remove_overclosure([Body("low", low), Body("high", high)], OverclosureSettings(gap=GAP))
    assert result.certified and result.bodies[0].moved
    mine, other = (body.mesh for body in result.bodies)
    middle = gaps(mine.nodes[len(hexes((6, 6, 2), (20, 20, 2)).nodes) :], other.surface()[0]).min()
    (note,) = (note for note in result.notes if "mid-side" in note)
    assert 0 < middle < GAP and f"a mid-side node of 'low' is {middle:.4g} away from 'high'" in note


def test_an_element_inverted_on_input_is_left_and_told():
    bodies = plates(0.5)
    nodes = np.array(bodies[0].mesh.nodes)
    nodes[0] += (6.0, 5.0, 0.0)  # a corner far from contact, through its element
    bodies[0] = Body("low", bodies[0].mesh.moved(nodes))
    result = remove_overclosure(bodies, OverclosureSettings(gap=GAP))
    assert len(result.bodies[0].inverted_input)
    assert not len(result.bodies[0].inverted_new)
    assert any("inverted before" in note for note in result.notes)
    low = result.bodies[0].report()
    counts = [low["scaled_jacobian"][state]["inverted"] for state in ("before", "after")]
    assert counts == [len(low["inverted_on_input"])] * 2


# --- several bodies -----------------------------------------------------------------------------------
def test_three_bodies_at_once():
    bodies = [*pair((18.0, 0.0, 0.0)), Body("three", moved(sphere(), (9.0, 16.0, 0.5)))]
    result = remove_overclosure(bodies, OverclosureSettings(gap=GAP))
    assert len(result.before) == 3
    assert_apart(result)


def test_a_plate_between_two_rigid_bodies_finds_its_room():
    bodies = [
        Body("below", sphere(), 0.0),
        Body("above", sphere(centre=(0.0, 0.0, 25.0)), 0.0),
        Body("plate", hexes((16, 16, 4), (20, 20, 6), centre=(0, 0, 12.5)), 1.0),
    ]
    assert_apart(remove_overclosure(bodies, OverclosureSettings(gap=GAP)))


def test_what_is_pinched_is_told_and_rigid_bodies_stay():
    bodies = [
        Body("below", sphere(), 0.0),
        Body("above", sphere(centre=(0.0, 0.0, 19.9)), 0.0),
        Body("plate", hexes((12, 12, 3), (20, 20, 3), centre=(0, 0, 9.9)), 1.0),
    ]
    result = remove_overclosure(bodies, OverclosureSettings(gap=GAP, iterations=30))
    assert not result.certified
    assert any("both are rigid" in reason for reason in result.reasons)
    assert any("pinched between rigid" in reason for reason in result.reasons)
    assert "NOT CERTIFIED" in result.summary()
    assert not len(result.bodies[2].inverted_new)
    for before, after in zip(bodies[:2], result.bodies[:2], strict=True):
        assert after.mesh is before.mesh


def test_pairs_are_excluded_or_have_gaps_of_their_own():
    free = remove_overclosure(pair(), exclude=[("two", "one")])
    assert free.certified
    assert free.untouched
    found = check_overclosure(pair())[0]
    (spared,) = free.excluded
    assert {spared.one, spared.two} == {"one", "two"}
    assert spared.depth_before == spared.depth_after == found.depth > 0
    assert f"1 excluded pair may overlap, and does by {found.depth:.3g} at most" in free.certificate
    assert not remove_overclosure(pair()).excluded
    wide = remove_overclosure(pair(), gaps={("two", "one"): 0.7})
    assert_apart(wide, 0.7)
    for wrong in ([("one", "other")], [("one", "one")]):
        with pytest.raises(FemorsError):
            remove_overclosure(pair(), exclude=wrong)
    with pytest.raises(FemorsError, match="must be from 0"):
        remove_overclosure(pair(), gaps={("one", "two"): -1.0})


def test_an_excluded_pair_that_others_push_together_is_told():
    """A small ball is tied to a large one; another, rigid, presses on it from above."""
    bodies = [
        Body("bone", sphere(3, 10.0), 0.0),
        Body("tied", sphere(3, 1.0, (0.0, 0.0, 10.9)), 1.0),
        Body("above", sphere(3, 10.0, (0.0, 0.0, 21.3)), 0.0),
    ]
    result = remove_overclosure(bodies, exclude=[("bone", "tied")])
    (spared,) = result.excluded
    assert result.certified and spared.depth_after > 1.05 * spared.depth_before > 0.0
    assert any("bone and tied, an excluded pair, overlap by" in note for note in result.notes)
    assert result.report()["excluded"] == [dataclasses.asdict(spared)]
    without = remove_overclosure([bodies[0], bodies[1]], exclude=[("bone", "tied")])
    assert not any("excluded" in note for note in without.notes)  # nothing has moved


def test_an_excluded_pair_that_only_touches_has_no_depth():
    """Its nodes are inside the other by rounding, at most."""
    bodies = [
        Body("one", box(4, 1.0)),
        Body("two", box(4, 1.0, (0.0, 0.0, 1.0 - 1e-13))),
        Body("beside", box(4, 1.0, (0.9, 0.1, 0.1))),
    ]
    (found,) = check_overclosure(bodies[:2], OverclosureSettings(gap=0.0))
    assert 0.0 < found.depth < 1e-12
    (spared,) = remove_overclosure(bodies, exclude=[("one", "two"), ("two", "one")]).excluded
    assert spared.depth_before == 0.0


# --- what is found ------------------------------------------------------------------------------------
def test_the_check_measures_depth_place_and_shared_volume():
    finding = check_overclosure(pair((17.0, 0.0, 0.0)))[0]
    assert finding.depth == pytest.approx(3.0, abs=0.15)
    cap = 1.5  # the lens of two spheres, two caps of this height
    assert finding.shared == pytest.approx(2 * np.pi * cap**2 * (10 - cap / 3), rel=0.05)  # flat faces
    assert abs(finding.where[1]) < 2 > abs(finding.where[2])
    assert not finding.clear
    assert finding.crossings == len(crossings(sphere(), moved(sphere(), (17.0, 0.0, 0.0))))


def test_the_band_tells_which_pairs_are_near():
    apart = pair((20.4, 0.0, 0.0))
    assert not check_overclosure(apart, OverclosureSettings(band=0.1))
    assert check_overclosure(apart, OverclosureSettings(band=1.0))[0].least == pytest.approx(0.4, abs=0.1)


def test_bodies_that_do_not_overlap_stay_as_they_are():
    bodies = pair((30.0, 0.0, 0.0))
    result = remove_overclosure(bodies)
    assert result.certified
    assert result.untouched
    assert "nothing had to be moved" in result.certificate
    assert all(after.mesh is before.mesh for before, after in zip(bodies, result.bodies, strict=True))


def test_a_body_inside_a_body_is_found_and_left():
    result = remove_overclosure([Body("shell", sphere()), Body("kernel", sphere(2, 3.0))])
    assert result.before[0].state == "contained"
    assert result.before[0].contained == "kernel"
    assert not result.certified
    assert result.untouched
    assert "'kernel' lies inside" in result.reasons[0]


def test_a_ball_that_its_socket_has_closed_in_on_comes_free():
    cup = sphere(3, 9.7), sphere(3, 13.0)
    faces = np.concatenate((cup[0].faces[:, ::-1], cup[1].faces + len(cup[0].vertices)))
    socket = Surface(np.concatenate([s.vertices for s in cup]), faces)
    assert_apart(remove_overclosure([Body("ball", sphere()), Body("socket", socket)]))


# --- the comparators ----------------------------------------------------------------------------------
def test_the_nodal_method_parts_nodes_and_leaves_edges():
    result = remove_overclosure(pair(), OverclosureSettings(gap=GAP, method="nodal"))
    least = smallest_gap(*(surface_of(body.mesh) for body in result.bodies))
    assert least >= GAP - 1e-4
    smooth = remove_overclosure(pair(), OverclosureSettings(gap=GAP))
    assert result.bodies[0].moved < smooth.bodies[0].moved
    # a node is kept out; where it was pressed through a face's middle, that face's edges are not
    sharp = [Body("one", box(2, 10.0)), Body("two", box(2, 10.0, (8.0, 8.0, 1.0)))]
    left = remove_overclosure(sharp, OverclosureSettings(gap=GAP, method="nodal"))
    assert left.after[0].crossings > 0
    assert not left.certified


def test_the_published_loop_makes_headway():
    bodies = pair((19.0, 0.5, 0.5))
    result = remove_overclosure(bodies, OverclosureSettings(gap=GAP, method="published"))
    assert result.history[0].spread == 10.0
    assert result.history[-1].missing < 0.5 * result.history[0].missing
