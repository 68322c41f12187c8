# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of the machine a computation may take; of the whole process, as the machine is."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import ClassVar, TypeVar

from .progress import FemorsError

MB = 1e6

Part = TypeVar("Part")
Outcome = TypeVar("Outcome")


class Limits:
    """What is allowed.

    Attributes
    ----------
    threads : int
        For searches for closest points, and the two sides of a pair; results do not depend on it.
    memory : float
        Bytes that a job may need; 0 for as many as there are.
    """

    threads: ClassVar[int] = 1
    memory: ClassVar[float] = 0.0


def allow(threads: int, megabytes: float) -> None:
    """Set the limits; 0 threads are as many as the machine has processors, 0 MB is no limit."""
    Limits.threads = threads if threads > 0 else (os.cpu_count() or 1)
    Limits.memory = max(megabytes, 0.0) * MB


def side_by_side(work: Callable[[Part], Outcome], parts: Iterable[Part]) -> list[Outcome]:
    """Return what work returns for each part, in order; in threads, where more than one is allowed.

    What the work changes must not be looked at by that on another part.
    """
    if Limits.threads < 2:
        return [work(part) for part in parts]
    with ThreadPoolExecutor(Limits.threads) as pool:
        return list(pool.map(work, parts))


def require_memory(needed: float, what: str) -> None:
    """Raise `FemorsError` where a job would need more bytes than are allowed."""
    if Limits.memory and needed > Limits.memory:
        raise FemorsError(
            f"{what} needs about {needed / MB:.0f} MB of memory, and the limit in the preferences is "
            f"{Limits.memory / MB:.0f} MB: raise it, or reduce the meshes"
        )
