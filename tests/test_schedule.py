# SPDX-License-Identifier: GPL-3.0-or-later
"""The iterations made from the settings: the paper's own numbers, and what holds for any settings."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from femors_addon.morph_settings import PRESETS, MorphSettings
from femors_addon.schedule import node_counts, stages

STANDARD, PUBLISHED = PRESETS["standard"], PRESETS["published"]
EDGES, SIZE = [7.0, 3.6, 1.8], 460.0  # of a femur in mm with 1500, 6000 and 24 000 nodes


def test_the_published_schedule_is_the_papers():
    """Stages 1 to 3 behind the authors' stored result: iterations, spread, decay, step, normal weight."""
    assert node_counts(PUBLISHED, 23665) == [int(0.15 * 23665)]
    one, two, three = stages(PUBLISHED, [4.6, 1.8], SIZE)
    assert [(s.name, s.level, s.step_scale, len(s.iterations)) for s in (one, two, three)] == [
        ("reduced", 0, 0.95, 10),
        ("fine", 0, 0.5, 4),
        ("dense", 1, 0.75, 10),
    ]
    for stage, spread, decay, weight, fading in (
        (one, 10.0, 1.0, 5.0, 0.999),
        (two, 1.0, 0.995, 1.0, 0.95),
        (three, 10.0, 0.95, 1.0, 0.95),
    ):
        steps = np.arange(len(stage.iterations))
        assert [i.spread for i in stage.iterations] == pytest.approx(spread * decay**steps)
        assert [i.normal_weight for i in stage.iterations] == pytest.approx(weight * fading**steps)
    assert (PUBLISHED.field_spread, PUBLISHED.correspondence) == (1.0, "nearest")
    # and nothing that the paper does not have
    assert (PUBLISHED.sliding, PUBLISHED.projection, PUBLISHED.relaxation) == (0, 0.0, 0)


def test_the_standard_schedule_goes_from_coarse_to_fine():
    plan = stages(STANDARD, EDGES, SIZE)
    assert [stage.level for stage in plan] == [0, 1, 2]
    assert [stage.name for stage in plan] == ["reduced", "fine", "dense"]
    assert [len(stage.iterations) for stage in plan] == [
        STANDARD.iterations,
        STANDARD.fine_iterations,
        STANDARD.dense_iterations,
    ]
    for stage in plan:
        spreads = [i.spread for i in stage.iterations]
        assert spreads == sorted(spreads, reverse=True)
        assert spreads[-1] >= EDGES[stage.level]  # a smaller one would fold the mesh
    assert plan[0].iterations[0].spread > 0.05 * SIZE
    assert plan[-1].iterations[-1].spread < 2 * EDGES[-1]


def test_standard_and_its_kin_know_no_unit():
    """All lengths grow with the mesh."""
    for name, preset in PRESETS.items():
        if name == "published":
            continue
        plain, large = stages(preset, EDGES, SIZE), stages(preset, [1e3 * e for e in EDGES], 1e3 * SIZE)
        for one, two in zip(plain, large, strict=True):
            assert [1e3 * i.spread for i in one.iterations] == pytest.approx(
                [i.spread for i in two.iterations]
            )
            for i, j in zip(one.iterations, two.iterations, strict=True):
                assert (i.normal_weight is None) == (j.normal_weight is None)
                if i.normal_weight is not None:
                    assert 1e3 * i.normal_weight == pytest.approx(j.normal_weight)


@pytest.mark.parametrize(
    ("nodes", "counts"),
    [(24_000, [1500, 6000]), (6_000, [1500]), (1_000, []), (100_000, [1500, 6000, 24_000]), (4, [])],
)
def test_levels_without_a_reduction_have_fixed_sizes(nodes, counts):
    assert node_counts(STANDARD, nodes) == counts


def test_levels_with_a_reduction_are_shares():
    chosen = dataclasses.replace(STANDARD, reduction=0.5, levels=3)
    assert node_counts(chosen, 16_000) == [500, 2000, 8000]
    assert node_counts(chosen, 100) == [50]
    assert node_counts(dataclasses.replace(chosen, levels=0), 16_000) == []
    assert node_counts(dataclasses.replace(chosen, reduction=1.0, levels=1), 16_000) == []


def test_what_is_set_is_what_is_done():
    chosen = dataclasses.replace(
        STANDARD,
        correspondence="nearest",
        spread_start=40.0,
        spread_end=2.0,
        spread_decay=0.9,
        step_scale=0.3,
        normal_weight=7.0,
        normal_decay=0.5,
        iterations=5,
    )
    first = stages(chosen, EDGES, SIZE)[0]
    assert first.step_scale == 0.3
    assert [i.spread for i in first.iterations] == pytest.approx(40.0 * 0.9 ** np.arange(5))
    assert [i.normal_weight for i in first.iterations] == pytest.approx(7.0 * 0.5 ** np.arange(5))
    ends = [
        stage.iterations[-1].spread
        for stage in stages(dataclasses.replace(chosen, spread_decay=0.0), EDGES, SIZE)
    ]
    assert ends[-1] == pytest.approx(2.0)
    assert min(ends) >= 2.0


def test_surface_correspondence_looks_at_no_normals():
    for stage in stages(dataclasses.replace(STANDARD, correspondence="surface"), EDGES, SIZE):
        assert all(i.normal_weight is None for i in stage.iterations)
    for stage in stages(dataclasses.replace(STANDARD, correspondence="nearest"), EDGES, SIZE):
        assert all(i.normal_weight is not None for i in stage.iterations)


@settings(max_examples=200, deadline=None)
@given(
    counts=st.tuples(*[st.integers(0, 5)] * 3),
    levels=st.integers(0, 4),
    start=st.sampled_from([0.0, 1e-6, 50.0, 1e6]),
    end=st.sampled_from([0.0, 1e-6, 50.0, 1e6]),
    decays=st.tuples(*[st.sampled_from([0.0, 0.5, 1.0])] * 5),
    kind=st.sampled_from(["mixed", "surface", "nearest"]),
)
def test_any_settings_give_positive_spreads_on_existing_levels(counts, levels, start, end, decays, kind):
    chosen = MorphSettings(
        correspondence=kind,
        levels=levels,
        iterations=counts[0],
        fine_iterations=counts[1],
        dense_iterations=counts[2],
        spread_start=start,
        spread_end=end,
        spread_decay=decays[0],
        fine_spread_decay=decays[1],
        dense_spread_decay=decays[2],
        normal_decay=decays[3],
        fine_normal_decay=decays[4],
    )
    for edges in (EDGES, EDGES[1:], EDGES[2:]):
        plan = stages(chosen, edges, SIZE)
        before = 0
        for stage in plan:
            assert before <= stage.level < len(edges)
            assert stage.iterations
            before = stage.level
            for iteration in stage.iterations:
                assert 0 < iteration.spread < np.inf
                assert iteration.normal_weight is None or 0 <= iteration.normal_weight < np.inf
