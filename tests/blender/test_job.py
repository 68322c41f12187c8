# SPDX-License-Identifier: GPL-3.0-or-later
"""The job mix-in without a window: threads, endings, and what the user is told."""

from __future__ import annotations

import sys
import threading
import time
from types import SimpleNamespace

import bpy
import pytest


def wait_for(condition, seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


def endless(progress):
    """Say progress until cancelled."""
    for i in range(10**9):
        progress(i / 10**9, f"step {i}")
        time.sleep(0.002)


class Context:
    """A window manager that counts its timers."""

    window = None

    def __init__(self):
        self.window_manager = self
        self.timers = 0

    def event_timer_add(self, seconds, window):
        self.timers += 1
        return self

    def event_timer_remove(self, timer):
        self.timers -= 1


@pytest.fixture()
def context(extension, part, monkeypatch):
    fake = Context()
    module = part("operators.job")

    class Data:
        workspaces = ()

    class Bpy:
        context, data = fake, Data

    monkeypatch.setattr(module, "bpy", Bpy)
    monkeypatch.setattr(part("operators.job_thread"), "bpy", Bpy)
    monkeypatch.setattr(module, "redraw", lambda: None)
    return fake


def threads() -> list[threading.Thread]:
    return [t for t in threading.enumerate() if t.name == "FEMORS job"]


def test_a_job_hands_over_its_result(context, part):
    job = part("operators.job").Job("Test", lambda progress: (progress(0.5, "half"), 42)[1])
    job.start(context)
    wait_for(lambda: not job.alive)
    assert (job.result, job.error, job.fraction, job.text) == (42, None, 0.5, "half")
    job.close()
    job.close()
    assert job.closed
    assert context.timers == 0


def test_a_job_hands_over_its_error(context, part):
    error = part("femors_addon.progress").FemorsError("no")

    def fails(progress):
        raise error

    job = part("operators.job").Job("Test", fails)
    job.start(context)
    wait_for(lambda: not job.alive)
    assert job.error is error
    job.close()


def test_cancel_ends_at_the_next_word(context, part):
    job = part("operators.job").Job("Test", endless)
    job.start(context)
    wait_for(lambda: job.fraction > 0)
    job.cancel()
    wait_for(lambda: not job.alive)
    assert isinstance(job.error, part("femors_addon.progress").Cancelled)
    assert job.cancelling and job.result is None
    job.close()


@pytest.mark.parametrize("ending", ["unregister", "load"])
def test_a_running_job_ends_with_the_extension_or_the_file(context, part, ending):
    module = part("operators.job")
    job = module.JobOperator.current = module.Job("Test", endless)
    job.start(context)
    wait_for(lambda: job.fraction > 0)
    if ending == "load":
        assert any(h.__name__ == "_on_load" for h in bpy.app.handlers.load_pre)
        bpy.ops.wm.read_homefile(use_empty=True)
    else:
        module.close_current()
        module.wait_for_closed()
        assert not threads()
    assert module.JobOperator.current is None
    assert job.closed and context.timers == 0
    wait_for(lambda: not threads())


@pytest.mark.parametrize("where", ["show", "apply", "mode", "interrupt"])
def test_whatever_modal_raises_the_job_is_closed(context, part, where):
    module = part("operators.job")
    told = []

    class Operator(module.JobOperator):
        def report(self, level, line):
            told.append((level, line))

        def apply(self, context, result):
            raise KeyError("apply")

        def _show(self, job):
            raise (KeyboardInterrupt if where == "interrupt" else KeyError)("show")

    class Event:
        type, value = "TIMER", "NOTHING"

    context.mode = "EDIT" if where == "mode" else "OBJECT"
    operator = Operator()
    running = where in ("show", "interrupt")
    job = module.Job("Test", endless if running else lambda progress: 42)
    operator._job = module.JobOperator.current = job
    job.start(context)
    wait_for(lambda: job.fraction > 0 if running else not job.alive)
    if where == "interrupt":
        with pytest.raises(KeyboardInterrupt):
            operator.modal(context, Event)
    else:
        assert operator.modal(context, Event) == {"CANCELLED"}
        assert told[0][0] == {"ERROR"} and "KeyError" in told[0][1]
    assert module.JobOperator.current is None
    assert job.closed and context.timers == 0
    wait_for(lambda: not threads())


def test_esc_ends_the_job_at_once_though_the_thread_is_deep_in_work(context, part):
    module = part("operators.job")
    told, deep, go = [], threading.Event(), threading.Event()

    class Operator(module.JobOperator):
        title = "Test"

        def report(self, level, line):
            told.append((level, line))

    class Esc:
        type, value = "ESC", "PRESS"

    def work(progress):
        deep.set()
        assert go.wait(10)
        progress(0.5, "never seen")

    operator = Operator()
    job = operator._job = module.JobOperator.current = module.Job("Test", work)
    job.start(context)
    assert deep.wait(10)
    assert operator.modal(context, Esc) == {"CANCELLED"}
    assert told == [({"INFO"}, "Test: cancelled, nothing was changed")]
    assert module.JobOperator.current is None and job.alive and context.timers == 0
    go.set()
    module.wait_for_closed()
    assert not threads() and isinstance(job.error, part("femors_addon.progress").Cancelled)


@pytest.mark.parametrize("name", ["limits", "no_such_module"])
def test_the_core_is_imported_in_the_thread(context, part, monkeypatch, name):
    """The window does not wait for SciPy; what cannot be imported is told, and the job closed."""
    module = part("operators.job")
    monkeypatch.delitem(sys.modules, f"{module.CORE}.{name}", raising=False)
    monkeypatch.setattr(module.bpy, "app", SimpleNamespace(background=False), raising=False)
    told, where = [], []

    class Operator(module.JobOperator):
        core = (name,)

        def report(self, level, line):
            told.append((level, line))

        @classmethod
        def missing(cls, context):
            return ""

        def prepare(self, context):
            where.append((threading.current_thread(), f"{module.CORE}.{name}" in sys.modules))
            return lambda progress: 42

        def apply(self, context, result):
            return "INFO", f"gave {result}"

    class Event:
        type, value = "TIMER", "NOTHING"

    context.mode, context.window = "OBJECT", object()
    monkeypatch.setattr(context, "modal_handler_add", lambda operator: None, raising=False)
    operator = Operator()
    assert operator.run_modal(context) == {"RUNNING_MODAL"} and not where
    answer = {"PASS_THROUGH"}
    end = time.monotonic() + 10.0
    while answer == {"PASS_THROUGH"}:
        assert time.monotonic() < end, "waited in vain"
        answer = operator.modal(context, Event)
        time.sleep(0.005)
    if name == "limits":
        assert where == [(threading.main_thread(), True)]
        assert answer == {"FINISHED"} and told == [({"INFO"}, "gave 42")]
    else:
        assert not where and answer == {"CANCELLED"} and "no_such_module" in told[0][1]
    assert module.JobOperator.current is None and context.timers == 0


def test_what_the_button_asks_for_is_asked_again_after_the_import(context, part, monkeypatch):
    """Edit Mode may be entered, or a mesh deleted, while the core is imported in the thread."""
    module = part("operators.job")
    monkeypatch.delitem(sys.modules, f"{module.CORE}.limits", raising=False)
    monkeypatch.setattr(module.bpy, "app", SimpleNamespace(background=False), raising=False)
    told, prepared = [], []

    class Operator(module.JobOperator):
        core = ("limits",)

        @classmethod
        def missing(cls, context):
            return "" if context.mode == "OBJECT" else "Leave Edit Mode first"

        def report(self, level, line):
            told.append((level, line))

        def prepare(self, context):
            prepared.append(1)

    class Event:
        type, value = "TIMER", "NOTHING"

    context.mode, context.window = "OBJECT", object()
    monkeypatch.setattr(context, "modal_handler_add", lambda operator: None, raising=False)
    operator = Operator()
    assert operator.run_modal(context) == {"RUNNING_MODAL"}
    context.mode = "EDIT_MESH"
    wait_for(lambda: not operator._job.alive)
    assert operator.modal(context, Event) == {"CANCELLED"}
    assert told == [({"ERROR"}, "Leave Edit Mode first")] and not prepared
    assert module.JobOperator.current is None and context.timers == 0


def test_what_the_operators_import_in_the_thread_is_there(part):
    for name, kind in (("morph", "morph"), ("quality", "quality"), ("transfer", "transfer")):
        operator = getattr(part(f"operators.{name}"), f"FEMORS_OT_{kind}")
        assert operator.core
        for one in operator.core:
            part(f"femors_addon.{one}")
    for one in part("operators.overclosure").BodiesOperator.core:
        part(f"femors_addon.{one}")


def test_the_time_left_follows_the_pace(context, part, monkeypatch):
    module = part("operators.job")
    job = module.Job("Test", endless)
    job.fraction = 0.25
    assert job.seconds_left is None and module.time_left(job) == ""  # too early to say
    job.started -= 20.0
    assert job.seconds_left == pytest.approx(60.0, rel=0.01)
    assert module.time_left(job) == "about 60 s left"
    job.fraction = 0.8
    assert module.time_left(job) == "a few seconds left"


def test_no_time_is_told_where_a_job_stands_nearly_still(context, part, monkeypatch):
    clock = SimpleNamespace(monotonic=lambda: clock.now, now=100.0)
    monkeypatch.setattr(part("operators.job_thread"), "time", clock)
    module = part("operators.job")
    job = module.Job("Test", endless)

    def told(now: float, fraction: float) -> str:
        clock.now = 100.0 + now
        job._progress(fraction, "")
        return module.time_left(job)

    assert told(4.0, 0.86) == told(6.5, 0.865) == "a few seconds left"
    assert told(12.0, 0.87) == told(30.0, 0.88) == ""  # at its pace it would have been done long ago
    assert told(31.0, 0.92) == "a few seconds left"
    job = module.Job("Test", endless)  # a slow one may take its time for a step
    clock.now = 100.0
    job.started, job._mark = 100.0, (100.0, 0.0)
    assert told(200.0, 0.5) == told(215.0, 0.52) != ""
    assert told(200.0 + 100.0, 0.54) == ""


def test_what_moves_is_watched_only_where_there_is_a_window(extension, part):
    import numpy as np

    module = part("operators.job")
    operator = module.JobOperator()
    points, faces = np.zeros((3, 3)), [[0, 1, 2]]
    assert operator.watch(points, faces) is None
    operator._views = []
    view = operator.watch(points, faces)
    assert operator._views == [view] and not view.waiting
    view(points + 1.0)
    assert view.waiting
    latest = view._fresh
    view(points + 2.0)  # the first is not drawn yet: the worker is not kept, nothing piles up
    assert view._fresh is latest


def test_one_job_at_a_time(empty, context, part):
    module = part("operators.job")
    assert bpy.ops.femors.morph.poll()
    assert not bpy.ops.femors.cancel.poll()
    job = module.JobOperator.current = module.Job("Test", endless)
    job.start(context)
    try:
        with pytest.raises(RuntimeError, match="job is running"):
            bpy.ops.femors.morph(source="a", target="b")
        assert bpy.ops.femors.cancel() == {"FINISHED"}
        wait_for(lambda: not job.alive)
    finally:
        module.close_current()


def test_unexpected_errors_are_one_line_with_the_traceback_on_the_console(pair, part, monkeypatch, capfd):
    core = part("femors_addon.morph")

    def broken(*args, **options):
        raise KeyError("something of ours")

    monkeypatch.setattr(core, "morph", broken)
    with pytest.raises(RuntimeError, match=r"^Error: FEMORS failed unexpectedly \(KeyError") as caught:
        bpy.ops.femors.morph(source="Femur", target="Scan")
    assert str(caught.value).strip().count("\n") == 0
    assert "Traceback" in capfd.readouterr().err


def test_too_little_memory_is_one_line(pair, part, monkeypatch):
    def huge(*args, **options):
        raise MemoryError

    monkeypatch.setattr(part("femors_addon.morph"), "morph", huge)
    with pytest.raises(RuntimeError, match="Not enough memory"):
        bpy.ops.femors.morph(source="Femur", target="Scan")
