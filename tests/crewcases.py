# SPDX-License-Identifier: GPL-3.0-or-later
"""Threads for a test, and which of them has done a part of a job."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator

from femors_addon import limits


@contextlib.contextmanager
def three_threads() -> Iterator[None]:
    """Let three threads work, and see that none is left."""
    before = limits.Limits.threads, limits.Limits.memory
    limits.allow(3, 0)
    yield
    limits.Limits.threads, limits.Limits.memory = before
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("femors-")]


def who(_part: int = 0) -> threading.Thread:
    time.sleep(0.002)  # for the others to take a part
    return threading.current_thread()  # kept: numbers come again
