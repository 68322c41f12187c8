# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies as users have them: bad ones, unlikely ones, and what is said of them."""

from __future__ import annotations

import re

import numpy as np
import pytest
from solids import box, hexes, moved, sphere
from spheres import GAP, assert_apart, pair, smallest_gap

from femors_addon import removal, shapes
from femors_addon.bodies import Body, Solid
from femors_addon.findings import Finding
from femors_addon.mesh import Surface, triangulate
from femors_addon.overclosure import OverclosureSettings, check_overclosure, remove_overclosure
from femors_addon.progress import Cancelled, FemorsError
from femors_addon.removal import _better
from femors_addon.separation import runs_through


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
    one, merged = (found.bodies[0] for found in (result, plain))
    assert one.count == merged.count == len(good.mesh.vertices), "corners at one place are one node"
    assert one.moved == pytest.approx(merged.moved, rel=0.05) and one.report()["nodes"] == one.count


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


def through(bone: Surface) -> Surface:
    """A sheet of 200 x 500 along the middle of a bone, whose border is outside."""
    side = np.linspace(-1.0, 1.0, 51)
    y, z = (axis.ravel() for axis in np.meshgrid(100.0 * side, 250.0 * side, indexing="ij"))
    sizes, corners = np.full(2500, 4), np.arange(51 * 50).reshape(50, 51)[:, :50].ravel()
    faces = triangulate(sizes, (corners[:, None] + [0, 51, 52, 1]).ravel())[0]
    middle = np.mean(bone.bounds, axis=0)
    return Surface(np.column_stack((0.3 * np.sin(y / 7) * np.cos(z / 18), y, z)) + middle, faces)


def test_a_sheet_along_the_middle_of_a_rigid_body_is_left_and_told_in_time():
    """It was bent by 56 over 120 iterations, almost round the bone, and the limit was told as the reason."""
    bone = shapes.bone(2500)
    bodies = [Body("bone", bone, 0.0), Body("sheet", through(bone)), Body("far", sphere(2, 5.0, (900, 0, 0)))]
    for some in (bodies[:2], bodies):
        result = remove_overclosure(some, OverclosureSettings(gap=0.1))
        assert not result.certified and result.untouched and len(result.history) <= 50
        (reason,) = result.reasons
        assert "deep" in reason and reason.endswith(
            "'sheet' is open and runs right through 'bone': move it to the side where it belongs, or "
            "exclude the pair"
        )
        assert result.before == result.after


def test_a_sheet_that_can_go_round_a_body_or_dips_into_it_still_does():
    """Right through as well, but it is parted; and a shallow one is told of its thickness where it is not."""
    ball = sphere(3, 20.0)
    sheet = through(ball)
    sheet = sheet.moved(sheet.vertices * (1.0, 0.6, 0.24) + np.outer(sheet.vertices[:, 2], (0.15, 0, 0)))
    deep = Solid(Body("sheet", sheet), 1.0)
    shallow = Solid(Body("sheet", sheet.moved(sheet.vertices + (16.0, 0.0, 0.0))), 1.0)
    body = Solid(Body("ball", ball), 0.0)
    assert [runs_through(deep, body), runs_through(shallow, body), runs_through(body, deep)] == [
        True,
        False,
        False,
    ]
    for one in (deep, shallow):
        assert remove_overclosure([Body("ball", ball, 0.0), Body("sheet", one.surface)]).certified


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


def test_a_part_in_metres_beside_millimetres_is_asked_about():
    """Of any ratio of sizes: one body is not as large as the other in one unit either."""
    bodies = [Body("bone", sphere(2, 0.03)), Body("cartilage", sphere(2, 14.0, (600.0, 0.0, 0.0)))]
    told: list[str] = []
    check_overclosure(bodies, tell=told.append)
    words = "'cartilage' is 467 times as large as 'bone': are all bodies in one unit of length?"
    assert words in told


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


@pytest.mark.parametrize("cells", [4, 5])
@pytest.mark.parametrize("depth", [0.5, 0.8, 0.9, 1.3])
def test_cubes_that_go_nowhere_are_shaken(cells, depth):
    """Which of them do depends on roundings, and so on the processor: of 108 like these five did."""
    bodies = [Body("one", box(cells, 10.0)), Body("two", box(cells, 10.0, (0.0, 0.0, 10.0 - depth)), 0.2)]
    assert_apart(remove_overclosure(bodies, OverclosureSettings(gap=GAP)))


@pytest.mark.parametrize("rigid", [False, True])
def test_what_is_stuck_with_little_left_is_shaken_and_tried_again(monkeypatch, rigid):
    plain, shakes = removal.METHODS["grnn"], []

    def stuck_unless_shaken(efforts, solids, *args):
        shakes.append([solid.points - solid.rest for solid in solids])
        return plain(efforts, solids, *args) if any(shake.any() for shake in shakes[-1]) else "no headway"

    monkeypatch.setitem(removal.METHODS, "grnn", stuck_unless_shaken)
    ball, edge = sphere(3, 10.0), sphere(3, 10.0).mean_edge
    other = Body("two", moved(ball, (20.0 - 0.002 * edge, 0.0, 0.0)), 0.0 if rigid else 0.5)
    result = remove_overclosure([Body("one", ball), other], OverclosureSettings(gap=GAP))
    assert_apart(result)
    assert [any(shake.any() for shake in shake) for shake in shakes] == [False, False, True]  # parted before
    one, two = shakes[-1]
    for shake in (one, *([] if rigid else [two])):
        assert 0.0 < np.abs(shake).max() <= removal.SHAKEN[0] * edge
    assert two.any() != rigid
    assert not one[ball.vertices[:, 0] < 10.0 - 2.0 * edge].any()  # far from the other nothing moves


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


def test_what_rounding_adds_to_the_gap_far_from_the_origin_is_told():
    words = "so far from the origin single precision"
    settings = OverclosureSettings(gap=0.01)
    for away, told in (
        (0.0, ""),
        (2e4, ""),
        (2e5, "rounds by 0.0078; whatever they are written to, up to 0.031"),
    ):
        bodies = [Body(one.name, one.mesh.moved(one.nodes + away)) for one in pair((18.0, 0.0, 0.0))]
        result = remove_overclosure(bodies, settings)
        notes = [note for note in result.notes if words in note]
        assert result.certified and len(notes) == bool(told) and all(told in note for note in notes)
        checked: list[str] = []
        check_overclosure(bodies, settings, tell=checked.append)
        assert not any(words in note for note in checked), "nothing was pushed"
    rigid = [Body(one.name, one.mesh, 0.0) for one in bodies]
    left = remove_overclosure([*rigid, Body("free", sphere(2, 5.0))], settings)
    assert not left.certified and not any(words in note for note in left.notes), "nothing was pushed"


def test_a_body_in_another_unit_is_told_once():
    told: list[str] = []
    bodies = [Body("large", sphere(2, 1000.0)), Body("small", sphere(2, 1.0, (100.0, 0.0, 0.0)))]
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
    assert f"two: what the removal took away and added is {100 * two.xor:.0f} % {words}" in result.notes
    assert result.report()["warnings"] == [*result.losses, *result.notes]
    assert not any(note.startswith("one:") for note in result.notes) and one.xor == 0
    result = remove_overclosure(pair())
    assert max(body.xor for body in result.bodies) < 0.5
    assert not any(words in note for note in result.notes)


def test_what_has_lost_more_than_a_tenth_is_told_with_a_certificate_too():
    result = remove_overclosure(pair((13.0, 1.0, 2.0), one=0.0))
    before, after = result.bodies[1].volume
    assert result.certified and 0.1 < (before - after) / before < 0.3
    (told,) = result.losses
    assert told.startswith(f"'two' has lost {100 * (1 - after / before):.1f} % of its volume (")
    for near in (remove_overclosure(pair((16.0, 1.0, 2.0), one=0.0)), remove_overclosure(pair((30.0, 0, 0)))):
        assert near.certified and not near.losses
    ball = sphere(3)
    half = Surface(ball.vertices, ball.faces[ball.vertices[ball.faces][:, :, 0].max(axis=1) < 1e-9])
    opened = remove_overclosure([Body("ball", sphere(3, 8.0, (-12.0, 0.0, 0.0)), 0.0), Body("half", half)])
    assert opened.bodies[1].moved and not opened.losses, "what is open has no volume"


def test_a_gap_in_another_unit_is_refused_where_it_would_move_a_body():
    metres = [Body(body.name, body.mesh.moved(body.mesh.vertices / 1000.0)) for body in pair()]
    words = "the gap, 0.01, is 29% of the size of 'one': give it in the unit of the coordinates"
    with pytest.raises(FemorsError, match=re.escape(words)):
        remove_overclosure(metres)
    with pytest.raises(FemorsError, match="the gap, 20, is 58% of"):
        remove_overclosure(pair(), gaps={("one", "two"): 20.0})
    assert remove_overclosure(metres, OverclosureSettings(gap=1e-5)).certified
    apart = [metres[0], Body("two", metres[0].mesh.moved(metres[0].mesh.vertices + (0.2, 0.0, 0.0)))]
    assert remove_overclosure(apart).certified, "nothing is moved"
    assert remove_overclosure(metres, exclude=[("one", "two")]).certified


def test_after_a_wide_gap_the_pair_is_still_listed():
    result = remove_overclosure(pair(), OverclosureSettings(gap=2.0))
    assert result.certified
    assert len(result.after) == 1
    assert "the smallest gap of a node to a surface is 2.0" in result.certificate


@pytest.mark.parametrize("cells", [2, 3, 4])
def test_coarse_cubes_in_line_are_freed_although_their_sides_lie_in_one_plane(cells):
    """Nothing crosses at first, for sides in one plane only touch: the loop alone ends with crossings."""
    one, two = shapes.box(cells=cells), shapes.box(cells=cells, low=(0.6, 0.0, 0.0))
    result = remove_overclosure([Body("one", one), Body("two", two)])
    assert result.certified, result.certificate
    assert result.bodies[0].xor < 0.35


@pytest.mark.parametrize(
    ("depth", "crossings", "kept"),
    [(10.0, 100, False), (3.9, 100, True), (4.1, 100, False), (10.0, 39, True), (10.1, 39, False)],
)
def test_which_state_that_is_not_clear_is_worth_keeping(depth, crossings, kept):
    """Less than 40 % of the depth; or of the crossings, where it is no deeper."""

    def found(depth: float, crossings: int) -> list[Finding]:
        return [Finding("a", "b", 0.0, -depth, (1, 1), crossings, "", (0.0, 0.0, 0.0), None, "overlap")]

    assert _better(found(depth, crossings), found(10.0, 100)) == kept
