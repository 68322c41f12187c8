# SPDX-License-Identifier: GPL-3.0-or-later
"""Long work behind an operator, written once: a thread and a timer in a window, at once elsewhere.

An operator that mixes in `JobOperator` gives `prepare` (read the scene) and `apply` (write it).
Between them a pure function of arrays runs: in a worker thread when the operator was invoked from
a window, so that Blender stays usable, and at once in `execute`, for scripts and ``blender -b``.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

import bpy

from ..femors_addon.progress import Cancelled, FemorsError, Progress

TICK = 0.1
"""Seconds between two looks at a running job."""

Compute = Callable[[Progress], Any]


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
    """

    def __init__(self, title: str, compute: Compute) -> None:
        self.title = title
        self.fraction = 0.0
        self.text = "Starting"
        self.started = time.monotonic()
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

    def start(self, context: bpy.types.Context) -> None:
        """Start the thread, and the timer that lets the operator look at it."""
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
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

    def close(self) -> None:
        """Stop the thread and wait for it, remove the timer, clear the status bar. May be repeated."""
        self.cancel()
        if self._thread.ident is not None:
            self._thread.join()
        timer, self._timer = self._timer, None
        manager = bpy.context.window_manager
        if timer is not None and manager is not None:
            manager.event_timer_remove(timer)
        show_status(None)
        redraw()


class JobOperator:
    """Mix-in for operators with long work; one job runs at a time in a Blender.

    Attributes
    ----------
    title : str
        What the operator does, in a word or two.
    current : Job or None
        Of `JobOperator` itself: the job that runs now, whichever operator started it.
    """

    # No annotations on attributes here: Blender evaluates them when an operator is registered, typing
    # caches what comes out, and the cached `Job` keeps the bpy module alive, which then hangs at exit.
    title = "FEMORS"
    current = None
    _job = None
    _shown = ()

    # --- given by the operator ----------------------------------------------------------------
    def prepare(self, context: bpy.types.Context) -> Compute:
        """Read the scene and return the work as a function of progress; may raise `FemorsError`."""
        raise NotImplementedError

    def apply(self, context: bpy.types.Context, result: Any) -> tuple[str, str]:
        """Write the result; return a report level (INFO, WARNING) and one line. May raise."""
        raise NotImplementedError

    # --- Blender's entries --------------------------------------------------------------------
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Do everything at once, with the mouse cursor as progress where there is a window."""
        manager = context.window_manager
        manager.progress_begin(0.0, 1.0)
        try:
            result = self.prepare(context)(lambda fraction, text: manager.progress_update(fraction))
        except Exception as error:
            return self._failed(error)
        finally:
            manager.progress_end()
        return self._finished(context, result)

    def run_modal(self, context: bpy.types.Context) -> set[str]:
        """Start the work in a thread and return at once; for `invoke`."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        try:
            job = Job(self.title, self.prepare(context))
        except Exception as error:
            return self._failed(error)
        self._job = JobOperator.current = job
        try:
            job.start(context)
            context.window_manager.modal_handler_add(self)
        except Exception as error:
            close_current()
            return self._failed(error)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Look at the job on each tick; every ending, also an unexpected one, closes the job."""
        answer: set[str] = set()
        try:
            answer = self._look(context, event)
        except Exception as error:
            answer = self._failed(error)
        finally:
            if not answer & {"RUNNING_MODAL", "PASS_THROUGH"} and self._job is JobOperator.current:
                close_current()
        return answer

    def _look(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Answer one event; everything but Esc passes through to Blender."""
        job = self._job
        if job is None or job.closed:  # a file was loaded, or the extension switched off
            return {"CANCELLED"}
        if event.type == "ESC" and event.value == "PRESS":
            job.cancel()
            self._show(job)
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if not job.alive and not job.cancelling and job.error is None and context.mode != "OBJECT":
            job.fraction, job.text = 1.0, "Done: return to Object Mode to receive the result"
            self._show(job)
            return {"PASS_THROUGH"}
        if job.alive:
            self._show(job)
            return {"PASS_THROUGH"}
        cancelled = job.cancelling
        close_current()
        if cancelled:
            self.tell("INFO", f"{self.title}: cancelled, nothing was changed")
            return {"CANCELLED"}
        if job.error is not None:
            return self._failed(job.error)
        return self._finished(context, job.result)

    def cancel(self, context: bpy.types.Context) -> None:
        """End with the window, the file or Blender itself (called by Blender)."""
        if self._job is not None and self._job is JobOperator.current:
            close_current()

    def tell(self, level: str, line: str) -> None:
        """Report one line to the user: INFO, WARNING or ERROR."""
        self.report({level}, line)

    # --- endings ------------------------------------------------------------------------------
    def _show(self, job: Job) -> None:
        """Redraw the panel and the status bar, only where something changed."""
        text = "Cancelling" if job.cancelling else job.text
        shown = (round(job.fraction, 3), text)
        if shown != self._shown:
            self._shown = shown
            show_status(f"FEMORS: {job.title}, {job.fraction:.0%}, {text}    Esc: cancel")
            redraw()

    def _finished(self, context: bpy.types.Context, result: Any) -> set[str]:
        try:
            level, line = self.apply(context, result)
        except Exception as error:
            return self._failed(error)
        self.tell(level, line)
        redraw()
        return {"FINISHED"}

    def _failed(self, error: BaseException) -> set[str]:
        if isinstance(error, FemorsError):
            line = " ".join(str(error).split())
        elif isinstance(error, MemoryError):
            line = "Not enough memory for meshes of this size: close other programs or reduce the meshes"
        else:
            traceback.print_exception(error)
            line = f"FEMORS failed unexpectedly ({type(error).__name__}: {error}); details are in the console"
        self.tell("ERROR", line)
        return {"CANCELLED"}


def close_current(*_: Any) -> None:
    """End the running job, if any, in whatever state; also the handler for the loading of files."""
    job, JobOperator.current = JobOperator.current, None
    if job is not None:
        job.close()


def show_status(text: str | None) -> None:
    """Write into the status bar, or give it back to Blender."""
    for workspace in bpy.data.workspaces:
        workspace.status_text_set(text)


def redraw() -> None:
    """Draw the sidebars anew, in every window."""
    manager = bpy.context.window_manager
    for window in manager.windows if manager else ():
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()


class FEMORS_OT_cancel(bpy.types.Operator):
    """End the running job; nothing is changed"""

    bl_idname = "femors.cancel"
    bl_label = "Cancel"
    bl_options = {"INTERNAL"}  # noqa: RUF012  (see JobOperator)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A job must be running."""
        cls.poll_message_set("Nothing is running")
        return JobOperator.current is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ask the job to end."""
        JobOperator.current.cancel()
        redraw()
        return {"FINISHED"}


classes = (FEMORS_OT_cancel,)


def register() -> None:
    """Register the cancel operator, and end jobs with their file."""
    for cls in classes:
        bpy.utils.register_class(cls)
    bpy.app.handlers.load_pre.append(_on_load)


def unregister() -> None:
    """End the running job and take everything back."""
    close_current()
    bpy.app.handlers.load_pre.remove(_on_load)
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)


@bpy.app.handlers.persistent
def _on_load(*_: Any) -> None:
    close_current()
