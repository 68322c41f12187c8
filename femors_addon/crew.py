# SPDX-License-Identifier: GPL-3.0-or-later
"""Threads that stay for the whole of a job, and share what can be done side by side, parts within parts too.

A piece of work is offered to the others, and done by whoever offered it where nobody has taken it by then.
Who waits for a piece takes others meanwhile: so nobody waits for what has not begun, and there are never
more threads at work than are allowed. Results are the same for any number of threads, as long as no piece
needs what another writes.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import chain, islice
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from .limits import Limits
from .progress import Cancelled, Progress, silent

R = TypeVar("R")
T = TypeVar("T")
Job = Callable[[], R]

AHEAD = 2  # parts for each thread that are begun before the first is done: no more are held in memory
BLOCK = 20_000  # rows: some 20 ms of a search
LOOK = 0.05  # seconds between two looks at whether jobs in other threads are to be cancelled

# `crew` is that of the thread; `alone`, whether it wants none; `aside`, whether its job is one put aside
_here = threading.local()


@contextmanager
def crew(worth: bool = True) -> Iterator[_Crew | None]:
    """Keep as many threads as are allowed, this one included, and give them, if there are several.

    Within a crew there is no other. Where the system refuses a thread, there are fewer; where it is not
    `worth` it, for all pieces are over sooner than they are handed to another thread, this one is alone.
    """
    mine: _Crew | None = getattr(_here, "crew", None)
    if mine or Limits.threads < 2 or getattr(_here, "alone", False):
        yield mine
        return
    if not worth:
        _here.alone = True
        try:
            yield None
        finally:
            _here.alone = False
        return
    own = _Crew()
    threads: list[threading.Thread] = []
    _here.crew = own
    try:
        for number in range(Limits.threads - 1):
            thread = threading.Thread(target=own.serve, name=f"femors-{number}", daemon=True)
            try:
                thread.start()
            except RuntimeError:
                break
            threads.append(thread)
        yield own
    finally:
        if getattr(_here, "crew", None) is own:  # a generator may be closed by another thread
            _here.crew = None
        own.close()
        for thread in threads:
            thread.join()


def each(jobs: Sequence[Job[R]]) -> Generator[R]:
    """Yield what each job returns, in their order; none may need what another writes.

    The consumer may raise, `Cancelled` for instance: jobs that have not begun are dropped, and those that
    have are waited for. The same holds where a job raises.
    """
    return over(lambda job: job(), jobs, len(jobs))


def together(jobs: Sequence[Job[R]]) -> list[R]:
    """Return what each job returns; see `each`."""
    return list(each(jobs))


def over(work: Callable[[T], R], parts: Iterable[T], ahead: int = 0) -> Generator[R]:
    """Yield what the work returns for each part, in order; see `each`.

    Parts may be endless or large: no more are begun than `ahead`, `AHEAD` for each thread if 0. Without a
    crew there is one for as long as this lasts.
    """
    parts = iter(parts)
    first = list(islice(parts, 2))
    if len(first) < 2:
        yield from map(work, first)
        return
    with crew() as mine:
        if mine is None:
            yield from map(work, chain(first, parts))
        else:
            yield from _over(mine, work, chain(first, parts), ahead or AHEAD * Limits.threads)


def in_blocks(work: Callable[[slice], R], count: int) -> list[R]:
    """Return what the work returns for each block of so many rows; of one, empty, where there are none.

    The blocks are the same for any number of threads.
    """
    starts = range(0, max(count, 1), BLOCK)
    return together([partial(work, slice(start, start + BLOCK)) for start in starts])


def blockwise(work: Callable[[slice], NDArray], count: int) -> NDArray:
    """Return what the work returns for each block of rows, one below the other; see `in_blocks`."""
    return np.concatenate(in_blocks(work, count))


def at_once(*jobs: Callable[[Progress], Any], progress: Progress = silent) -> list[Any]:
    """Return what each job returns; none may need what another writes.

    This thread alone reports to `progress`, now and then; where it is told to cancel, or a job fails, the
    others stop as they next report. What is reported has to be the same each time, see `progress.repeating`.
    """
    with crew() as mine:
        if mine is None:
            return [job(progress) for job in jobs]
        return _at_once(mine, jobs, progress)


def _at_once(mine: _Crew, jobs: Sequence[Callable[[Progress], Any]], progress: Progress) -> list[Any]:
    """As `at_once`, by a crew."""
    stop, failed = _Stop(progress), dict[int, BaseException]()

    def run(number: int) -> Any:
        try:
            return jobs[number](stop)
        except BaseException as error:
            if not (stop.is_set and isinstance(error, Cancelled)):
                failed[number] = error
            stop.is_set = True
            raise

    try:
        return list(_over(mine, run, iter(range(len(jobs))), len(jobs), stop))
    except BaseException:
        if not failed:
            raise
    raise failed[min(failed)]  # others were only told to stop


@contextmanager
def aside(job: Callable[[Progress], R], progress: Progress = silent) -> Iterator[Callable[[], R]]:
    """Offer a job to whoever has nothing else to do, and give what waits for its result.

    Who has taken it looks for other work whenever it reports: it fills the time in which this thread has
    nothing to share. Where nobody has taken it, it is done when it is asked for, and reports to `progress`.
    Where the block is left before, it is stopped as it next reports, and waited for.
    """
    mine: _Crew | None = getattr(_here, "crew", None)
    if mine is None:
        yield lambda: job(progress)
        return
    stop = _Aside(mine)

    def run() -> R:
        with _aside(True):
            return job(stop)

    task = _Task(run)
    mine.put_aside(task)

    def result() -> R:
        if mine.claim(task):
            task.job = partial(job, progress)
            task.run()
        return cast("R", mine.outcome(task, later=True))

    try:
        yield result
    finally:
        stop.is_set = True
        if not mine.claim(task):
            task.done.wait()


class _Stop:
    """What jobs in several threads report to: it raises `Cancelled` once it is set, in any of them."""

    def __init__(self, progress: Progress = silent) -> None:
        self._progress, self._owner, self.is_set = progress, threading.get_ident(), False

    def __call__(self, _fraction: float, _text: str) -> None:
        if self.is_set:
            raise Cancelled
        # another's goes on to who asked for it: whoever it is that does its job now
        if isinstance(self._progress, _Stop) or threading.get_ident() == self._owner:
            self._progress(0.0, "")


class _Aside(_Stop):
    """What a job that is put aside reports to: whatever else is offered meanwhile is done first."""

    def __init__(self, mine: _Crew) -> None:
        super().__init__()
        self._crew = mine

    def __call__(self, fraction: float, text: str) -> None:
        super().__call__(fraction, text)
        with _aside(False):
            self._crew.help()


@contextmanager
def _aside(whether: bool) -> Iterator[None]:
    """What this thread offers meanwhile is for those who have nothing else to do, or not."""
    before = getattr(_here, "aside", False)
    _here.aside = whether
    try:
        yield
    finally:
        _here.aside = before


def _over(
    mine: _Crew, work: Callable[[T], R], parts: Iterator[T], ahead: int, look: _Stop | None = None
) -> Generator[R]:
    """As `over`, by a crew; who waits reports to `look` now and then, and sets it where it fails."""
    tasks, own = deque[_Task](), None
    try:
        while True:
            more = [_Task(partial(work, part)) for part in islice(parts, ahead - len(tasks))]
            mine.offer(more)  # the last is taken first by the others, the first by this thread
            tasks.extend(more)
            if not tasks:
                return
            if mine.claim(tasks[0]):
                own = tasks[0]
                own.run()
            yield mine.outcome(tasks[0], look)
            tasks.popleft()
    except BaseException:
        if look:
            look.is_set = True
        raise
    finally:
        for task in tasks:
            if task is not own and not mine.claim(task):
                task.done.wait()


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
        self._offers, self._parts, self._jobs = deque[_Task](), deque[_Task](), deque[_Task]()
        self.changed = threading.Condition()
        self._open = True

    def offer(self, tasks: Sequence[_Task]) -> None:
        """Offer tasks to whoever is idle; the last is taken first, parts of a job aside after all others."""
        with self.changed:
            (self._parts if getattr(_here, "aside", False) else self._offers).extend(tasks)
            self.changed.notify_all()

    def put_aside(self, task: _Task) -> None:
        """Offer a job to a thread of the crew that finds nothing else."""
        with self.changed:
            self._jobs.append(task)
            self.changed.notify_all()

    def claim(self, task: _Task) -> bool:
        """Take a task back; whether nobody else has it."""
        with self.changed:
            for offers in (self._offers, self._parts, self._jobs):
                if task in offers:
                    offers.remove(task)
                    return True
            return False

    def take(self, later: bool = False) -> _Task | None:
        """Take what was offered last, if anything; parts of a job aside if `later`; with `changed` held."""
        if self._offers:
            return self._offers.pop()
        return self._parts.pop() if later and self._parts else None

    def help(self) -> None:
        """Do what others offer, as long as they do."""
        while True:
            with self.changed:
                task = self.take()
            if task is None:
                return
            self.do(task)

    def do(self, task: _Task) -> None:
        """Run a task that somebody else may wait for."""
        task.run()
        with self.changed:
            self.changed.notify_all()

    def outcome(self, task: _Task, look: Progress | None = None, later: bool = False) -> Any:
        """Return what a task has given, and do meanwhile what others offer: parts of that task, often.

        What is waited for is a part of what waits, or put aside by it: no two threads wait for each other.
        """
        later = later or getattr(_here, "aside", False)
        while not task.done.is_set():
            with self.changed:
                other = self.take(later)
                if other is None and not task.done.is_set():
                    self.changed.wait(LOOK if look else None)
            if other is not None:
                self.do(other)
            elif look:
                look(0.0, "")
        return task.outcome()

    def serve(self) -> None:
        """Work on what is offered until the crew is closed; then nobody waits for what is left."""
        _here.crew = self
        while True:
            with self.changed:
                while self._open and not (self._offers or self._parts or self._jobs):
                    self.changed.wait()
                if not self._open:
                    return
                task = self.take(later=True) or self._jobs.pop()
            self.do(task)

    def close(self) -> None:
        """Send the threads home; what nobody has taken is dropped."""
        with self.changed:
            self._open = False
            self.changed.notify_all()


class _Order:
    """Jobs of which some need others.

    Who has done a job goes on with one that waited for it alone, and offers the others: of many jobs that
    are over at once, as of bodies that nothing touches, few are handed from thread to thread.
    """

    def __init__(self, mine: _Crew, jobs: Sequence[Job[R]], needs: Sequence[Collection[int]]) -> None:
        self._crew, self._jobs, self._left = mine, jobs, len(jobs)
        self._values: list[Any] = [None] * len(jobs)
        self._failed: dict[int, BaseException] = {}
        self._waits = [len(set(need)) for need in needs]  # for so many
        self._next: list[list[int]] = [[] for _ in jobs]  # who waits for each
        for number, need in enumerate(needs):
            for other in set(need):
                self._next[other].append(number)

    def results(self) -> list[Any]:
        """Work until all is done."""
        mine = self._crew
        self._offer([number for number, waits in enumerate(self._waits) if not waits])
        try:
            while True:
                with mine.changed:
                    task = mine.take(later=True)
                    while self._left and task is None:
                        mine.changed.wait()
                        task = mine.take(later=True)
                if task is None:
                    break
                mine.do(task)
        except BaseException as error:  # Ctrl-C: the others begin nothing more
            self._failed[-1] = error
            raise
        if self._failed:
            raise self._failed[min(self._failed)]
        return self._values

    def _offer(self, numbers: Sequence[int]) -> None:
        if numbers:
            self._crew.offer([_Task(partial(self._work, number)) for number in reversed(numbers)])

    def _work(self, number: int | None) -> None:
        """Do a job, and what becomes free by it; nothing any more once one has failed."""
        while number is not None:
            try:
                if not self._failed:
                    self._values[number] = self._jobs[number]()
            except BaseException as error:
                self._failed[number] = error
            with self._crew.changed:
                free = []
                for other in self._next[number]:
                    self._waits[other] -= 1
                    if not self._waits[other]:
                        free.append(other)
                self._left -= 1
            number = free[0] if free else None
            self._offer(free[1:])
