# SPDX-License-Identifier: GPL-3.0-or-later
"""What a computation says while it runs, and the two ways in which it ends early."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

Progress = Callable[[float, str], None]
"""``progress(fraction, text)``: fraction in [0, 1]; may raise `Cancelled` at any call.

It is called from the thread that has begun the computation, never from those that it starts.
"""


Preview = Callable[[Any], None]
"""``preview(vertices)``: positions (n, 3) that a mesh has by now, all of its vertices in their order.

An optional argument of long computations, for a window that shows the mesh move. It is called from time
to time, from the thread that computes, must not keep it waiting, and changes nothing in the result.
"""


class FemorsError(ValueError):
    """Input that cannot be worked with: one line that says what is wrong and what to do."""


class Cancelled(Exception):
    """Raised out of `Progress` when the user has cancelled; nothing is left half done."""


def listed(names: Iterable[str], most: int = 6) -> str:
    """Return names, or other words, for a message: the first ones where there are many."""
    every = list(names)
    return ", ".join(every[:most]) + (", ..." if len(every) > most else "")


def counted(count: int, one: str, many: str = "") -> str:
    """Return so many things in words: "1 face", "2 faces"; `many` where it is not `one` with an s."""
    return f"{count} {one if count == 1 else many or one + 's'}"


def silent(fraction: float, text: str) -> None:
    """Report to nobody and never cancel."""


def unseen(vertices: Any) -> None:
    """Show to nobody."""


def part(progress: Progress, start: float, stop: float) -> Progress:
    """Map a sub-task's [0, 1] onto [start, stop] of the task it belongs to."""
    return lambda fraction, text: progress(start + (stop - start) * fraction, text)


def rising(progress: Progress) -> Progress:
    """Report no less than before: rounds of a task begin anew, and nobody knows how many there will be."""
    most = 0.0

    def told(fraction: float, text: str) -> None:
        nonlocal most
        most = max(most, fraction)
        progress(most, text)

    return told


def repeating(progress: Progress, fraction: float, text: str) -> Progress:
    """Report the same from all of a sub-task: it may be cancelled, and its parts mean nothing to a user."""
    return lambda _fraction, _text: progress(fraction, text)
