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
from .tasks import Job, Order, Task, Threads, here

R = TypeVar("R")
T = TypeVar("T")

AHEAD = 2  # parts for each thread that are begun before the first is done: no more are held in memory
BLOCK = 20_000  # rows: some 20 ms of a search


@contextmanager
def crew(worth: bool = True) -> Iterator[Threads | None]:
    """Keep as many threads as are allowed, this one included, and give them, if there are several.

    Within a crew there is no other. Where the system refuses a thread, there are fewer; where it is not
    `worth` it, for all pieces are over sooner than they are handed to another thread, this one is alone.
    """
    mine: Threads | None = getattr(here, "crew", None)
    if mine or Limits.threads < 2 or getattr(here, "alone", False):
        yield mine
        return
    if not worth:
        here.alone = True
        try:
            yield None
        finally:
            here.alone = False
        return
    own = Threads()
    threads: list[threading.Thread] = []
    here.crew = own
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
        if getattr(here, "crew", None) is own:  # a generator may be closed by another thread
            here.crew = None
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


def _at_once(mine: Threads, jobs: Sequence[Callable[[Progress], Any]], progress: Progress) -> list[Any]:
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
    mine: Threads | None = getattr(here, "crew", None)
    if mine is None:
        yield lambda: job(progress)
        return
    stop = _Aside(mine)
    task = Task(partial(job, stop), aside=True)
    mine.put_aside(task)

    def result() -> R:
        if mine.claim(task):
            task.job = partial(job, progress)
            task.run()
        return cast("R", mine.outcome(task))

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

    def __init__(self, mine: Threads) -> None:
        super().__init__()
        self._crew = mine

    def __call__(self, fraction: float, text: str) -> None:
        super().__call__(fraction, text)
        self._crew.help()


def _over(
    mine: Threads, work: Callable[[T], R], parts: Iterator[T], ahead: int, look: _Stop | None = None
) -> Generator[R]:
    """As `over`, by a crew; who waits reports to `look` now and then, and sets it where it fails."""
    tasks, own = deque[Task](), None
    try:
        while True:
            more = [Task(partial(work, part)) for part in islice(parts, ahead - len(tasks))]
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
    mine: Threads | None = getattr(here, "crew", None)
    if mine is None or len(jobs) < 2:
        return [job() for job in jobs]
    return Order(mine, jobs, needs).results()
