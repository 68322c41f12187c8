# SPDX-License-Identifier: GPL-3.0-or-later
"""A computation in a thread of its own, its progress, and how it is ended; see `job` for its operator."""

from __future__ import annotations

import importlib
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import bpy

from ..femors_addon.progress import Cancelled, Progress
from . import dependencies, preview

TICK = 0.1
"""Seconds between two looks at a running job."""

STEP, SLOW, STILL = 0.05, 3.0, 3.0
"""A share of a job, times what it took so far, and seconds: one that takes more gives the lie to the pace."""

Compute = Callable[[Progress], Any]
CORE = __package__.rpartition(".")[0] + ".femors_addon"


class Job:
    """One computation in a thread, and what the panel shows of it.

    Attributes
    ----------
    title : str
        What is being done, for the panel and the status bar.
    fraction : float
        Done so far, 0 to 1.
    text : str
        Stage, iteration and residual, in words.
    views : list of View
        What is drawn in the viewport while it runs.
    """

    def __init__(self, title: str, compute: Compute, views: Sequence[preview.View] = ()) -> None:
        self.title = title
        self.views = list(views)
        self.fraction = 0.0
        self.text = "Starting"
        self.started = time.monotonic()
        self._mark = (self.started, 0.0)  # when the last `STEP` was done, and what had been done by then
        self.result: Any = None
        self.error: BaseException | None = None
        self._timer: bpy.types.Timer | None = None
        self._cancel = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(compute,), name="FEMORS job")

    def _run(self, compute: Compute) -> None:
        try:
            self.result = compute(self._progress)
        except BaseException as error:  # handed to the main thread, which reports it
            self.error = error

    def _progress(self, fraction: float, text: str) -> None:
        if self._cancel.is_set():
            raise Cancelled
        self.fraction, self.text = min(max(float(fraction), 0.0), 1.0), text
        if self.fraction >= self._mark[1] + STEP:
            self._mark = (time.monotonic(), self.fraction)

    def start(self, context: bpy.types.Context) -> None:
        """Start the thread, and the timer that lets the operator look at it."""
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        preview.show(self.views)
        self._thread.start()

    def go_on(self, compute: Compute, views: Sequence[preview.View]) -> None:
        """Compute something more, in a new thread, once the first one has ended."""
        self.views, self.result = list(views), None
        preview.show(self.views)
        self._thread = threading.Thread(target=self._run, args=(compute,), name="FEMORS job")
        self._thread.start()

    def cancel(self) -> None:
        """Ask the computation to end; it does so at its next word of progress."""
        self._cancel.set()

    @property
    def cancelling(self) -> bool:
        """Whether the end was asked for."""
        return self._cancel.is_set()

    @property
    def alive(self) -> bool:
        """Whether the thread still computes."""
        return self._thread.is_alive()

    @property
    def closed(self) -> bool:
        """Whether `close` was called: nobody waits for the result any more."""
        return self._timer is None

    @property
    def seconds_left(self) -> float | None:
        """How long it will take from here, judged by its pace; None where that says nothing.

        So it is at the start, and where it has long stood nearly still for its pace.
        """
        now = time.monotonic()
        gone = now - self.started
        if gone < 2.0 or self.fraction < STEP:
            return None
        if now - self._mark[0] > max(STILL, SLOW * STEP * gone / self.fraction):
            return None
        return gone * (1.0 - self.fraction) / self.fraction

    def join(self) -> None:
        """Wait for the thread."""
        if self._thread.ident is not None:
            self._thread.join()

    def close(self, redrawn: bool = True) -> None:
        """Ask the thread to end, remove timer and preview. May be repeated.

        The thread ends by itself at its next word of progress; nobody need wait, for it touches nothing
        of Blender's, and its result is dropped.

        Parameters
        ----------
        redrawn : bool
            Not while Blender takes its windows down: then they are drawn anew later, if one is left.
        """
        self.cancel()
        timer, self._timer = self._timer, None
        preview.hide(redrawn)
        manager = bpy.context.window_manager
        if timer is not None and manager is not None:
            manager.event_timer_remove(timer)


def loading(names: Sequence[str]) -> Compute:
    """Return the import of modules of the core as work; it may raise `FemorsError`."""

    def load(progress: Progress) -> None:
        dependencies.require()
        for name in names:
            progress(0.0, "loading")
            importlib.import_module(f"{CORE}.{name}")

    return load


def time_left(job: Job) -> str:
    """Return how long a job will take from here, in words, or ""."""
    seconds = job.seconds_left
    if seconds is None:
        return ""
    if seconds < 10:
        return "a few seconds left"
    return f"about {round(seconds, -1):.0f} s left" if seconds < 90 else f"about {seconds / 60:.0f} min left"
