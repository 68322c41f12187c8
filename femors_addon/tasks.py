# SPDX-License-Identifier: GPL-3.0-or-later
"""Tasks that are offered, and the threads that take them; see `crew` for what is done with both."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Any, TypeVar

from .progress import Progress

R = TypeVar("R")
Job = Callable[[], R]

LOOK = 0.05  # seconds between two looks at whether jobs in other threads are to be cancelled

# of this thread: its `crew` (`Threads`); whether it wants to be `alone`; whether its task was put `aside`
here = threading.local()


class Task:
    """A job, what it returned or raised, and whether it is done.

    It is a job aside, or a part of one, where it is said so or where it is made by one.
    """

    def __init__(self, job: Job[Any], aside: bool = False) -> None:
        self.job, self.done = job, threading.Event()
        self.aside = aside or getattr(here, "aside", False)
        self.value: Any = None
        self.error: BaseException | None = None

    def run(self) -> None:
        before, here.aside = getattr(here, "aside", False), self.aside
        try:
            self.value = self.job()
        except BaseException as error:  # it is raised where the job was asked for
            self.error = error
        finally:
            here.aside = before
            self.done.set()

    def outcome(self) -> Any:
        self.done.wait()
        if self.error is not None:
            raise self.error
        return self.value


class Threads:
    """What is offered, and the threads that take it."""

    def __init__(self) -> None:
        self._offers, self._parts, self._jobs = deque[Task](), deque[Task](), deque[Task]()
        self.changed = threading.Condition()
        self._open = True

    def offer(self, tasks: Sequence[Task]) -> None:
        """Offer tasks to whoever is idle; the last is taken first, parts of a job aside after all others."""
        with self.changed:
            for task in tasks:
                (self._parts if task.aside else self._offers).append(task)
            self.changed.notify_all()

    def put_aside(self, task: Task) -> None:
        """Offer a job to a thread of the crew that finds nothing else."""
        with self.changed:
            self._jobs.append(task)
            self.changed.notify_all()

    def claim(self, task: Task) -> bool:
        """Take a task back; whether nobody else has it."""
        with self.changed:
            for offers in (self._offers, self._parts, self._jobs):
                if task in offers:
                    offers.remove(task)
                    return True
            return False

    def take(self, later: bool = False) -> Task | None:
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

    def do(self, task: Task) -> None:
        """Run a task that somebody else may wait for."""
        task.run()
        with self.changed:
            self.changed.notify_all()

    def outcome(self, task: Task, look: Progress | None = None) -> Any:
        """Return what a task has given, and do meanwhile what others offer: parts of that task, often.

        What is waited for is a part of what waits, or put aside by it: no two threads wait for each other.
        """
        while not task.done.is_set():
            with self.changed:
                other = self.take(later=task.aside)
                if other is None and not task.done.is_set():
                    self.changed.wait(LOOK if look else None)
            if other is not None:
                self.do(other)
            elif look:
                look(0.0, "")
        return task.outcome()

    def serve(self) -> None:
        """Work on what is offered until the crew is closed; then nobody waits for what is left."""
        here.crew = self
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


class Order:
    """Jobs of which some need others.

    Who has done a job goes on with one that waited for it alone, and offers the others: of many jobs that
    are over at once, as of bodies that nothing touches, few are handed from thread to thread.
    """

    def __init__(self, mine: Threads, jobs: Sequence[Job[R]], needs: Sequence[Collection[int]]) -> None:
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
        aside = getattr(here, "aside", False)
        self._offer([number for number, waits in enumerate(self._waits) if not waits])
        try:
            while True:
                with mine.changed:
                    task = mine.take(later=aside)
                    while self._left and task is None:
                        mine.changed.wait()
                        task = mine.take(later=aside)
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
            self._crew.offer([Task(partial(self._work, number)) for number in reversed(numbers)])

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
