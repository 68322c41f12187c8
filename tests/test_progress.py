# SPDX-License-Identifier: GPL-3.0-or-later
"""A morph may be cancelled at any time, and asks whether it is, however long its steps."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from femors_addon import balls, crew, limits, nearest, reduce, relax, shapes, tasks
from femors_addon.morph import MorphSettings, morph
from femors_addon.progress import Cancelled

LAYERED = MorphSettings(levels=2, reduction=0.4, iterations=4, fine_iterations=3)
"""All stages, on meshes of a few hundred nodes."""

BALL = shapes.sphere(2)
SMALL, GOAL = BALL.moved(BALL.vertices * (1.0, 1.3, 1.7)), BALL.moved(BALL.vertices * (1.2, 1.2, 2.0))


def test_cancelling_at_any_call_ends_it_and_leaves_the_meshes():
    told: list[str] = []
    morph(SMALL, GOAL, LAYERED, lambda fraction, text: told.append(text))
    ours, theirs = SMALL.vertices.copy(), GOAL.vertices.copy()
    for last in range(0, len(told), max(len(told) // 25, 1)):
        seen: list[str] = []

        def cancel(fraction, text, seen=seen, last=last):
            seen.append(text)
            if len(seen) > last:
                raise Cancelled

        with pytest.raises(Cancelled):
            morph(SMALL, GOAL, LAYERED, cancel)
        assert seen == told[: last + 1]
    assert np.array_equal(SMALL.vertices, ours)
    assert np.array_equal(GOAL.vertices, theirs)


@pytest.mark.parametrize(
    ("step", "work"),
    [
        ("reduced meshes", (reduce.fast_simplification, "simplify")),
        ("iteration 1 of", (nearest.SurfaceIndex, "_look")),
        ("relaxation", (nearest.SurfaceIndex, "_look")),
        ("relaxation", (relax.ShapeMatching, "move")),
        ("checking for folded faces", (balls.Search, "candidates")),
        ("closest points", (nearest.SurfaceIndex, "_look")),
    ],
    ids=lambda value: value if isinstance(value, str) else value[1],
)
def test_between_two_blocks_of_work_it_asks(step, work, monkeypatch):
    monkeypatch.setattr(nearest, "BLOCK_PAIRS", 1000)
    monkeypatch.setattr(balls, "BLOCK_PAIRS", 300)
    blocks: list[int] = []
    said = [""]
    inner = getattr(*work)

    def noted(*args, **more):
        blocks.append(len(said))
        return inner(*args, **more)

    monkeypatch.setattr(*work, noted)
    morph(SMALL, GOAL, LAYERED, lambda _fraction, text: said.append(text))
    mine = [asked for asked in blocks if step in said[asked - 1]]
    assert len(mine) > 1
    assert len(set(mine)) == len(mine)


@pytest.fixture
def two_threads():
    before = limits.Limits.threads
    limits.allow(2, 0)
    yield
    limits.Limits.threads = before


@pytest.mark.parametrize("threads", [1, 2])
def test_it_reports_from_the_thread_that_began_it_and_never_goes_back(threads, two_threads, monkeypatch):
    """Blender's own functions may be called from its main thread alone."""
    monkeypatch.setattr(nearest, "BLOCK_PAIRS", 1000)
    monkeypatch.setattr(tasks, "LOOK", 1e-4)
    limits.allow(threads, 0)
    callers, fractions = set(), [0.0]

    def told(fraction, _text):
        callers.add(threading.get_ident())
        fractions.append(fraction)

    morph(SMALL, GOAL, LAYERED, told)
    assert callers == {threading.get_ident()}
    assert fractions == sorted(fractions)
    assert 0.99 < fractions[-1] <= 1.0


def test_jobs_in_other_threads_stop_as_they_next_report(two_threads, monkeypatch):
    monkeypatch.setattr(tasks, "LOOK", 1e-3)
    begun, stopped = [], []

    def endless(look):
        begun.append(1)
        try:
            while True:
                look(0.5, "")
        except Cancelled:
            stopped.append(threading.get_ident())
            raise

    def cancel(_fraction, _text):
        if len(begun) == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        crew.at_once(endless, endless, progress=cancel)
    assert len(set(stopped)) == 2


def test_of_two_jobs_that_fail_the_first_is_told(two_threads):
    later = threading.Event()

    def first(_look):
        later.wait()
        raise KeyError

    def second(_look):
        later.set()
        raise IndexError

    with pytest.raises(KeyError):
        crew.at_once(first, second)
