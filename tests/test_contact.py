# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of overclosure removal against theory: gaps, places on edges, the field, the way apart."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from solids import box, gaps, hexes, moved, sphere

from femors_addon.bodies import Body, Solid, shares
from femors_addon.contact import Pair
from femors_addon.contact_field import ContactField, representatives
from femors_addon.cutouts import Region
from femors_addon.intersect import piercings
from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.overclosure_figures import figures_of
from femors_addon.separation import thickness, way_apart
from femors_addon.sides import Contacts


def solids(by=(17.0, 1.0, 2.0)) -> tuple[Solid, Solid]:
    return Solid(Body("one", sphere()), 0.5), Solid(Body("two", moved(sphere(), by)), 0.5)


# --- gaps ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("least", [np.inf, 0.1])
def test_lazy_gaps_equal_brute_force_while_bodies_move_and_shift(least):
    """Nodes are measured again only where their bound allows: what is below the reach is always exact.

    Of nodes that were never too near, what is below `least`.
    """
    one, two = solids()
    pair, random, reach = Pair(one, two, 0.0), np.random.default_rng(1), 0.6
    for number in range(12):
        pair.look(reach, least)
        pair.contacts(0.05, strict=True)
        for side, shift in zip(pair.sides, (pair.offset, -pair.offset), strict=True):
            true = SurfaceIndex(side.other.surface).signed(side.body.vertices + shift)
            low = true < np.where(side.ever, reach, min(least, reach))
            assert low.any()
            assert side.found.gaps[low] == pytest.approx(true[low], abs=1e-9)
            assert (side.found.gaps[~low] >= min(least, reach) - 1e-9).all()
            assert (side.bound <= true + 1e-9).all()
        steps = {}
        for solid in (one, two):
            wave = 1.0 + np.sin(solid.rest @ random.normal(size=3) / 5.0)  # smooth: the surface stays whole
            step = 0.15 * random.normal(size=3) * wave[:, None]
            before = solid.vertices
            solid.move(np.arange(len(step)), step)
            distance = np.linalg.norm(solid.vertices - before, axis=1)
            steps[solid.name] = (distance, float(distance.max()))
        pair.moved(steps)
        pair.catch_up()
        if number == 5:
            pair.shifted(np.array([0.4, -0.2, 0.1]))


def test_what_was_noted_in_any_order_lowers_bounds_in_one():
    """Pairs that move side by side let a third know when they are done, and no bit may tell."""
    random, bounds = np.random.default_rng(3), []
    steps = []
    for number in range(6):
        name = ("one", "two")[number % 2]
        distance = random.uniform(0.0, 10.0 ** -random.integers(0, 9), len(solids()[number % 2].vertices))
        steps.append({name: (distance, float(distance.max()))})
    for order in (range(6), (3, 1, 5, 0, 2, 4), range(5, -1, -1)):
        pair = Pair(*solids(), 0.0)
        pair.look(5.0)
        for number in order:
            pair.moved(steps[number], number)
            pair.moved({"third": steps[0].get("one", (0.0, 1.0))}, number)
        pair.catch_up()
        pair.catch_up()  # once is enough
        bounds.append(np.concatenate([side.bound for side in pair.sides]))
    np.testing.assert_array_equal(bounds[1], bounds[0])
    np.testing.assert_array_equal(bounds[2], bounds[0])


def test_ways_lead_out():
    one, two = solids()
    pair = Pair(one, two, 0.0)
    pair.look(0.1)
    contacts = pair.contacts(0.0, strict=True)
    inside = contacts.gaps < 0
    assert np.linalg.norm(contacts.ways, axis=1) == pytest.approx(1.0)
    # the first body comes free against the second along x, mostly, and backwards
    assert (contacts.ways[inside, 0] < -0.5).all()
    side = pair.sides[0]
    rows = np.flatnonzero(side.found.gaps < 0)
    out = one.vertices[rows] - side.found.gaps[rows, None] * side.found.ways[rows]
    assert SurfaceIndex(two.surface).closest(out).distance == pytest.approx(0.0, abs=1e-9)


def test_edges_that_pierce_are_found_where_they_are_inside():
    one, two = Solid(Body("one", box(2, 10.0)), 0.5), Solid(Body("two", box(2, 10.0, (8.0, 8.0, 1.0))), 0.5)
    pair = Pair(one, two, 0.0)
    pair.look(1.0)
    count = pair.pierce()
    assert count == sum(
        len(np.unique(piercings(a.surface, b.surface).edge)) for a, b in ((one, two), (two, one))
    )
    for side in pair.sides:
        places = side.between(side.body.vertices)
        assert len(places)
        index = SurfaceIndex(side.other.surface)
        assert side.on_edges.gaps == pytest.approx(index.signed(places), abs=1e-9)
        assert (side.on_edges.gaps < 0).any()


@pytest.mark.parametrize("elsewhere", [False, True], ids=["nowhere", "elsewhere"])
def test_an_edge_far_from_any_node_that_is_looked_at_is_measured_where_it_is(elsewhere):
    """A ridge with its ends clear of a curved plate dips into it; nodes are near elsewhere, or nowhere."""
    beam = Rotation.from_euler("x", 45.0, degrees=True).apply(box(1, 2.0).vertices * [5.0, 1.0, 1.0])
    ridge = Surface(beam - [0.0, 0.0, 2**0.5 + 1.0], box(1, 2.0).faces)  # up to z = -1
    knob = moved(sphere(2, 1.0), (18.0, 0.0, 1.2))
    if elsewhere:
        faces = np.concatenate((ridge.faces, knob.faces + len(ridge.vertices)))
        ridge = Surface(np.concatenate((ridge.vertices, knob.vertices)), faces)
    plate = hexes((40, 4, 2), (40, 4, 2), bend=-0.01, centre=(0.0, 0.0, -0.1)).surface()[0]
    one, two = Solid(Body("ridge", ridge), 0.5), Solid(Body("plate", plate), 0.5)
    pair = Pair(one, two, 0.01)
    for _ in range(2):  # the second look is at those nodes alone that may be too near
        pair.look(0.5, 0.01)
    count = pair.pierce()
    assert count == sum(
        len(np.unique(piercings(a.surface, b.surface).edge)) for a, b in ((one, two), (two, one))
    )
    for number in range(3):
        if number:  # the places are followed while bodies move, with no node near them
            two.move(np.arange(len(two.points)), np.full((len(two.points), 3), [0.0, 0.0, -0.3]))
            pair.moved({"plate": (np.full(len(two.vertices), 0.3), 0.3)})
            pair.catch_up()
            pair.look(0.5, 0.01)
        places = [side.between(side.body.vertices) for side in pair.sides]
        assert len(places[0])
        for side, points in zip(pair.sides, places, strict=True):
            true = SurfaceIndex(side.other.surface).signed(points)
            assert side.on_edges.gaps == pytest.approx(true, abs=1e-9)
    assert pair.sides[0].on_edges.gaps.min() == pytest.approx(-0.7, abs=0.02)


def slab_or_ball(number: int) -> Surface:
    return (hexes((12, 4, 2), (20, 4, 1.5), bend=0.01).surface()[0], sphere(2, 4.0), box(1, 3.0))[number % 3]


@pytest.mark.parametrize("seed", range(1, 24))
def test_places_on_edges_equal_brute_force_while_bodies_move(seed):
    """A coarse body in any pose, in a finer one, tiny to huge; the reach is short beside its edges."""
    random = np.random.default_rng(seed)
    scale, reach = 10.0 ** random.choice([-3, 0, 3]), (0.05 if seed % 3 else 0.5)
    block = (
        box(1 + seed % 2, 2.0).vertices
        * random.uniform(0.3, 6.0, 3)
        @ Rotation.random(random_state=seed).as_matrix()
    )
    block = scale * (block + 2.0 * random.normal(size=3))
    other = slab_or_ball(seed)
    one = Solid(Body("one", Surface(block, box(1 + seed % 2, 2.0).faces)), 0.5)
    two = Solid(Body("two", Surface(scale * other.vertices, other.faces)), 0.5)
    pair, places = Pair(one, two, 0.01 * scale), 0
    for number in range(4):
        if number:
            step = 0.3 * scale * random.normal(size=3)
            two.move(np.arange(len(two.points)), np.tile(step, (len(two.points), 1)))
            far = float(np.linalg.norm(step))
            pair.moved({"two": (np.full(len(two.vertices), far), far)})
            pair.catch_up()
        for look in (lambda: pair.look(reach * scale, 0.01 * scale), pair.pierce):
            look()
            look()  # again, with what is known
            for side in pair.sides:
                true = gaps(side.between(side.body.vertices), side.other.surface)
                assert side.on_edges.gaps == pytest.approx(true, abs=1e-7 * scale)
                places += len(true)
        assert pair.pierce() == sum(
            len(np.unique(piercings(a.surface, b.surface).edge)) for a, b in ((one, two), (two, one))
        )
    assert places


def test_a_region_has_every_face_that_reaches_into_the_box():
    surface = box(6, 10.0)
    low, high = np.array([3.1, 3.2, -1.0]), np.array([3.3, 9.0, 0.5])  # smaller than a face
    region = Region.of(surface, low, high)
    corners = surface.corners
    true = ((corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)).all(axis=1)
    assert len(region.surface.faces) == true.sum()
    assert np.array_equal(surface.vertices[region.vertex], region.surface.vertices)


# --- the field ----------------------------------------------------------------------------------------
def patch(count: int = 30) -> Contacts:
    """A flat square of contacts whose way out is up."""
    x, y = np.meshgrid(np.linspace(-10, 10, count), np.linspace(-10, 10, count))
    points = np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size)))
    return Contacts(points, np.tile([0.0, 0.0, 1.0], (x.size, 1)), np.zeros(x.size), np.zeros(x.size))


def test_the_field_does_what_is_asked_in_the_patch_and_nothing_far_away():
    contacts, spread = patch(), 2.0
    field = ContactField.fitted(contacts, np.full(len(contacts.points), 0.7), spread)
    middle = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 0.5], [30.0, 0.0, 0.0], [0.0, 0.0, 3.0 * spread]])
    rows, step = field(middle)
    assert rows.tolist() == [0, 1]
    assert step[0] == pytest.approx([0.0, 0.0, 0.7], abs=0.02)
    rows, step = field(np.column_stack((np.linspace(0, 20, 400), np.zeros(400), np.zeros(400))))
    size = step[:, 2]
    assert (np.abs(np.diff(size)) < 0.04).all()  # no jump where it fades out
    assert size[-1] < 0.01
    assert size.max() < 0.85


def test_at_least_what_is_asked_and_no_pull():
    contacts = patch(20)
    asked = np.where(np.abs(contacts.points[:, 0]) < 2, 0.5, -0.3)
    field = ContactField.fitted(contacts, asked, 1.5, np.zeros(len(asked)), rounds=60)
    rows, step = field(contacts.points)
    assert np.isin(np.flatnonzero(asked > 0), rows).all()
    assert (step[asked[rows] > 0, 2] > 0.98 * 0.5).all()
    assert (field.vectors @ [0.0, 0.0, 1.0] >= 0).all()


def test_the_deepest_of_each_cell_stands_for_it():
    random = np.random.default_rng(0)
    points, asked = random.random((500, 3)), random.random(500)
    rows = representatives(points, asked, 0.25)
    cells = np.floor((points - points.min(axis=0)) / 0.25).astype(int)
    for cell in np.unique(cells, axis=0):
        mine = np.flatnonzero((cells == cell).all(axis=1))
        assert mine[np.argmax(asked[mine])] in rows
    assert len(rows) == len(np.unique(cells, axis=0))


# --- the way apart ------------------------------------------------------------------------------------
def test_the_thickness_of_a_plate():
    assert thickness(hexes((10, 10, 2), (40, 40, 2)).surface()[0]) == pytest.approx(2.0, rel=0.1)


def test_thick_bodies_need_no_parting_and_plates_through_each_other_do():
    one, two = solids((18.0, 1.0, 0.0))
    pair = Pair(one, two, 0.0)
    pair.look(0.5)
    assert way_apart(pair) is None
    plates = [
        Solid(Body("low", hexes((12, 12, 3), (20, 20, 2))), 0.5),
        Solid(Body("high", hexes((11, 11, 3), (20, 20, 2), centre=(0.7, 0.5, 0.6))), 0.5),
    ]
    pair = Pair(plates[0], plates[1], 0.0)
    pair.look(0.5)
    way = way_apart(pair)
    assert way is not None
    assert way[2] < 0  # the first one is below
    assert np.linalg.norm(way) == pytest.approx(1.4, abs=0.3)
    pair.shifted(1.1 * way)
    pair.look(0.5)
    assert pair.deepest(strict=True) > 0


# --- bodies -------------------------------------------------------------------------------------------
def test_shares():
    body = [Body("a", sphere(1)), Body("b", sphere(1)), Body("c", sphere(1), 0.1)]
    assert shares(body[:2]) == [0.5, 0.5]
    assert shares(body[1:]) == [0.9, 0.1]
    assert shares(body) == [0.5, 0.5, 0.1]


def test_no_step_inverts_an_element_and_those_that_can_go_all_the_way():
    mesh = hexes((6, 6, 3), (12, 12, 3))
    solid = Solid(Body("plate", mesh), 1.0)
    top = np.flatnonzero(mesh.nodes[:, 2] > 1.4)
    middle = top[np.linalg.norm(mesh.nodes[top, :2], axis=1) < 2.5]
    step = np.tile([0.0, 0.0, -4.0], (len(middle), 1))  # right through the plate
    solid.move(middle, step)
    assert not len(solid.inverted())
    assert solid.held
    went = mesh.nodes[middle, 2] - solid.points[middle, 2]
    assert (went > 0.3).all()
    other = Solid(Body("plate", mesh), 1.0)
    other.move(middle, 0.1 * step)
    assert np.array_equal(other.points[middle], mesh.nodes[middle] + 0.1 * step)
    assert not other.held


def test_an_element_that_was_inverted_and_is_repaired_counts_as_valid_afterwards():
    mesh = hexes((3, 3, 1), (9, 9, 3))
    nodes = np.array(mesh.nodes)
    nodes[0, 2] += 7.0  # a lower corner, out at the top
    solid = Solid(Body("plate", mesh.moved(nodes)), 1.0)
    assert len(solid.inverted()) == len(solid.inverted_input) > 0
    solid.move(np.array([0]), np.array([[0.0, 0.0, -7.0]]))
    report = figures_of(solid, []).report()
    told = [report["scaled_jacobian"][state]["inverted"] for state in ("before", "after")]
    assert told == [len(report["inverted_on_input"]), 0] and not report["newly_inverted"]


def test_vertices_at_one_place_move_as_one():
    shape = sphere(2)
    soup = Surface(shape.corners.reshape(-1, 3), np.arange(3 * len(shape.faces)).reshape(-1, 3))
    solid = Solid(Body("soup", soup), 1.0)
    assert len(solid.points) == len(shape.vertices)
    solid.move(np.array([5]), np.array([[0.1, 0.0, 0.0]]))
    changed = (solid.nodes != soup.vertices).any(axis=1)
    assert 5 <= changed.sum() <= 6
    assert len(np.unique(solid.nodes[changed], axis=0)) == 1
