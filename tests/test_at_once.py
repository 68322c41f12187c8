# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs side by side that report and may be cancelled: who is heard, who is stopped, and that all end."""

from __future__ import annotations

import threading
import time

import pytest
from crewcases import three_threads, who

from femors_addon import limits
from femors_addon.crew import at_once, crew, over, together
from femors_addon.progress import Cancelled


@pytest.fixture(autouse=True)
def threads():
    with three_threads():
        yield


def test_threads_are_begun_once_and_gone_at_the_end():
    before = threading.active_count()
    with crew():
        met = {thread for _ in range(20) for thread in over(who, range(6))}
        met |= set(at_once(*[lambda _: who()] * 6))
        assert 1 < len(met) <= 3 and threading.current_thread() in met
        assert threading.active_count() <= before + 2
    assert threading.active_count() == before
    assert not (set(over(who, range(6))) - {threading.current_thread()}) & met  # others, for this call alone
    assert threading.active_count() == before


def test_one_part_is_done_where_it_is_asked_for():
    for threads in (1, 3):
        limits.allow(threads, 0)
        with crew():
            assert list(over(who, iter([1]))) == [threading.current_thread()]
            assert list(over(who, [])) == []


# --- at once --------------------------------------------------------------------------------------------
def test_jobs_at_once_are_done_one_after_the_other_of_one_thread():
    limits.allow(1, 0)
    told: list[int] = []
    jobs = [lambda progress, n=n: progress(0.0, "") or n for n in range(4)]
    assert at_once(*jobs, progress=lambda *_: told.append(1)) == [0, 1, 2, 3]
    assert len(told) == 4


def test_only_the_thread_that_asked_is_heard():
    heard = set()

    def job(progress):
        for _ in range(30):
            time.sleep(0.002)
            progress(0.0, "")
        return threading.get_ident()

    def nested(progress):
        return set(at_once(job, job, progress=progress))

    for jobs in ([job] * 5, [nested] * 3):
        heard.clear()
        done = at_once(*jobs, progress=lambda *_: heard.add(threading.get_ident()))
        assert len(done) == len(jobs)
        assert heard == {threading.get_ident()}


def test_who_waits_looks_now_and_then():
    """The last job in another thread may be long."""
    begun, told, calls = threading.Event(), threading.Event(), []

    def progress(_fraction, _text):
        calls.append(1)
        if len(calls) == 3:
            told.set()

    limits.allow(2, 0)
    at_once(lambda _: begun.wait(10), lambda _: begun.set() or told.wait(10), progress=progress)
    assert told.is_set()


def test_jobs_at_once_have_ended_when_a_cancel_is_told():
    begun, ended = [], []

    def job(progress):
        begun.append(1)
        try:
            for _ in range(100):
                time.sleep(0.02)
                progress(0.0, "")
        finally:
            time.sleep(0.05)
            ended.append(1)

    def cancel(_fraction, _text):
        if len(begun) == 2:
            raise Cancelled

    with crew():
        with pytest.raises(Cancelled):
            at_once(job, job, progress=cancel)
        assert ended == begun == [1, 1]


@pytest.mark.parametrize("error", [Cancelled, KeyboardInterrupt])
def test_who_is_told_to_stop_while_it_waits_stops_the_others(error):
    """The job in the other thread only ends when it is told to."""
    limits.allow(2, 0)
    begun, ended = threading.Event(), []

    def endless(progress):
        begun.set()
        try:
            while True:
                progress(0.0, "")
                time.sleep(0.001)
        finally:
            ended.append(1)

    def stop(_fraction, _text):
        if begun.is_set():
            raise error

    with pytest.raises(error):
        at_once(lambda _: begun.wait(10), endless, progress=stop)
    assert ended == [1]


def test_who_helps_with_another_thread_s_jobs_at_once_is_heard_too():
    limits.allow(2, 0)
    begun, told = threading.Event(), []

    def long(progress):
        for _ in range(1000):
            time.sleep(0.002)
            progress(0.0, "")

    def nested(progress):
        begun.set()
        at_once(long, long, progress=progress)

    def cancel(_fraction, _text):
        told.append(threading.get_ident())
        if len(told) == 20:
            raise Cancelled

    with pytest.raises(Cancelled):
        at_once(lambda _: begun.wait(10), nested, progress=cancel)
    assert told == [threading.get_ident()] * 20


def test_why_a_job_failed_is_told_as_of_one_thread():
    def fails(_progress):
        try:
            raise FileNotFoundError
        except FileNotFoundError as error:
            raise ValueError from error

    for threads in (1, 2):
        limits.allow(threads, 0)
        with pytest.raises(ValueError) as told:
            at_once(fails, lambda _: time.sleep(0.01))
        assert isinstance(told.value.__cause__, FileNotFoundError)


def test_the_job_that_fails_is_told_and_the_others_are_stopped():
    begun = threading.Event()

    def fails(_progress):
        assert begun.wait(10)
        return 1 / 0

    def endless(progress):
        begun.set()
        while True:
            progress(0.0, "")
            time.sleep(0.001)

    for jobs in ((endless, fails), (fails, endless)):
        begun.clear()
        with crew():
            with pytest.raises(ZeroDivisionError):
                at_once(*jobs)
            assert together([lambda: 1, lambda: 2]) == [1, 2]  # fit for work
