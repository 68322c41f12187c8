# SPDX-License-Identifier: GPL-3.0-or-later
"""Threads that share pieces of work: no more than allowed, nothing lost, and no bit changed."""

from __future__ import annotations

import itertools
import signal
import threading
import time
from contextlib import nullcontext
from functools import partial

import numpy as np
import pytest
from solids import hexes

from femors_addon import limits, overclosure
from femors_addon.crew import AHEAD, crew, each, ordered, over, together
from femors_addon.mesh import Surface
from femors_addon.overclosure import Body, OverclosureSettings, check_overclosure, remove_overclosure
from femors_addon.progress import Cancelled
from femors_addon.shapes import sphere


@pytest.fixture(autouse=True)
def restored(monkeypatch):
    monkeypatch.setattr(overclosure, "LARGE", 0)  # threads for small bodies too
    before = limits.Limits.threads, limits.Limits.memory
    yield
    limits.Limits.threads, limits.Limits.memory = before
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("femors-")]


def nested(depth: int, number: int) -> list[int]:
    """Pieces within pieces, their numbers in order."""
    time.sleep(0.001)
    if not depth:
        return [number, threading.get_ident()]
    parts = together([partial(nested, depth - 1, 3 * number + i) for i in range(3)])
    return [*itertools.chain(*parts)]


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_pieces_within_pieces_keep_their_order_and_no_more_threads_work_than_allowed(threads):
    limits.allow(threads, 0)
    with crew():
        found = nested(3, 0)
    assert found[::2] == list(range(27))
    assert len(set(found[1::2])) == threads


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_what_is_needed_is_done_before(threads):
    limits.allow(threads, 0)
    needs = [(), (), (0,), (1,), (2, 3), (0,), (5,), (4, 6)]
    done: list[int] = []

    def job(number: int) -> int:
        assert set(needs[number]) <= set(done)
        assert threading.get_ident() == main or threads > 1
        time.sleep(0.002)
        done.append(number)
        return number**2

    main = threading.get_ident()
    for _ in range(5):
        done.clear()
        with crew():
            assert ordered([partial(job, n) for n in range(8)], needs) == [n**2 for n in range(8)]


@pytest.mark.parametrize("threads", [1, 2])
def test_who_raises_is_heard_and_nothing_goes_on(threads):
    limits.allow(threads, 0)
    begun = []

    def job(number: int) -> int:
        begun.append(number)
        time.sleep(0.005)
        if number == 2:
            raise ValueError("two")
        return number

    jobs = [partial(job, n) for n in range(40)]
    with crew():
        with pytest.raises(ValueError, match="two"):
            together(jobs)
        count = len(begun)
        time.sleep(0.02)
        assert len(begun) == count < 40
        with pytest.raises(ValueError, match="two"):
            ordered(jobs[:10], [() if n < 3 else (2,) for n in range(10)])
        assert together(jobs[:2]) == [0, 1]  # the crew goes on
    begun.clear()
    with pytest.raises(Cancelled), crew():
        for number in each(jobs[3:]):
            if number == 5:
                raise Cancelled
    assert len(begun) < 37


def test_who_leaves_the_crew_leaves_nothing_behind():
    limits.allow(2, 0)
    begun = []

    def job(number: int) -> None:
        begun.append(number)
        time.sleep(0.005)
        if number == 0:
            raise KeyboardInterrupt

    def chain() -> None:
        ordered([partial(job, n) for n in range(50)], [() if n < 2 else (n - 2,) for n in range(50)])

    with pytest.raises(KeyboardInterrupt), crew():
        chain()
    count = len(begun)
    time.sleep(0.02)
    assert len(begun) == count < 50


def test_who_waits_for_a_piece_takes_parts_of_it():
    limits.allow(2, 0)
    begun = threading.Event()

    def part(_: int) -> int:
        time.sleep(0.002)
        return threading.get_ident()

    def short() -> int:
        assert begun.wait(10)  # until the other thread has the long one
        return threading.get_ident()

    def long() -> list[int]:
        begun.set()
        return [threading.get_ident(), *over(part, range(40))]

    with crew():
        here, (there, *parts) = together([short, long])
    assert here == threading.get_ident() != there
    assert set(parts) == {here, there}


def test_who_raises_waits_for_what_has_begun():
    limits.allow(2, 0)
    begun, ended = threading.Event(), threading.Event()

    def raising() -> None:
        assert begun.wait(10)
        raise ValueError("one")

    def long() -> None:
        begun.set()
        time.sleep(0.02)
        ended.set()

    with crew():
        with pytest.raises(ValueError, match="one"):
            together([raising, long])
        assert ended.is_set()


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_parts_of_long_work_keep_their_order_and_few_are_begun(threads):
    limits.allow(threads, 0)
    for outside in (nullcontext, crew):
        asked = []
        parts = (asked.append(n) or n for n in itertools.count())
        with outside():
            found = []
            for square in over(lambda n: n**2, parts):
                found.append(square)
                assert len(asked) <= len(found) + AHEAD * threads + 1
                if len(found) == 50:
                    break
        assert found == [n**2 for n in range(50)]


def test_without_a_crew_there_is_one_for_as_long_as_it_is_asked():
    limits.allow(2, 0)
    before = threading.active_count()
    seen = set(together([lambda: time.sleep(0.002) or threading.get_ident()] * 20))
    assert len(seen) == 2 and threading.get_ident() in seen
    assert threading.active_count() == before


def test_who_stops_listening_leaves_no_thread_behind():
    limits.allow(2, 0)
    begun: list[int] = []

    def work(part: int) -> int:
        begun.append(part)
        time.sleep(0.002)
        return part

    def listen(error: type[BaseException]) -> None:
        for part in over(work, itertools.count()):
            if part == 5:
                raise error

    for outside in (nullcontext, crew):
        with outside():
            for error in (Cancelled, KeyboardInterrupt):
                begun.clear()
                with pytest.raises(error):
                    listen(error)
                count = len(begun)
                assert count < 20
                time.sleep(0.01)
                assert len(begun) == count
            assert together([lambda: 1, lambda: 2]) == [1, 2]


def test_a_search_within_a_piece_starts_no_threads():
    limits.allow(2, 0)
    with crew():
        before = threading.active_count()
        seen = together([lambda: [threading.active_count(), *over(lambda _: 0, range(9))][0]] * 4)
        assert set(seen) == {before}


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no signals for single threads")
def test_ctrl_c_ends_a_chain_in_another_thread_too():
    limits.allow(2, 0)
    both, done = threading.Barrier(2), []

    def job(number: int) -> None:
        done.append(number)
        if number < 2:  # one for each thread; whoever has the second goes on with the chain
            both.wait(5.0)
        if number == 3:
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        time.sleep(0.05)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job is deaf to it
    try:
        with pytest.raises(KeyboardInterrupt), crew():
            ordered([partial(job, n) for n in range(40)], [() if n < 2 else (n - 1,) for n in range(40)])
    finally:
        # None: Blender's own handler, in C, which Python can neither name nor set again
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
    assert len(done) < 12


# --- removals -------------------------------------------------------------------------------------------
def many() -> list[Body]:
    """A plate pressed between two balls, one of them rigid, a third ball in one of these, and one apart."""
    return [
        Body("below", sphere(3, radius=10.0), 0.0),
        Body("above", sphere(3, radius=10.0, centre=(0.0, 0.0, 22.2))),
        Body("plate", hexes((12, 12, 3), (18, 18, 3), centre=(0, 0, 11.1))),
        Body("beside", sphere(3, radius=6.0, centre=(15.3, 0.0, 22.2))),
        Body("apart", sphere(3, radius=6.0, centre=(60.0, 0.0, 0.0))),
    ]


@pytest.mark.parametrize("soup", [False, True])
@pytest.mark.parametrize("large", [0, 700, 8000])
def test_small_bodies_are_for_one_thread(large, soup, monkeypatch):
    """Their pieces are over sooner than they are handed over: 13 bones of a wrist took half as long again."""
    limits.allow(2, 0)
    monkeypatch.setattr(overclosure, "LARGE", large)
    begun, start = [], threading.Thread.start
    monkeypatch.setattr(threading.Thread, "start", lambda thread: (begun.append(thread), start(thread))[1])
    balls = [sphere(3, radius=10.0, centre=(19.0 * n, 0.0, 0.0)) for n in range(2)]
    assert len(balls[0].vertices) == 642
    if soup:  # as STL has it: three corners a face
        balls = [Surface(b.corners.reshape(-1, 3), np.arange(3 * len(b.faces)).reshape(-1, 3)) for b in balls]
    balls = [Body(f"ball{n}", ball) for n, ball in enumerate(balls)]
    remove_overclosure(balls)
    check_overclosure(balls)
    assert len(begun) == (2 if large == 0 else 0)
    assert list(over(lambda part: part, range(3))) == [0, 1, 2] and len(begun) == (3 if large == 0 else 1)


def test_threads_change_no_bit_of_many_bodies_and_no_figure():
    found = []
    for threads in (1, 2, 3):
        limits.allow(threads, 0)
        said: list[str] = []
        result = remove_overclosure(many(), progress=lambda f, text, said=said: said.append(text))
        report = result.report()
        del report["cpu_seconds"], report["solve_cpu_seconds"]
        found.append((report, said, np.concatenate([body.nodes for body in result.bodies])))
    assert found[0][0]["certified"]
    assert len(found[0][0]["pairs"]["before"]) == 3
    for report, said, nodes in found[1:]:
        assert report == found[0][0]
        assert said == found[0][1]
        np.testing.assert_array_equal(nodes, found[0][2])


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("at", [1, 3, 11, 12, 14])
def test_a_removal_in_threads_is_cancelled_wherever_it_is(threads, at):
    limits.allow(threads, 0)
    calls = []

    def progress(fraction: float, text: str) -> None:
        calls.append(text)
        if len(calls) == at:
            raise Cancelled

    with pytest.raises(Cancelled):
        remove_overclosure(many(), OverclosureSettings(), progress)
    assert len(calls) == at
    calls.clear()
    if at < 10:
        with pytest.raises(Cancelled):
            check_overclosure(many(), progress=progress)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_removal_is_cancelled_while_its_figures_are_measured(threads):
    limits.allow(threads, 0)
    told = []

    def progress(fraction: float, text: str) -> None:
        told.append(fraction)
        if text == "figures of plate":
            raise Cancelled

    with pytest.raises(Cancelled):
        remove_overclosure(many(), progress=progress)
    assert told == sorted(told) and 0.9 < told[-1] < 1.0


@pytest.mark.parametrize("most", [0, 1])
def test_where_the_system_refuses_threads_fewer_do_the_work(most, monkeypatch):
    limits.allow(3, 0)
    begun, start = [], threading.Thread.start

    def refuse(thread):
        if len(begun) == most:
            raise RuntimeError("can't start new thread")
        begun.append(thread)
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", refuse)
    with crew():
        assert list(over(lambda part: part * part, range(20))) == [part * part for part in range(20)]
    assert len(begun) == most and not any(thread.is_alive() for thread in begun)
