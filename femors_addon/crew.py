# SPDX-License-Identifier: GPL-3.0-or-later
"""Threads that stay for the whole of a job, and share what can be done side by side, parts within parts too.

`limits.in_threads` begins threads for each call and takes blocks of one long piece of work. A removal is
thousands of pieces of some milliseconds, one within another: here a piece is offered to the others, and
done by whoever offered it where nobody has taken it by then. Who waits for a piece takes others meanwhile: so
nobody waits for what has not begun, and there are never more threads at work than are allowed.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import islice
from typing import Any, TypeVar

from . import limits

R = TypeVar("R")
T = TypeVar("T")
Job = Callable[[], R]

BLOCK = 20_000  # rows: some 20 ms of a search

_here = threading.local()  # `crew` is that of the thread


@contextmanager
def crew() -> Iterator[None]:
    """Keep as many threads as are allowed, this one included, for `each`, `together` and `ordered`."""
    count = limits.Limits.threads - 1
    if count < 1 or getattr(limits.within, "thread", False) or getattr(_here, "crew", None):
        yield
        return
    own = _Crew()
    threads: list[threading.Thread] = []
    _here.crew = own
    limits.within.thread = True  # blocks within a piece are done one after the other
    try:
        for number in range(count):
            thread = threading.Thread(target=own.serve, name=f"femors-{number}")
            thread.start()
            threads.append(thread)
        yield
    finally:
        limits.within.thread = False
        _here.crew = None
        own.close()
        for thread in threads:
            thread.join()


def each(jobs: Sequence[Job[R]]) -> Generator[R]:
    """Yield what each job returns, in their order; none may need what another writes.

    Without a crew they go to the threads of `limits.in_threads`.

    The consumer may raise, `Cancelled` for instance: jobs that have not begun are dropped, and those that
    have are waited for. The same holds where a job raises.
    """
    mine: _Crew | None = getattr(_here, "crew", None)
    if mine is None or len(jobs) < 2:
        yield from limits.in_threads(lambda job: job(), jobs)
        return
    tasks = [_Task(job) for job in jobs]
    mine.offer(tasks[:0:-1])  # the last is taken first by the others, the first by this thread
    try:
        for task in tasks:
            if task is tasks[0] or mine.claim(task):
                task.run()
            yield mine.outcome(task)
    finally:
        for task in tasks[1:]:
            if not mine.claim(task):
                task.done.wait()


def together(jobs: Sequence[Job[R]]) -> list[R]:
    """Return what each job returns; see `each`."""
    return list(each(jobs))


def over(work: Callable[[T], R], parts: Iterable[T]) -> Iterator[R]:
    """Yield what the work returns for each part, in order: with the crew, or in threads without one.

    Parts may be endless or large: no more are begun than `limits.AHEAD` for each thread.
    """
    if getattr(_here, "crew", None) is None:
        yield from limits.in_threads(work, parts)
        return
    parts = iter(parts)
    while some := list(islice(parts, limits.AHEAD * limits.Limits.threads)):
        yield from each([partial(work, part) for part in some])


def in_blocks(work: Callable[[slice], R], count: int) -> list[R]:
    """Return what the work returns for each block of so many rows; of one, empty, where there are none.

    The blocks are the same for any number of threads.
    """
    starts = range(0, max(count, 1), BLOCK)
    return together([partial(work, slice(start, start + BLOCK)) for start in starts])


def ordered(jobs: Sequence[Job[R]], needs: Sequence[Collection[int]]) -> list[R]:
    """Return what each job returns, each begun when those that it needs, which stand before it, are done."""
    mine: _Crew | None = getattr(_here, "crew", None)
    if mine is None or len(jobs) < 2:
        return [job() for job in jobs]
    return _Order(mine, jobs, needs).results()


class _Task:
    """A job, what it returned or raised, and whether it is done."""

    def __init__(self, job: Job[Any]) -> None:
        self.job, self.done = job, threading.Event()
        self.value: Any = None
        self.error: BaseException | None = None

    def run(self) -> None:
        try:
            self.value = self.job()
        except BaseException as error:  # it is raised where the job was asked for
            self.error = error
        finally:
            self.done.set()

    def outcome(self) -> Any:
        self.done.wait()
        if self.error is not None:
            raise self.error
        return self.value


class _Crew:
    """What is offered, and the threads that take it."""

    def __init__(self) -> None:
        self._offers: deque[_Task] = deque()
        self.changed = threading.Condition()
        self._open = True

    def offer(self, tasks: Sequence[_Task]) -> None:
        """Offer tasks to whoever is idle; the first is taken first."""
        with self.changed:
            self._offers.extend(reversed(tasks))
            self.changed.notify_all()

    def claim(self, task: _Task) -> bool:
        """Take a task back; whether nobody else has it."""
        with self.changed:
            if task not in self._offers:
                return False
            self._offers.remove(task)
            return True

    def take(self) -> _Task | None:
        """Take what was offered last, if anything is; call with `changed` held."""
        return self._offers.pop() if self._offers else None

    def do(self, task: _Task) -> None:
        """Run a task that somebody else may wait for."""
        task.run()
        with self.changed:
            self.changed.notify_all()

    def outcome(self, task: _Task) -> Any:
        """Return what a task has given, and do meanwhile what others offer: parts of that task, often.

        What is waited for is a part of what waits, and began later: no two threads wait for each other.
        """
        while not task.done.is_set():
            with self.changed:
                other = self.take()
                while other is None and not task.done.is_set():
                    self.changed.wait()
                    other = self.take()
            if other is not None:
                self.do(other)
        return task.outcome()

    def serve(self) -> None:
        """Work on what is offered until the crew is closed; then nobody waits for what is left."""
        _here.crew = self
        limits.within.thread = True
        while True:
            with self.changed:
                while self._open and not self._offers:
                    self.changed.wait()
                task = self.take() if self._open else None
            if task is None:
                return
            self.do(task)

    def close(self) -> None:
        """Send the threads home; what nobody has taken is dropped."""
        with self.changed:
            self._open = False
            self.changed.notify_all()


class _Order:
    """Jobs of which some need others."""

    def __init__(self, mine: _Crew, jobs: Sequence[Job[R]], needs: Sequence[Collection[int]]) -> None:
        self._crew, self._left = mine, len(jobs)
        self._needs = [set(need) for need in needs]
        self._failed = False
        self._tasks = [_Task(partial(self._run, number, job)) for number, job in enumerate(jobs)]

    def results(self) -> list[Any]:
        """Work until all is done."""
        mine = self._crew
        mine.offer([task for task, need in zip(self._tasks, self._needs, strict=True) if not need])
        while True:
            with mine.changed:
                task = mine.take()
                while self._left and task is None:
                    mine.changed.wait()
                    task = mine.take()
            if task is None:
                break
            mine.do(task)
        return [task.outcome() for task in self._tasks]

    def _run(self, number: int, job: Job[R]) -> R | None:
        """Do a job, unless one has failed; then offer those that waited for it alone."""
        try:
            return None if self._failed else job()
        except BaseException:
            self._failed = True
            raise
        finally:
            with self._crew.changed:
                free = [n for n, need in enumerate(self._needs) if number in need and len(need) == 1]
                for need in self._needs:
                    need.discard(number)
                self._left -= 1
            self._crew.offer([self._tasks[n] for n in free])
