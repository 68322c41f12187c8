# SPDX-License-Identifier: GPL-3.0-or-later
"""Threads that stay for a whole job: as many as allowed, fit for work after a cancel, gone at its end."""

from __future__ import annotations

import threading
import time

import pytest

from femors_addon import limits
from femors_addon.progress import Cancelled


@pytest.fixture(autouse=True)
def three_threads():
    before = limits.Limits.threads, limits.Limits.memory
    limits.allow(3, 0)
    yield
    limits.Limits.threads, limits.Limits.memory = before


def who(_part: int = 0) -> threading.Thread:
    time.sleep(0.002)  # for the others to take a part
    return threading.current_thread()  # kept: numbers come again


def test_they_are_begun_once_and_gone_at_the_end():
    before = threading.active_count()
    with limits.pooled():
        met = {thread for _ in range(20) for thread in limits.in_threads(who, range(6))}
        met |= set(limits.at_once(*[lambda _: who()] * 6))
        assert 1 < len(met) <= 3 and threading.current_thread() not in met
        assert threading.active_count() <= before + 3
    assert threading.active_count() == before
    assert threading.current_thread() not in set(
        limits.in_threads(who, range(6))
    )  # others, for this call alone
    assert threading.active_count() == before


def test_one_part_is_done_where_it_is_asked_for():
    with limits.pooled():
        assert list(limits.in_threads(who, iter([1]))) == [threading.current_thread()]
        assert list(limits.in_threads(who, [])) == []


def test_who_stops_listening_waits_for_what_has_begun_and_drops_the_rest():
    done: list[int] = []

    def work(part: int) -> int:
        time.sleep(0.01)
        done.append(part)
        return part

    with limits.pooled():
        with pytest.raises(Cancelled):
            for part in limits.in_threads(work, range(1000)):
                if part == 3:
                    raise Cancelled
        count = len(done)
        assert count < 50
        assert list(limits.in_threads(work, range(4))) == [0, 1, 2, 3]  # fit for work
        assert len(done) == count + 4  # and nothing of the others came after


def test_jobs_at_once_have_ended_when_a_cancel_is_told():
    ended: list[int] = []

    def job(progress):
        try:
            for _ in range(100):
                time.sleep(0.02)
                progress(0.0, "")
        finally:
            time.sleep(0.05)
            ended.append(1)

    def cancel(_fraction, _text):
        raise Cancelled

    with limits.pooled():
        with pytest.raises(Cancelled):
            limits.at_once(job, job, progress=cancel)
        assert ended == [1, 1]


def test_a_part_that_fails_is_told_and_the_threads_stay():
    def work(part: int) -> float:
        return 1 / (part - 2)

    with limits.pooled():
        with pytest.raises(ZeroDivisionError):
            list(limits.in_threads(work, range(100)))
        with pytest.raises(ZeroDivisionError):
            limits.at_once(lambda _: 1 / 0, lambda _: 2)
        assert list(limits.in_threads(work, [3, 4])) == [1.0, 0.5]


def test_beside_a_job_aside_there_are_no_more_than_allowed():
    held = threading.Event()
    most, lock, running = [0], threading.Lock(), [0]

    def work(_part: int) -> None:
        with lock:
            running[0] += 1
            most[0] = max(most[0], running[0])
        time.sleep(0.005)
        with lock:
            running[0] -= 1

    with limits.pooled(), limits.aside(lambda _: held.wait(10)) as waiting:
        while not limits.Limits.aside:
            time.sleep(0.001)
        list(limits.in_threads(work, range(12)))
        held.set()
        assert waiting()
    assert most[0] == 2
