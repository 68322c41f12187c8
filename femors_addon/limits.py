# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of the machine a computation may take; of the whole process, as the machine is."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from itertools import chain, islice
from typing import Any, ClassVar, TypeVar

from .progress import Cancelled, FemorsError, Progress, silent

T = TypeVar("T")
R = TypeVar("R")

MB = 1e6
LOOK = 0.05  # seconds between two looks at whether jobs in other threads are to be cancelled
EACH = 0.2  # of what a job needs: what each further thread holds besides, at most, as was measured
AHEAD = 2  # parts for each thread that are begun before the first is done: no more are held in memory


class Limits:
    """What is allowed.

    Attributes
    ----------
    threads : int
        For whatever goes block by block, see `in_threads`; results do not depend on it.
    memory : float
        Bytes that a job may need; 0 for as many as there are.
    """

    threads: ClassVar[int] = 1
    memory: ClassVar[float] = 0.0
    aside: ClassVar[int] = 0  # threads that `aside` has at work


def allow(threads: int, megabytes: float) -> None:
    """Set the limits; 0 threads are as many as the machine has processors, 0 MB is no limit."""
    Limits.threads = threads if threads > 0 else (os.cpu_count() or 1)
    Limits.memory = max(megabytes, 0.0) * MB


def require_memory(needed: float, what: str) -> None:
    """Raise `FemorsError` where a job, which needs so many bytes in one thread, needs more than allowed."""
    needed *= 1.0 + EACH * (Limits.threads - 1)
    if Limits.memory and needed > Limits.memory:
        raise FemorsError(
            f"{what} needs about {needed / MB:.0f} MB of memory, and the limit in the preferences is "
            f"{Limits.memory / MB:.0f} MB: raise it, or reduce the meshes"
        )


def require_nodes(nodes: int, what: str, least: float, each: float) -> None:
    """Raise `FemorsError` where a job on so many nodes would need more bytes than are allowed.

    Parameters
    ----------
    nodes : int
        Of all meshes and points of the job.
    what : str
        The job, such as "a transfer".
    least, each : float
        Bytes that such a job was measured to take, and per node.
    """
    require_memory(least + each * nodes, f"{what} with {nodes} nodes in all")


within = threading.local()
"""`thread` is true in the threads of `in_threads`, `pool` are how many threads `pooled` keeps, and these."""


def _begin() -> None:
    within.thread = True


def free_threads() -> int:
    """Return how many threads may be at work for who asks: one within those that are at work already."""
    return 1 if getattr(within, "thread", False) else max(Limits.threads - Limits.aside, 1)


def in_threads(work: Callable[[T], R], parts: Iterable[T]) -> Iterator[R]:
    """Yield what the work returns for each part, in their order, in as many threads as are allowed.

    Results are the same for any number of threads as long as no part needs what another writes. The consumer
    may raise, `Cancelled` for instance: parts that have not begun are dropped. Within such a thread parts are
    worked on one after the other, for threads that start threads would be more than are allowed.
    """
    threads = free_threads()
    if threads < 2:
        yield from map(work, parts)
        return
    parts = iter(parts)
    first = list(islice(parts, 2))
    if len(first) < 2:
        yield from map(work, first)
        return
    waiting = deque[Future[R]]()
    with _workers(threads) as pool:
        try:
            for one in chain(first, parts):
                waiting.append(pool.submit(work, one))
                if len(waiting) > AHEAD * threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
            wait(waiting)


@contextmanager
def pooled() -> Iterator[None]:
    """Keep threads for the whole of a job, for `in_threads` and `at_once`.

    To begin and end them takes a quarter of a millisecond, some hundred times in a morph.
    """
    threads = free_threads()
    if threads < 2 or getattr(within, "pool", None) is not None:
        yield
        return
    with ThreadPoolExecutor(threads, initializer=_begin) as pool:
        within.pool = threads, pool
        try:
            yield
        finally:
            within.pool = None


@contextmanager
def _workers(threads: int) -> Iterator[ThreadPoolExecutor]:
    """So many threads: those that are kept, or others for as long as this lasts."""
    count, pool = getattr(within, "pool", None) or (0, None)
    if pool is not None and count == threads:
        yield pool
        return
    with ThreadPoolExecutor(threads, initializer=_begin) as own:
        yield own


def at_once(*jobs: Callable[[Progress], Any], progress: Progress = silent) -> list[Any]:
    """Return what each job returns; none may need what another writes.

    Of one thread they are done one after the other, and report to `progress`. In threads they report to
    nobody: the thread that waits for them does, now and then, and where it is told to cancel they stop
    as they next report. What is reported has to be the same each time, see `progress.repeating`.
    """
    threads = free_threads()
    if threads < 2:
        return [job(progress) for job in jobs]
    left, look = _stoppable()
    begun: list[Future[Any]] = []
    with _workers(threads) as pool:
        try:
            begun += [pool.submit(job, look) for job in jobs]
            while wait(begun, LOOK).not_done:
                progress(0.0, "")
            return [one.result() for one in begun]
        finally:
            left.set()
            wait(begun)


def _stoppable() -> tuple[threading.Event, Progress]:
    """An event, and what a job in another thread may report to: it raises `Cancelled` from then on."""
    left = threading.Event()

    def look(_fraction: float, _text: str) -> None:
        if left.is_set():
            raise Cancelled

    return left, look


_counting = threading.Lock()


def _count(change: int) -> None:
    """Keep count of the threads of `aside`."""
    with _counting:
        Limits.aside += change


@contextmanager
def aside(job: Callable[[Progress], R], progress: Progress = silent) -> Iterator[Callable[[], R]]:
    """Begin a job beside what follows, and give what waits for its result.

    It counts as one of the threads that are allowed; of one thread it is done when it is asked for, and
    reports to `progress`. Where the block is left before, it is stopped as it next reports, and waited for.
    """
    if Limits.threads < 2 or getattr(within, "thread", False):
        yield lambda: job(progress)
        return
    left, look = _stoppable()

    def work() -> R:
        _count(1)
        try:
            return job(look)
        finally:
            _count(-1)

    with ThreadPoolExecutor(1, initializer=_begin) as pool:
        try:
            yield pool.submit(work).result
        finally:
            left.set()
