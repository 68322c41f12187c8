# SPDX-License-Identifier: GPL-3.0-or-later
"""Overclosure removal: what is certified is true, what cannot be done is said, and nothing else moves."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from solids import box, crosses, gaps, hexes, moved, sphere

from femors_addon import shapes
from femors_addon.bodies import Body
from femors_addon.intersect import crossings
from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.overclosure import OverclosureSettings, check_overclosure, remove_overclosure
from femors_addon.progress import Cancelled, FemorsError
from femors_addon.volume_quality import scaled_jacobians

GAP = 0.01
TILT = (17.0, 1.0, 2.0)  # of a second sphere: 2.85 deep, and no symmetry


def pair(by=TILT, **shares) -> list[Body]:
    """Two spheres of radius 10."""
    return [
        Body("one", sphere(), shares.get("one")),
        Body("two", moved(sphere(), by), shares.get("two")),
    ]


def surface_of(mesh) -> Surface:
    return mesh if isinstance(mesh, Surface) else mesh.surface()[0]


def smallest_gap(a: Surface, b: Surface) -> float:
    """By brute force, without the code that gave the certificate; see `solids.gaps`."""
    return float(min(gaps(a.vertices, b).min(), gaps(b.vertices, a).min()))


def assert_apart(result, gap: float = GAP) -> None:
    """Check the certificate by other means than the code that gave it, in double and single precision."""
    assert result.certified, result.reasons
    meshes = [surface_of(body.mesh) for body in result.bodies]
    for a, b in itertools.combinations(meshes, 2):
        for kind in (np.float64, np.float32):
            one, two = (Surface(s.vertices.astype(kind).astype(np.float64), s.faces) for s in (a, b))
            assert smallest_gap(one, two) >= gap - 1e-5
            assert not crosses(one, two)
    for body in result.bodies:
        if not isinstance(body.mesh, Surface):
            assert scaled_jacobians(body.mesh).min() > 0


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
def plates(depth: float, thick: float = 2.0) -> list[Body]:
    """Two bent plates of hexahedra, 24 x 20, one on the other."""
    return [
        Body("low", hexes((20, 16, 4), (24, 20, thick), 0.01)),
        Body("high", hexes((19, 17, 4), (24, 20, thick), 0.012, centre=(1.0, 0.5, thick - depth))),
    ]


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


def test_an_element_inverted_on_input_is_left_and_told():
    bodies = plates(0.5)
    nodes = np.array(bodies[0].mesh.nodes)
    nodes[0] += (6.0, 5.0, 0.0)  # a corner far from contact, through its element
    bodies[0] = Body("low", bodies[0].mesh.moved(nodes))
    result = remove_overclosure(bodies, OverclosureSettings(gap=GAP))
    assert len(result.bodies[0].inverted_input)
    assert not len(result.bodies[0].inverted_new)
    assert any("inverted before" in note for note in result.notes)


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
    wide = remove_overclosure(pair(), gaps={("two", "one"): 0.7})
    assert_apart(wide, 0.7)
    for wrong in ([("one", "other")], [("one", "one")]):
        with pytest.raises(FemorsError):
            remove_overclosure(pair(), exclude=wrong)
    with pytest.raises(FemorsError, match="must be from 0"):
        remove_overclosure(pair(), gaps={("one", "two"): -1.0})


# --- what is found ------------------------------------------------------------------------------------
def test_the_check_measures_depth_place_and_shared_volume():
    pytest.importorskip("manifold3d")
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


# --- bad input ----------------------------------------------------------------------------------------
def test_an_inverted_surface_is_turned_for_the_maths_and_comes_back_as_it_was():
    good, other = pair()
    turned = Body("one", Surface(good.nodes, good.mesh.faces[:, ::-1]))
    result = remove_overclosure([turned, other])
    assert np.array_equal(result.bodies[0].mesh.faces, turned.mesh.faces)
    assert result.certified
    assert any("inward" in note for note in result.notes)
    assert np.array_equal(result.bodies[0].nodes, remove_overclosure([good, other]).bodies[0].nodes)


def test_unmerged_triangles_stay_together():
    good, other = pair()
    soup = Surface(good.mesh.corners.reshape(-1, 3), np.arange(3 * len(good.mesh.faces)).reshape(-1, 3))
    result = remove_overclosure([Body("one", soup), other])
    assert result.certified
    at = good.mesh.faces.ravel()  # triangles that shared a vertex still do, bit for bit
    first = np.unique(at, return_index=True)[1]
    assert np.array_equal(result.bodies[0].nodes, result.bodies[0].nodes[first][at])
    plain = remove_overclosure([good, other])
    assert np.abs(result.bodies[0].nodes - plain.bodies[0].nodes[at]).max() < 0.02


def test_a_sheet_below_a_surface_is_told_what_it_lacks():
    ball = sphere(3)
    cap = Surface(0.97 * ball.vertices, ball.faces[ball.vertices[ball.faces][:, :, 2].min(axis=1) > 4.0])
    result = remove_overclosure([Body("ball", ball, 0.0), Body("cap", cap)])
    assert not result.certified
    assert (
        "'cap' is open: give a sheet a thickness" in result.certificate
        and "'ball' is open" not in result.certificate
    )


@pytest.mark.parametrize("kind", ["sheet", "plate"])
def test_what_runs_through_the_middle_of_a_body_is_left_where_it_is(kind):
    """It was bent by half the body's width, and then told that it does not go."""
    disc = shapes.sphere(4, radius=16.0)
    upper = disc.faces[(disc.corners[:, :, 2] >= -1e-9).all(axis=1)]
    sheet = Surface(disc.vertices * (1.0, 1.0, 1e-3), upper)
    through = sheet if kind == "sheet" else hexes((40, 40, 2), (30.0, 30.0, 0.5))
    result = remove_overclosure([Body("ball", sphere(3)), Body("through", through)])
    assert not result.certified and "deep" in result.certificate
    assert ("'through' is open" in result.certificate) == (kind == "sheet")
    assert result.untouched and not any("of its volume" in note for note in result.notes)


def test_an_open_surface_is_told_and_parted():
    shell = sphere()
    keep = shell.vertices[shell.faces].mean(axis=1)[:, 2] < 6.0
    result = remove_overclosure(
        [Body("one", Surface(shell.vertices, shell.faces[keep])), pair((17, 1, -2))[1]]
    )
    assert result.certified
    assert any("open" in note for note in result.notes)


def test_a_body_that_crosses_itself_near_contact_is_told():
    blob = sphere(), moved(sphere(), (2.0, 9.0, 1.0))  # one mesh of two spheres that cross each other
    faces = np.concatenate((blob[0].faces, blob[1].faces + len(blob[0].vertices)))
    vertices = np.concatenate([part.vertices for part in blob])
    other = Body("two", sphere(3, 10.0, (18.0, 4.0, 0.0)))
    result = remove_overclosure([Body("one", Surface(vertices, faces)), other])
    assert any("crossed others of the same body" in note for note in result.notes)


@pytest.mark.parametrize(
    ("bodies", "words"),
    [
        (lambda: pair()[:1], "at least two"),
        (lambda: [pair()[0], pair()[0]], "two bodies are named"),
        (lambda: [Body("one", sphere()), Body("two", sphere())], "copies of one surface"),
        (lambda: pair(one=0.0, two=0.0), "every body is rigid"),
        (lambda: [Body("one", Surface(np.zeros((3, 3)), [[0, 1, 2]])), pair()[1]], "one: "),
        (lambda: [Body("one", Surface(np.full((3, 3), np.nan), [[0, 1, 2]])), pair()[1]], "not finite"),
        (lambda: pair(one=1.5), "from 0"),
    ],
)
def test_bad_input_is_one_line(bodies, words):
    with pytest.raises(FemorsError, match=words) as error:
        remove_overclosure(bodies())
    assert "\n" not in str(error.value)


def test_a_negative_gap_is_refused():
    with pytest.raises(FemorsError, match="Minimum gap"):
        remove_overclosure(pair(), OverclosureSettings(gap=-1.0))


def test_metres_beside_millimetres_are_told():
    bodies = [Body("mm", sphere(2, 1000.0)), Body("m", sphere(2, 1.0, (1000.0, 0.0, 0.0)))]
    assert any("unit of length" in note for note in remove_overclosure(bodies).notes)


def test_cancelling_ends_at_once():
    calls = []

    def progress(fraction: float, text: str) -> None:
        calls.append(fraction)
        if len(calls) == 4:
            raise Cancelled

    with pytest.raises(Cancelled):
        remove_overclosure(pair(), progress=progress)


def test_progress_and_preview():
    fractions, seen = [], []
    remove_overclosure(pair(), progress=lambda f, text: fractions.append(f), preview=seen.append)
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert set(seen[0]) == {"one", "two"}
    assert seen[0]["one"].shape == pair()[0].nodes.shape


# --- what a fresh pair of eyes found ------------------------------------------------------------------
def test_coarse_bodies_without_a_node_near_contact():
    plate = hexes((1, 1, 1), (100, 100, 1)).surface()[0]
    slab = hexes((20, 20, 1), (10, 10, 1), centre=(3.0, 2.0, 0.2)).surface()[0]
    assert_apart(remove_overclosure([Body("plate", plate), Body("slab", slab)], OverclosureSettings(gap=GAP)))
    bars = [Body("x", hexes((1, 1, 1), (400, 5, 5)).surface()[0])]
    bars.append(Body("y", hexes((1, 1, 1), (5, 400, 5), centre=(20.0, 30.0, 1.0)).surface()[0]))
    finding = check_overclosure(bars)[0]
    assert finding.state == "overlap"
    assert np.isfinite([finding.least, *finding.where]).all()
    assert np.linalg.norm(np.array(finding.where[:2]) - (20.0, 0.0)) < 10


@pytest.mark.parametrize("excluded", [False, True])
def test_a_thin_body_far_away_changes_nothing(excluded):
    far = Body("far", hexes((4, 4, 1), (20, 20, 0.02), centre=(0, 0, 500)).surface()[0])
    alone = remove_overclosure(pair(), OverclosureSettings(gap=GAP))
    both = [("one", "far"), ("far", "two")] if excluded else []
    beside = remove_overclosure([*pair(), far], OverclosureSettings(gap=GAP), exclude=both)
    for a, b in zip(alone.bodies, beside.bodies[:2], strict=True):
        assert np.array_equal(a.nodes, b.nodes)


@pytest.mark.parametrize("gap", [np.inf, np.nan, 1e9])
def test_a_pair_s_gap_is_a_length(gap):
    with pytest.raises(FemorsError, match="must be from 0"):
        remove_overclosure(pair(), gaps={("one", "two"): gap})


@pytest.mark.parametrize("cells", [1, 5, 10])
@pytest.mark.parametrize("depth", [0.1, 1.0, 4.0])
def test_cubes_that_stand_exactly_in_line(cells, depth):
    """All side faces are coplanar: what is closest is beside, and leads nowhere."""
    bodies = [Body("one", box(cells, 10.0)), Body("two", box(cells, 10.0, (0.0, 0.0, 10.0 - depth)))]
    assert_apart(remove_overclosure(bodies, OverclosureSettings(gap=GAP)))


def test_lobes_that_cross_stay_outward():
    lobes = sphere(2), moved(sphere(2), (10.0, 3.0, 0.0))
    faces = np.concatenate((lobes[0].faces, lobes[1].faces + len(lobes[0].vertices)))
    body = Surface(np.concatenate([s.vertices for s in lobes]), faces)
    result = remove_overclosure([Body("lobes", body), Body("ball", sphere(2, 10.0, (24.0, 8.0, 0.0)))])
    assert not any("inward" in note for note in result.notes)
    assert result.bodies[0].volume[0] == pytest.approx(2 * lobes[0].volume)
    assert result.bodies[0].xor is None  # it overlaps itself: what a boolean says of it is not its volume
    assert all(f.shared is None or f.shared >= 0 for f in (*result.before, *result.after))


def test_where_it_is_not_reached_the_best_state_comes_back():
    """Of all states that the loop went through, none had less to it; nor had the input."""
    bodies = [
        Body("below", sphere(), 0.0),
        Body("above", sphere(centre=(0.0, 0.0, 19.9)), 0.0),
        Body("ball", sphere(2, 3.0, (0.5, 0.0, 9.9)), 1.0),
    ]
    seen: list[dict] = []
    settings = OverclosureSettings(gap=GAP, iterations=30)
    result = remove_overclosure(bodies, settings, preview=seen.append, exclude=[("below", "above")])
    assert not result.certified

    def missing(nodes: np.ndarray) -> float:
        ball = Surface(nodes, bodies[2].mesh.faces)
        return max(-smallest_gap(ball, body.mesh) for body in bodies[:2])

    states = [missing(state["ball"]) for state in seen[::3]]
    assert missing(result.bodies[2].nodes) <= 1.1 * min([*states, missing(bodies[2].nodes)]) + GAP


def test_notes_of_what_looks_wrong():
    told: list[str] = []
    check_overclosure(pair((0.01, 0.0, 0.0)), tell=told.append)
    assert any("nearly the same room" in note for note in told)
    told.clear()
    check_overclosure(pair(), OverclosureSettings(gap=8.0), tell=told.append)
    assert any("unit" in note for note in told)


def test_a_body_in_another_unit_is_told_once():
    told: list[str] = []
    bodies = [Body("large", sphere(2, 1000.0)), Body("small", sphere(2, 1.0))]
    check_overclosure(bodies, OverclosureSettings(gap=0.5), tell=told.append)
    assert ["unit of length?" in note for note in told] == [True], told
    told.clear()
    check_overclosure([bodies[0], Body("less", sphere(2, 500.0))], tell=told.append)
    assert not any("same room" in note for note in told), told  # it lies inside, and that is told as a pair


def test_a_body_that_is_changed_by_more_than_half_is_told():
    words = "of its volume; are the bodies in their places?"
    result = remove_overclosure(pair((6.0, 0.5, 0.0), one=0.0))
    one, two = result.bodies
    assert two.xor > 0.5
    assert f"two: the removal changed {two.xor:.0%} {words}" in result.notes
    assert result.report()["warnings"] == list(result.notes)
    assert not any(note.startswith("one:") for note in result.notes) and one.xor == 0
    result = remove_overclosure(pair())
    assert max(body.xor for body in result.bodies) < 0.5
    assert not any(words in note for note in result.notes)


def test_after_a_wide_gap_the_pair_is_still_listed():
    result = remove_overclosure(pair(), OverclosureSettings(gap=2.0))
    assert result.certified
    assert len(result.after) == 1
    assert "the smallest gap is 2.0" in result.certificate


@pytest.mark.parametrize("cells", [2, 3, 4])
def test_coarse_cubes_in_line_are_freed_although_their_sides_lie_in_one_plane(cells):
    """Nothing crosses at first, for sides in one plane only touch: the loop alone ends with crossings."""
    one, two = shapes.box(cells=cells), shapes.box(cells=cells, low=(0.6, 0.0, 0.0))
    result = remove_overclosure([Body("one", one), Body("two", two)])
    assert result.certified, result.certificate
    assert result.bodies[0].xor < 0.35
