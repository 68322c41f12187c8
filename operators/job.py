# SPDX-License-Identifier: GPL-3.0-or-later
"""Long work behind an operator, written once: a thread and a timer in a window, at once elsewhere.

An operator that mixes in `JobOperator` gives `prepare` (read the scene) and `apply` (write it).
Between them a pure function of arrays runs: in a worker thread when the operator was invoked from
a window, so that Blender stays usable, and at once in `execute`, for scripts and ``blender -b``.
What moves can be watched: `prepare` asks for `JobOperator.watch` and hands it to the core.

The first job of a session imports SciPy and the core in its thread: a window that did it itself would
stand still for a quarter of a second.
"""

from __future__ import annotations

import sys
import time
import traceback
from typing import Any

import bpy

from ..femors_addon.progress import FemorsError, Preview
from . import preview
from .job_thread import CORE, TICK, Compute, Job, loading, time_left

READ = 0.3
"""Seconds between two redraws of what is said of it, at least: nobody reads faster."""


class JobOperator:
    """Mix-in for operators with long work; one job runs at a time in a Blender.

    Attributes
    ----------
    title : str
        What the operator does, in a word or two.
    current : Job or None
        Of `JobOperator` itself: the job that runs now, whichever operator started it.
    core : tuple of str
        Modules of the core that `prepare` and `apply` need: imported in the thread, before `prepare`.
    """

    # No annotations on attributes here: Blender evaluates them when an operator is registered, typing
    # caches what comes out, and the cached `Job` keeps the bpy module alive, which then hangs at exit.
    title = "FEMORS"
    current = None
    core = ()
    _job = None
    _prepared = True
    _shown = ()
    _read = 0.0
    _views = None

    # --- given by the operator ----------------------------------------------------------------
    @classmethod
    def missing(cls, context: bpy.types.Context) -> str:
        """Return in words what keeps the work from being started, whatever else runs; "" for nothing."""
        raise NotImplementedError

    def prepare(self, context: bpy.types.Context) -> Compute:
        """Read the scene and return the work as a function of progress; may raise `FemorsError`."""
        raise NotImplementedError

    def apply(self, context: bpy.types.Context, result: Any) -> tuple[str, str]:
        """Write the result; return a report level (INFO, WARNING) and one line. May raise."""
        raise NotImplementedError

    def watch(self, vertices: Any, triangles: Any) -> Preview | None:
        """Return where the core may put positions of a mesh that moves; for `prepare`.

        They are drawn over the viewport while the job runs; several meshes can be watched. None where
        there is no window to draw in.

        Parameters
        ----------
        vertices : (n, 3) array
            World positions to begin with.
        triangles : (m, 3) array
        """
        if self._views is None:
            return None
        self._views.append(preview.View(vertices, triangles))
        return self._views[-1]

    # --- Blender's entries --------------------------------------------------------------------
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Say in words what is missing, or that another job runs."""
        running = JobOperator.current is not None
        message = "A FEMORS job is running: wait or cancel it" if running else cls.missing(context)
        if message:
            cls.poll_message_set(message)
        return not message

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
            self._views = []
            missing = [name for name in self.core if f"{CORE}.{name}" not in sys.modules]
            self._prepared = not missing
            job = Job(self.title, loading(missing) if missing else self.prepare(context), self._views)
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
        if job.cancelling:
            close_current()
            self.tell("INFO", f"{self.title}: cancelled, nothing was changed")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        preview.refresh(TICK)
        if not (self._prepared or job.alive or job.error):
            self._prepared = True
            if message := self.missing(context):  # Edit Mode was entered meanwhile, say
                raise FemorsError(message)
            job.go_on(self.prepare(context), self._views)
            return {"PASS_THROUGH"}
        if not job.alive and job.error is None and context.mode != "OBJECT":
            job.fraction, job.text = 1.0, "Done: return to Object Mode to receive the result"
            self._show(job)
            return {"PASS_THROUGH"}
        if job.alive:
            self._show(job)
            return {"PASS_THROUGH"}
        close_current()
        if job.error is not None:
            return self._failed(job.error)
        return self._finished(context, job.result)

    def cancel(self, context: bpy.types.Context) -> None:
        """End with the window, the file or Blender itself (called by Blender)."""
        if self._job is not None and self._job is JobOperator.current:
            close_current(redrawn=False)
        wait_for_closed()  # Blender may be about to end, and a thread must not outlive it

    def tell(self, level: str, line: str) -> None:
        """Report one line to the user: INFO, WARNING or ERROR."""
        self.report({level}, line)

    # --- endings ------------------------------------------------------------------------------
    def _show(self, job: Job) -> None:
        """Redraw the panel and the status bar, only where something changed."""
        left, now = time_left(job), time.monotonic()
        shown = (round(job.fraction, 3), job.text, left)
        if shown != self._shown and now - self._read >= READ:
            self._shown, self._read = shown, now
            words = ", ".join(filter(None, (f"FEMORS: {job.title}", f"{job.fraction:.0%}", job.text, left)))
            show_status(f"{words}    Esc: cancel")
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


_closed: list[Job] = []
"""Jobs whose threads may still be on their way out."""


def close_current(redrawn: bool = True) -> None:
    """End the running job, if any, in whatever state, and at once; clear the status bar.

    Parameters
    ----------
    redrawn : bool
        Not while Blender takes its windows down: then they are drawn anew later, if one is left.
    """
    job, JobOperator.current = JobOperator.current, None
    _closed[:] = [one for one in _closed if one.alive]
    if job is not None:
        _closed.append(job)
        job.close(redrawn)
        if redrawn:
            tidy()
        else:
            bpy.app.timers.register(tidy, first_interval=0.1)


def wait_for_closed() -> None:
    """Wait until no thread of ours is left."""
    while _closed:
        _closed.pop().join()


def show_status(text: str | None) -> None:
    """Write into the status bar, or give it back to Blender."""
    for workspace in bpy.data.workspaces:
        workspace.status_text_set(text)


def tidy() -> None:
    """Show that no job runs, unless there is a new one."""
    if JobOperator.current is None:
        show_status(None)
        redraw()


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
    wait_for_closed()
    if bpy.app.timers.is_registered(tidy):
        bpy.app.timers.unregister(tidy)
    bpy.app.handlers.load_pre.remove(_on_load)
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)


@bpy.app.handlers.persistent
def _on_load(*_: Any) -> None:
    close_current()
    wait_for_closed()
