# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs that are put aside: they fill the gaps of the rest, and nothing else."""

from __future__ import annotations

import threading
import time

import pytest
from crewcases import three_threads, who

from femors_addon import limits
from femors_addon import morph as morph_module
from femors_addon.crew import aside, crew, ordered, over, together
from femors_addon.morph import morph
from femors_addon.progress import Cancelled
from femors_addon.shapes import pair
from femors_addon.tasks import Task, Threads, here


@pytest.fixture(autouse=True)
def threads():
    with three_threads():
        yield


def test_a_job_aside_is_done_when_it_is_asked_for_where_one_thread_is_allowed():
    limits.allow(1, 0)
    done = []
    with crew(), aside(lambda _progress: done.append(threading.current_thread())) as wait:
        assert not done
        wait()
        assert done == [threading.current_thread()]
    with crew(), aside(lambda _progress: done.clear()):  # nobody asks
        pass
    assert done


def test_a_job_aside_that_nobody_has_taken_reports_and_may_be_cancelled():
    busy, go_on = [], threading.Event()

    def cancelling(fraction, text):
        raise Cancelled

    def hold() -> None:
        busy.append(1)
        assert go_on.wait(10)

    def ask() -> None:
        while len(busy) < limits.Limits.threads - 1:
            time.sleep(0.001)
        with aside(lambda progress: progress(0.5, "half"), cancelling) as wait, pytest.raises(Cancelled):
            wait()
        go_on.set()

    for threads in (1, 3):
        limits.allow(threads, 0)
        busy.clear()
        go_on.clear()
        with crew():
            together([ask] + [hold] * (threads - 1))


def test_a_job_aside_begins_beside_the_rest_which_takes_parts_of_it():
    limits.allow(2, 0)
    begun, go_on = threading.Event(), threading.Event()

    def job(_progress):
        begun.set()
        assert go_on.wait(10)
        return list(over(who, range(30)))

    with crew(), aside(job) as wait:
        assert begun.wait(10)
        assert list(over(who, range(4))) == [threading.current_thread()] * 4  # the other is at the job
        go_on.set()
        parts = wait()
    assert len(set(parts)) == 2 and threading.current_thread() in parts


def test_what_is_offered_comes_before_what_is_aside():
    limits.allow(2, 0)
    done, busy, go_on = [], threading.Event(), threading.Event()

    def first() -> None:
        assert busy.wait(10)
        with aside(lambda _: done.append("aside")) as wait:
            here = threading.get_ident()

            def piece(n):
                go_on.set()
                time.sleep(0.005)
                done.append(n)
                return threading.get_ident() == here

            assert not all(over(piece, range(6)))
            wait()

    def second() -> None:
        busy.set()
        assert go_on.wait(10)  # until pieces are there

    with crew():
        together([first, second])
    assert done.index("aside") >= 5


def test_who_is_at_a_job_aside_takes_what_is_offered_whenever_it_reports():
    limits.allow(2, 0)
    begun, done, both = threading.Event(), threading.Event(), threading.Barrier(2)

    def job(progress):
        begun.set()
        while not done.is_set():
            progress(0.5, "")
        return list(over(who, range(4)))

    with crew(), aside(job) as wait:
        assert begun.wait(10)
        together([lambda: both.wait(10)] * 2)  # two at once, or this raises
        done.set()
        assert len(wait()) == 4


def test_whether_it_is_aside_goes_with_a_piece_to_whoever_does_it():
    limits.allow(2, 0)
    begun, done, both, main = threading.Event(), threading.Event(), threading.Barrier(2), who()
    met: dict[str, set[tuple[bool, bool]]] = {"job": set(), "piece": set(), "part": set()}

    def note(name: str) -> None:
        met[name].add((who() is main, here.aside))

    def job(progress):
        note("job")
        begun.set()
        while not done.is_set():
            progress(0.5, "")
        note("job")
        list(over(lambda _: note("part"), range(30)))

    def piece() -> None:
        both.wait(10)  # one is done here, the other where the job reports
        note("piece")

    with crew(), aside(job) as wait:
        assert begun.wait(10)
        together([piece] * 2)
        done.set()
        wait()
    assert met["job"] == {(False, True)}
    assert met["piece"] == {(True, False), (False, False)}
    assert met["part"] == {(True, True), (False, True)}


def test_parts_of_a_job_aside_come_last():
    mine, first, second, third = Threads(), Task(len), Task(len, aside=True), Task(len)
    mine.offer([first, second, third])
    with mine.changed:
        assert (mine.take(), mine.take(), mine.take()) == (third, first, None)
        assert mine.take(later=True) is second


def test_who_has_nothing_to_do_takes_parts_of_a_job_aside():
    both, done = threading.Barrier(2), threading.Event()  # of three threads, this one waits for the event

    def job(_progress):
        list(over(lambda _: both.wait(10), range(2)))
        done.set()

    with crew(), aside(job) as wait:
        assert done.wait(10)
        wait()


def test_who_waits_for_a_job_aside_begins_no_other():
    limits.allow(2, 0)
    begun, both, ran = threading.Event(), threading.Event(), []

    def second(_progress):
        begun.set()
        assert both.wait(10)
        time.sleep(0.05)

    with crew(), aside(second) as wait:
        assert begun.wait(10)  # the other thread has it, and nobody the next
        with aside(lambda _progress: ran.append(threading.current_thread())):
            both.set()
            wait()
            assert threading.current_thread() not in ran  # it would report to nobody meanwhile


def test_jobs_in_order_within_a_job_aside_are_done_where_nobody_helps():
    limits.allow(2, 0)
    begun, ended = threading.Event(), []

    def job(_progress):
        begun.set()
        ended.append(ordered([lambda: 1, lambda: 2, lambda: 3], [(), (), (0,)]))

    def whole() -> None:
        with crew(), pytest.raises(ZeroDivisionError), aside(job):
            assert begun.wait(10)
            raise ZeroDivisionError  # this thread only waits for it to end

    thread = threading.Thread(target=whole, daemon=True)
    thread.start()
    thread.join(10)
    assert ended == [[1, 2, 3]] and not thread.is_alive()


def test_a_job_aside_is_stopped_where_the_rest_fails_and_its_own_failure_is_told():
    limits.allow(2, 0)
    looks = []

    def endless(progress):
        while True:
            looks.append(None)
            progress(0.5, "")

    with crew():
        with pytest.raises(ZeroDivisionError), aside(endless):
            while not looks:
                pass
            raise ZeroDivisionError
        seen = len(looks)
        time.sleep(0.01)
        assert len(looks) == seen  # it has ended

        with aside(lambda _progress: 1 // 0) as wait, pytest.raises(ZeroDivisionError):
            wait()


def test_a_morph_measures_beside_its_iterations_and_ends_both_when_it_is_cancelled(monkeypatch):
    bones = pair(2000, 2000, 3)
    where, main = [], threading.current_thread()
    whole = morph_module.compared_before

    def noted(*args):
        where.append(threading.current_thread())
        return whole(*args)

    monkeypatch.setattr(morph_module, "compared_before", noted)
    for threads, beside in ((1, False), (2, True)):
        limits.allow(threads, 0)
        morph(bones.source, bones.target)
        assert (where.pop() is not main) == beside

    def cancelling(_fraction, text):
        if "iteration 3" in text:
            raise Cancelled

    with pytest.raises(Cancelled):
        morph(bones.source, bones.target, progress=cancelling)
    assert not where[0].is_alive()
