# SPDX-License-Identifier: GPL-3.0-or-later
"""The GRNN: what follows from its definition, and its fast ways against the definition."""

from __future__ import annotations

import math

import numpy as np
import pytest
from grnncases import around, smooth
from hypothesis import given, settings
from hypothesis import strategies as st

from femors_addon import grnn, shapes
from femors_addon.grnn import ROUGH, TOLERANCE, DisplacementField
from femors_addon.progress import Cancelled, FemorsError, silent

SPREADS = (0.3, 0.5, 0.8, 1.0, 1.4, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 40.0)  # mean edges
AWAY = {"on": 0.0, "near": 0.5, "middle": 2.0, "reach": 4.5, "far": 10.0, "very far": 1e4}  # spreads


def ways_taken(monkeypatch) -> set[str]:
    """A set that comes to hold the ways by which fields are evaluated from now on."""
    taken: set[str] = set()
    for owner, name in (
        (grnn._Grid, "smooth"),
        (DisplacementField, "_by_cells"),
        (DisplacementField, "_far"),
    ):
        original = getattr(owner, name)

        def spy(self, *arguments, original=original, name=name):
            taken.add(name)
            return original(self, *arguments)

        monkeypatch.setattr(owner, name, spy)
    return taken


@pytest.fixture(scope="module")
def surfaces():
    """Surface-like clouds of centres with their mean edge: even, elongated, thin and sharp."""
    ball, bone = shapes.sphere(4, radius=100.0), shapes.bone(2500)
    slab = shapes.box((200, 120, 12), (25, 15, 2))
    return {"bone": bone, "ball": ball, "slab": slab}


# --- theory -------------------------------------------------------------------------------------
def test_the_weights_sum_to_one(surfaces):
    """A constant field is reproduced everywhere, however far away and whatever the spread."""
    bone = surfaces["bone"]
    constant = np.array([3.0, -1.0, 2e3])
    for spread in SPREADS:
        field = DisplacementField(
            bone.vertices, np.tile(constant, (len(bone.vertices), 1)), spread * bone.mean_edge
        )
        for radius in AWAY.values():
            at = around(bone.vertices, radius * field.spread, 250)
            assert field(at) == pytest.approx(np.tile(constant, (250, 1)), rel=1e-5)
            assert field.exact(at[:20]) == pytest.approx(np.tile(constant, (20, 1)), rel=1e-12)


def test_a_rigid_translation_is_reproduced(surfaces):
    """Moving centres and queries together changes nothing; far from the origin neither."""
    bone = surfaces["bone"]
    at = around(bone.vertices, 5.0, 400)
    field = DisplacementField(bone.vertices, smooth(bone.vertices), 4.0)
    for shift, digits in (((10.0, -20.0, 5.0), 1e-6), ((1e5, 1e5, -1e5), 1e-4)):
        other = DisplacementField(bone.vertices + shift, smooth(bone.vertices), 4.0)
        assert np.abs(other(at + shift) - field(at)).max() < digits * 60.0


def test_the_weight_is_one_half_at_one_spread():
    """Two centres: at one spread from the one and on the other, the weights are 1/2 and 1."""
    spread = 2.5
    field = DisplacementField([[0, 0, 0], [spread, 0, 0]], [[3.0, 0, 0], [0, 3.0, 0]], spread)
    assert field([[0, 0, 0]]) == pytest.approx(np.array([[2.0, 1.0, 0.0]]))
    # at distances a and b the ratio of the weights is 2^-((a^2 - b^2) / s^2)
    ratio = 2.0 ** -((4.0**2 - (4.0 - spread) ** 2) / spread**2)
    assert field([[4.0, 0, 0]]) == pytest.approx(3.0 * np.array([[ratio, 1.0, 0]]) / (1.0 + ratio))


def test_the_field_stays_within_the_displacements(surfaces):
    """A mean with positive weights lies in the range of its values."""
    bone = surfaces["bone"]
    values = smooth(bone.vertices)
    low, high = values.min(axis=0) - 1e-3, values.max(axis=0) + 1e-3
    for spread in (1.0, 5.0, 100.0):
        field = DisplacementField(bone.vertices, values, spread)
        for radius in AWAY.values():
            out = field(around(bone.vertices, radius * spread, 250))
            assert ((out >= low) & (out <= high)).all()


def test_limits_of_the_spread(surfaces):
    """Tiny: each centre keeps its own value. Huge: everything gets the mean."""
    bone = surfaces["bone"]
    values = smooth(bone.vertices)
    tiny = DisplacementField(bone.vertices, values, 1e-3)
    assert tiny(bone.vertices) == pytest.approx(values, abs=1e-4)
    huge = DisplacementField(bone.vertices, values, 1e6)
    assert huge(bone.vertices) == pytest.approx(np.tile(values.mean(axis=0), (len(values), 1)), abs=1e-2)


def test_symmetry_of_the_definition():
    """Swapping axes of centres, displacements and queries swaps the axes of the field."""
    rng = np.random.default_rng(3)
    centres, values, at = rng.normal(size=(50, 3)), rng.normal(size=(50, 3)), rng.normal(size=(20, 3))
    plain = DisplacementField(centres, values, 0.7)(at)
    swapped = DisplacementField(centres[:, ::-1], values[:, ::-1], 0.7)(at[:, ::-1])
    assert swapped == pytest.approx(plain[:, ::-1])


# --- against the definition ---------------------------------------------------------------------
def test_exact_is_the_naive_double_loop():
    rng = np.random.default_rng(0)
    centres, values = rng.normal(size=(40, 3)), rng.normal(size=(40, 3))
    for spread in (0.1, 0.6, 3.0):
        field = DisplacementField(centres, values, spread)
        for at in 2.0 * rng.normal(size=(15, 3)):
            total, weights = np.zeros(3), 0.0
            for centre, value in zip(centres, values, strict=True):
                weight = math.exp(-math.log(2.0) * math.dist(at, centre) ** 2 / spread**2)
                total, weights = total + weight * value, weights + weight
            if weights > 1e-250:
                assert field.exact([at])[0] == pytest.approx(total / weights, rel=1e-10, abs=1e-12)
                assert field([at])[0] == pytest.approx(total / weights, rel=1e-10, abs=1e-12)


@pytest.mark.parametrize("kind", ["smooth", "rough"])
@pytest.mark.parametrize("name", ["bone", "ball", "slab"])
def test_the_fast_ways_keep_their_bound(surfaces, name, kind):
    centres, edge = surfaces[name].vertices, surfaces[name].mean_edge
    values = smooth(centres) if kind == "smooth" else np.random.default_rng(1).normal(size=centres.shape)
    bound = TOLERANCE * np.linalg.norm(values, axis=1).max()
    count = grnn.BLOCK // 8 // len(centres) + 100  # more than what is done by the definition at once
    for spread in SPREADS:
        field = DisplacementField(centres, values, spread * edge)
        at = np.concatenate([around(centres, r * field.spread, count // 6 + 1, 7) for r in AWAY.values()])
        error = np.linalg.norm(field(at) - field.exact(at), axis=1).max()
        assert error <= bound, f"spread {spread} mean edges"


def test_the_bound_holds_amid_a_ball(surfaces):
    """There every centre is about as far as every other: none may be left out."""
    ball = surfaces["ball"]
    values = np.random.default_rng(5).normal(size=ball.vertices.shape)
    bound = TOLERANCE * np.linalg.norm(values, axis=1).max()
    at = np.random.default_rng(6).normal(size=(300, 3)) * 15.0
    for spread in (2.0, 12.0, 20.0, 40.0, 90.0):
        field = DisplacementField(ball.vertices, values, spread)
        assert np.linalg.norm(field(at) - field.exact(at), axis=1).max() <= bound


def test_the_bound_holds_between_two_sheets(surfaces):
    """As a training set is: source and target lie close to each other, each with its own vectors."""
    ball = surfaces["ball"]
    other = 1.03 * ball.vertices[::2] + 0.5
    centres = np.concatenate((ball.vertices, other))
    values = np.concatenate((smooth(ball.vertices), smooth(other) * (1, -1, 1)))
    bound = TOLERANCE * np.linalg.norm(values, axis=1).max()
    for spread in (0.3, 1.0, 2.0, 5.0, 15.0, 40.0):
        field = DisplacementField(centres, values, spread * ball.mean_edge)
        at = around(ball.vertices, 2.0, 300)
        assert np.linalg.norm(field(at) - field.exact(at), axis=1).max() <= bound


@pytest.mark.parametrize("kind", ["smooth", "rough"])
@pytest.mark.parametrize("name", ["bone", "ball", "slab"])
def test_the_grid_keeps_its_bound(surfaces, name, kind, monkeypatch):
    """By itself it is taken for tens of thousands of centres only; here for a few thousand too."""
    monkeypatch.setattr(grnn._Grid, "cost", lambda self, handled: 0.0)
    seen = ways_taken(monkeypatch)
    centres, edge = surfaces[name].vertices, surfaces[name].mean_edge
    values = smooth(centres) if kind == "smooth" else np.random.default_rng(1).normal(size=centres.shape)
    bound = TOLERANCE * np.linalg.norm(values, axis=1).max()
    for spread in SPREADS[3:]:
        field = DisplacementField(centres, values, spread * edge)
        seen.clear()
        at = np.concatenate([around(centres, r * field.spread, 300, 7) for r in (0.0, 0.5, 1.2)])
        error = np.linalg.norm(field(at) - field.exact(at), axis=1).max()
        assert seen == {"smooth"}
        assert error <= bound, f"spread {spread} mean edges"


@pytest.mark.parametrize("kind", ["smooth", "rough"])
@pytest.mark.parametrize("name", ["bone", "ball", "slab"])
def test_a_rough_field_keeps_its_wider_bound_by_cells_and_by_grid(surfaces, name, kind, monkeypatch):
    seen = ways_taken(monkeypatch)
    centres, edge = surfaces[name].vertices, surfaces[name].mean_edge
    values = smooth(centres) if kind == "smooth" else np.random.default_rng(1).normal(size=centres.shape)
    bound = ROUGH * np.linalg.norm(values, axis=1).max()
    for spread in SPREADS[3:]:
        field = DisplacementField(centres, values, spread * edge, rough=True)
        at = np.concatenate([around(centres, r * field.spread, 300, 7) for r in (0.0, 0.5, 1.2)])
        exact = field.exact(at)
        for cost, way in ((0.0, "smooth"), (1e18, "_by_cells")):
            monkeypatch.setattr(grnn._Grid, "cost", lambda self, handled, cost=cost: cost)
            seen.clear()
            error = np.linalg.norm(
                field._within(at, np.zeros(len(at)), grnn.REACHES[0], silent) - exact, axis=1
            )
            assert seen == {way}
            assert error.max() <= bound, f"spread {spread} mean edges, {way}"


def test_every_way_is_taken_by_itself(surfaces, monkeypatch):
    """Otherwise the tests above would show less than they say."""
    seen = ways_taken(monkeypatch)
    ball = surfaces["ball"].vertices
    many = np.concatenate([ball * (1 + 0.003 * k) for k in range(10)])
    field = DisplacementField(many, smooth(many), 30.0)
    at = np.concatenate((many, many[:5] * 1e3, many[:5] * 1.6))
    out = field(at)
    assert seen == {"smooth", "_by_cells", "_far"}
    sample = np.concatenate((np.arange(0, len(many), 250), np.arange(len(many), len(at))))
    bound = TOLERANCE * np.linalg.norm(field.displacements, axis=1).max()
    assert np.linalg.norm(out[sample] - field.exact(at[sample]), axis=1).max() <= bound


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_any_cloud_gives_the_definition(data):
    """Small clouds of any kind: gaps, clusters, lines, planes, points that coincide."""
    seed = data.draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    n = data.draw(st.integers(1, 60))
    squash = np.array([data.draw(st.sampled_from([0.0, 1e-3, 1.0, 1e3])) for _ in range(3)])
    centres = rng.normal(size=(n, 3)) * squash
    values = rng.normal(size=(n, 3))
    spread = 10.0 ** data.draw(st.floats(-6, 6))
    field = DisplacementField(centres, values, spread)
    at = np.concatenate((centres, rng.normal(size=(10, 3)) * 10.0 ** data.draw(st.floats(-3, 9))))
    out = field(at)
    assert np.isfinite(out).all()
    assert (
        np.linalg.norm(out - field.exact(at), axis=1).max()
        <= TOLERANCE * np.linalg.norm(values, axis=1).max()
    )


# --- far queries --------------------------------------------------------------------------------
@pytest.mark.parametrize("distance", [1e2, 1e5, 1e9])
def test_far_away_the_nearest_centre_rules(surfaces, distance):
    """There the plain formula is 0 / 0."""
    slab = surfaces["slab"]
    values = np.random.default_rng(2).normal(size=slab.vertices.shape)
    field = DisplacementField(slab.vertices, values, 0.5)
    at = np.tile([0.0, 0.0, -distance], (700, 1)) + np.random.default_rng(3).normal(size=(700, 3)) * 1e-3
    at[:, :2] -= 0.2 * distance  # towards one corner
    corner = int(np.argmin(np.linalg.norm(slab.vertices - at[0], axis=1)))
    assert field(at) == pytest.approx(np.tile(values[corner], (700, 1)), abs=1e-9)
    assert field(at[:3]) == pytest.approx(np.tile(values[corner], (3, 1)), abs=1e-9)


# --- few and odd centres ------------------------------------------------------------------------
@pytest.mark.parametrize("spread", [1e-9, 1.0, 1e9])
def test_a_single_centre_rules_everywhere(spread):
    field = DisplacementField([[1.0, 2.0, 3.0]], [[-5.0, 0.0, 1.0]], spread)
    at = np.random.default_rng(0).normal(size=(grnn.BLOCK // 8 + 10, 3)) * 100
    assert (field(at) == [-5.0, 0.0, 1.0]).all()
    assert field([[1.0, 2.0, 3.0]]).tolist() == [[-5.0, 0.0, 1.0]]


def test_centres_at_one_place_give_their_mean(surfaces):
    field = DisplacementField(np.zeros((4, 3)), [[1.0, 0, 0], [3.0, 0, 0], [0, 4.0, 0], [0, 0, 8.0]], 1.0)
    assert field([[0, 0, 0], [50.0, 0, 0]]) == pytest.approx(np.array([[1.0, 1.0, 2.0]] * 2))
    # and a cloud that stands twice is the same field, by any way
    ball = surfaces["ball"]
    values, at = smooth(ball.vertices), around(ball.vertices, 4.0, 500)
    for spread in (2.0, 8.0, 60.0):
        once = DisplacementField(ball.vertices, values, spread)
        twice = DisplacementField(np.tile(ball.vertices, (2, 1)), np.tile(values, (2, 1)), spread)
        assert (
            np.linalg.norm(once(at) - twice(at), axis=1).max()
            <= 2 * TOLERANCE * np.linalg.norm(values, axis=1).max()
        )


def test_ten_thousand_centres_at_one_place_end():
    """As an unmerged soup would give: no search may go on for ever."""
    values = np.random.default_rng(0).normal(size=(10_000, 3))
    field = DisplacementField(np.zeros((10_000, 3)), values, 0.1)
    at = np.concatenate((np.zeros((60, 3)), np.full((60, 3), 40.0)))
    assert field(at) == pytest.approx(np.tile(values.mean(axis=0), (120, 1)), abs=TOLERANCE * 4)


@pytest.mark.parametrize("points", [np.empty((0, 3)), []])
def test_no_points_give_no_displacements(points, surfaces):
    field = DisplacementField(surfaces["ball"].vertices, surfaces["ball"].vertices, 1.0)
    assert field(points).shape == field.exact(points).shape == (0, 3)


def test_the_field_is_made_of_copies():
    centres = np.zeros((2, 3))
    field = DisplacementField(centres, centres, 1.0)
    centres[:] = 9.0
    assert not field.centres.any()
    with pytest.raises(ValueError, match="read-only"):
        field.displacements[0] = 1.0


@pytest.mark.parametrize("spread", [0.0, -1.0, math.nan, math.inf])
def test_a_spread_must_be_a_length(spread):
    with pytest.raises(FemorsError, match="spread must be a positive length"):
        DisplacementField([[0, 0, 0]], [[0, 0, 0]], spread)


@pytest.mark.parametrize(
    ("centres", "values", "words"),
    [
        (np.empty((0, 3)), np.empty((0, 3)), "at least one"),
        (np.zeros((3, 3)), np.zeros((2, 3)), "2 and 3"),
        ([[0, 0, np.nan]], np.zeros((1, 3)), "finite"),
        (np.zeros((1, 3)), [[np.inf, 0, 0]], "finite"),
    ],
)
def test_a_field_needs_finite_pairs(centres, values, words):
    with pytest.raises(FemorsError, match=words) as error:
        DisplacementField(centres, values, 1.0)
    assert "\n" not in str(error.value)


# --- bits, progress ----------------------------------------------------------------------------------
def test_the_same_bits_every_time(surfaces):
    bone = surfaces["bone"]
    for spread in SPREADS:
        at = np.concatenate([around(bone.vertices, r * spread, 60) for r in AWAY.values()])
        one = DisplacementField(bone.vertices, smooth(bone.vertices), spread * bone.mean_edge)
        two = DisplacementField(bone.vertices.copy(), smooth(bone.vertices), spread * bone.mean_edge)
        assert one(at).tobytes() == two(at).tobytes() == one(at).tobytes()


@pytest.mark.parametrize("spread", [0.5, 2.0, 60.0])
def test_progress_is_told_and_may_cancel(surfaces, spread):
    """By every way, the definition included."""
    ball = surfaces["ball"]
    field = DisplacementField(ball.vertices, ball.vertices, spread * ball.mean_edge)
    at = np.concatenate((ball.vertices, 30.0 * ball.vertices[:50]))
    told: list[float] = []
    field(at, lambda fraction, text: told.append(fraction))
    assert told
    assert all(0.0 <= fraction <= 1.0 for fraction in told)

    def cancel(fraction, text):
        raise Cancelled

    for way in (field, field.exact):
        with pytest.raises(Cancelled):
            way(at, cancel)


@pytest.mark.parametrize("scale", [1.0, 1e-12, 1e12])
def test_a_spread_however_small_takes_the_nearest_centre(scale):
    """No cell of its size could be counted; queries on the centres, and a little off them."""
    random = np.random.default_rng(0)
    centres, displacements = random.uniform(0.0, 500.0, (3000, 3)), random.normal(size=(3000, 3))
    points = centres + 1e-6 * random.normal(size=centres.shape) * (random.random((3000, 1)) < 0.5)
    for spread in (1e-3, 1e-6, 1e-9, 1e-15, 1e-30):
        field = DisplacementField(scale * centres, displacements, scale * spread)
        with np.errstate(all="raise", under="ignore"):
            got = field(scale * points)
        assert np.abs(got - displacements).max() < 1e-9, spread
