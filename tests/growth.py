# SPDX-License-Identifier: GPL-3.0-or-later
"""How work grows with its input, whatever the machine: a ratio of two times in one run, or calls counted."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from types import FrameType
from typing import Any

LINEAR = 24.0
"""Work on eight times as much takes about eight times as long, or 64 times where it is quadratic."""


def growth(work: Callable[[Any], Any], small: Any, large: Any) -> float:
    """Return how many times as much CPU time work takes on the large input.

    The least time of each counts, of three rounds that take turns, or of as many as twelve where the
    ratio is not below `LINEAR` yet: other work on the machine only ever adds time, to both.
    """
    least = [float("inf")] * 2
    for turn in range(12):
        for which, given in enumerate((small, large)):
            start = time.process_time()
            work(given)
            least[which] = min(least[which], max(time.process_time() - start, 1e-9))
        if turn >= 2 and least[1] < LINEAR * least[0]:
            break
    return least[1] / least[0]


def calls(work: Callable[[Any], Any], given: Any) -> int:
    """Return how many calls work makes, of Python's functions and of compiled ones, in this thread.

    Work that takes whole arrays makes as many on a large input as on a small one; memory and caches,
    which make times jump where an input no longer fits, do not change them.
    """
    count = 0

    def note(frame: FrameType, event: str, argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        work(given)
    finally:
        sys.setprofile(before)
    return count
