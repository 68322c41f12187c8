# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of the machine a computation may take; of the whole process, as the machine is."""

from __future__ import annotations

import os
from typing import ClassVar

from .progress import FemorsError

MB = 1e6
EACH = 0.2  # of what a job needs: what each further thread holds besides, at most, as was measured


class Limits:
    """What is allowed.

    Attributes
    ----------
    threads : int
        For whatever can be done side by side, see `crew`; results do not depend on it.
    memory : float
        Bytes that a job may need; 0 for as many as there are.
    """

    threads: ClassVar[int] = 1
    memory: ClassVar[float] = 0.0


def allow(threads: int, megabytes: float) -> None:
    """Set the limits; 0 threads are as many as the machine has processors, 0 MB is no limit."""
    Limits.threads = threads if threads > 0 else (os.cpu_count() or 1)
    Limits.memory = max(megabytes, 0.0) * MB


def require_memory(needed: float, what: str) -> None:
    """Raise `FemorsError` where a job, which needs so many bytes in one thread, needs more than allowed."""
    needed *= 1.0 + EACH * (Limits.threads - 1)
    if Limits.memory and needed > Limits.memory:
        raise FemorsError(
            f"{what} needs about {needed / MB:.0f} MB of memory, and the limit in the preferences is "
            f"{Limits.memory / MB:.0f} MB: raise it, or reduce the meshes"
        )


def require_nodes(nodes: int, what: str, least: float, each: float) -> None:
    """Raise `FemorsError` where a job on so many nodes would need more bytes than are allowed.

    Parameters
    ----------
    nodes : int
        Of all meshes and points of the job.
    what : str
        The job, such as "a transfer".
    least, each : float
        Bytes that such a job was measured to take, and per node.
    """
    require_memory(least + each * nodes, f"{what} with {nodes} nodes in all")
