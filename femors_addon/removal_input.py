# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes into a removal: bodies refused or made ready, and how near pairs have to be to be listed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from . import settings as declared
from .bodies import Body, Solid, shares
from .cleaning import distinct_nodes
from .crew import together
from .limits import require_nodes
from .mesh import Surface
from .overclosure_check import same_surface
from .overclosure_settings import OverclosureSettings
from .progress import FemorsError

MEMORY_LEAST, MEMORY_NODE = 10e6, 2.6e3  # bytes: what a removal was measured to take, and per node of all


def nodes_of(bodies: Sequence[Body]) -> int:
    """Return how many nodes bodies have in all, each counted once where triangles are not merged."""
    return sum(distinct_nodes(b.mesh) if isinstance(b.mesh, Surface) else len(b.nodes) for b in bodies)


def solids_of(bodies: Sequence[Body], settings: OverclosureSettings) -> list[Solid]:
    """Return the bodies at work; refuse what cannot be worked with."""
    declared.check(settings)
    require_nodes(nodes_of(bodies), f"overclosure of {len(bodies)} bodies", MEMORY_LEAST, MEMORY_NODE)
    if len(bodies) < 2:
        raise FemorsError(f"{len(bodies)} body given; overclosure needs at least two")
    names = [body.name for body in bodies]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise FemorsError(f"two bodies are named '{twice}'; each needs a name of its own")
    solids = together(
        [partial(Solid, body, share) for body, share in zip(bodies, shares(list(bodies)), strict=True)]
    )
    for i, one in enumerate(solids):
        for two in solids[:i]:
            if same_surface(one, two):
                raise FemorsError(
                    f"'{two.name}' and '{one.name}' are copies of one surface in one place: leave one out"
                )
    return solids


def band_of(solids: Sequence[Solid], settings: OverclosureSettings) -> float:
    """Return how far apart pairs are listed: as set, or the median of the bodies' mean edges."""
    return settings.band or float(np.median([solid.surface.mean_edge for solid in solids]))
