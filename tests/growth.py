# SPDX-License-Identifier: GPL-3.0-or-later
"""How work grows with its input: a ratio of two times in one run, whatever the machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

LINEAR = 24.0
"""Work on eight times as much takes about eight times as long, or 64 times where it is quadratic."""


def growth(work: Callable[[Any], Any], small: Any, large: Any) -> float:
    """Return how many times as much CPU time work takes on the large input: the least of three of each."""
    least = []
    for given in (small, large):
        times = []
        for _ in range(3):
            start = time.process_time()
            work(given)
            times.append(time.process_time() - start)
        least.append(min(times))
    return least[1] / max(least[0], 1e-9)
