# SPDX-License-Identifier: GPL-3.0-or-later
"""Stalls of the window: ticks that come late, and who was at work meanwhile."""

from __future__ import annotations

import sys
import threading
import time
from typing import Any

import bpy
from hands import job

STALL = 0.05


class Pulse:
    """Ticks of the window, every 5 ms while it has nothing to do: what comes late was a stall.

    For each, the processor time that the window's thread, the job's thread and all others took says why
    it was late: the window's own work (Blender's, and ours in it), a job that lets no other thread run,
    the drawing (in software here, in threads of its own), or, where none took as much, a busy machine.
    """

    def __init__(self) -> None:
        self.late: list[dict[str, Any]] = []
        self.ticks = 0
        self.drawn = self.before = ""
        add = bpy.types.SpaceView3D.draw_handler_add
        self.handlers = {
            "WINDOW": add(self.draw, ("viewport",), "WINDOW", "PRE_VIEW"),
            "UI": add(self.draw, ("sidebar",), "UI", "POST_PIXEL"),
        }
        self.begun = time.monotonic()
        self.last: tuple[float, ...] | None = self.clocks()
        bpy.app.timers.register(self.tick)

    @staticmethod
    def worker() -> threading.Thread | None:
        """Return the job's thread, as long as it lives."""
        return next((t for t in threading.enumerate() if t.name == "FEMORS job"), None)

    def clocks(self) -> tuple[float, ...]:
        """Return the time, and what all, the window and the job have taken of the processor."""
        worker, its = self.worker(), 0.0
        if worker is not None and worker.ident is not None:
            try:
                its = time.clock_gettime(time.pthread_getcpuclockid(worker.ident))
            except OSError:  # it has just ended
                its = 0.0
        return time.monotonic(), time.process_time(), time.thread_time(), its

    def draw(self, what: str) -> None:
        """Remember what is drawn between two ticks."""
        self.drawn = self.drawn if self.drawn == "viewport" else what

    def tick(self) -> float | None:
        """Compare with the tick before."""
        if self.last is None:
            return None
        running, now = job(), self.clocks()
        gap, all_of_it, window, its = (a - b for a, b in zip(now, self.last, strict=True))
        self.ticks += 1
        if gap > STALL:
            one: dict[str, Any] = {
                "ms": gap,
                "window": window,
                "job": max(its, 0.0),
                "others": all_of_it - window - max(its, 0.0),
            }
            one = {key: round(1000 * value) for key, value in one.items()}
            # the display may be waited for in the tick after the drawing
            one |= {"drawn": self.drawn or self.before or "nothing", "at": round(now[0] - self.begun, 1)}
            one |= {"text": running.text if running else "", "where": self.where()}
            self.late.append(one)
        self.last, self.before, self.drawn = now, self.drawn, ""
        return 0.005

    def go_on(self) -> None:
        """Count from now on: what was before was the story's own doing, such as a screenshot."""
        self.last, self.before, self.drawn = self.clocks(), self.drawn, ""

    def where(self) -> str:
        """Say what the job is at."""
        worker = self.worker()
        found = sys._current_frames().get(worker.ident) if worker is not None else None
        lines = []
        while found is not None and len(lines) < 3:
            lines.append(f"{found.f_code.co_filename.rpartition('/')[2]}:{found.f_lineno}")
            found = found.f_back
        return " < ".join(lines)

    def figures(self) -> dict[str, Any]:
        """End, and return the late ticks by what was drawn, in ms."""
        self.last = None
        for region, handler in self.handlers.items():
            bpy.types.SpaceView3D.draw_handler_remove(handler, region)
        held = sorted((one["job"] for one in self.late), reverse=True)
        own = sorted((one["window"] for one in self.late), reverse=True)
        out: dict[str, Any] = {
            "ticks": self.ticks,
            "longest_of_the_job": held[:5],
            "longest_of_the_window": own[:5],
        }
        for name in ("viewport", "sidebar", "nothing"):
            mine = sorted((one for one in self.late if one["drawn"] == name), key=lambda one: -one["ms"])
            over = sum(one["ms"] > 100 for one in mine)
            out[name] = {"over_50_ms": len(mine), "over_100_ms": over, "worst": mine[:6]}
        return out
