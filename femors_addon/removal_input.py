# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes into a removal: bodies refused or made ready, and how near pairs have to be to be listed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np

from . import settings as declared
from .bodies import Body, Solid, shares
from .cleaning import distinct_nodes
from .crew import together
from .findings import Finding
from .limits import require_nodes
from .mesh import Surface
from .nearest import SurfaceIndex
from .overclosure_check import same_surface
from .overclosure_settings import OverclosureSettings
from .progress import FemorsError
from .separation import thickness
from .transfer_units import LARGEST, SAMPLE, UNITS

WIDEST = 0.2
"""Of the smaller body's size: a gap above it is one in another unit; the note begins at half of it."""
THICK, COARSE, LEAST = 1.5, 2.5, 0.05
"""Of the thickness, the mean edge and the size of a closed body that is to move: a gap above all is too."""
TINY = 100.0  # times smaller than the largest body: a body may be in another unit
PART = 0.08  # of the largest body's size: the least size of what is a part of its joint
MOST = 90.0  # per cent of such a body: a cartilage lies along its bone, and no bead does
BESIDE, BETTER = 0.2, 0.1
"""Of its own size: how near most of such a body lies, and of that share as it is given."""
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
    _check_units(solids)
    for i, one in enumerate(solids):
        for two in solids[:i]:
            if same_surface(one, two):
                raise FemorsError(
                    f"'{two.name}' and '{one.name}' are copies of one surface in one place: leave one out"
                )
    return solids


def _check_units(solids: Sequence[Solid]) -> None:
    """Refuse bodies a hundred times smaller than the largest that would lie along it in another unit.

    They are near nothing as they are, and a check of them would find nothing. A bead or a pin may be as
    small, and anywhere: what counts is how near a body lies as a share of its size.
    """
    large = max(solids, key=lambda solid: solid.surface.diagonal)
    index = None
    for small in solids:
        ratio = large.surface.diagonal / small.surface.diagonal
        factors = [one for one in UNITS if PART <= one / ratio <= LARGEST] if ratio >= TINY else []
        if not factors:
            continue
        index = index or SurfaceIndex(large.surface)
        shares = [_share(large, index, small, factor) for factor in (1.0, *factors)]
        factor = factors[int(np.argmin(shares[1:]))]
        if min(shares[1:]) <= min(BESIDE, BETTER * shares[0]):
            times = f"{factor:g} times larger ({UNITS[factor]} differ so)"
            raise FemorsError(
                f"'{small.name}' is {ratio:.4g} times smaller than '{large.name}', and would lie beside it, "
                f"were it {times}: give both in one unit"
            )


def _share(large: Solid, index: SurfaceIndex, small: Solid, factor: float) -> float:
    """Return how far most of the smaller body is from the larger, by its size, `small` being scaled."""
    points, size = small.vertices * factor, small.surface.diagonal * factor
    if size > large.surface.diagonal:
        points, size = large.vertices / factor, large.surface.diagonal / factor
        index = SurfaceIndex(small.surface)
    away = index.closest(points[:: max(len(points) // SAMPLE, 1)]).distance
    return float(np.percentile(away, MOST)) / size


def band_of(solids: Sequence[Solid], settings: OverclosureSettings) -> float:
    """Return how far apart pairs are listed: as set, or the median of the bodies' mean edges."""
    return settings.band or float(np.median([solid.surface.mean_edge for solid in solids]))


def check_gaps(solids: Sequence[Solid], findings: Iterable[Finding]) -> None:
    """Refuse a gap in another unit: bodies that are thinned by it would be certified.

    Raises
    ------
    FemorsError
        Of a pair that is not clear, and of which a body is to move.
    """
    of = {solid.name: solid for solid in solids}
    unit = "give it in the unit of the coordinates"
    for finding in findings:
        both = [of[name] for name in finding.names]
        if finding.clear or not any(solid.share for solid in both):
            continue
        words, small = f"the gap, {finding.gap:g}, is", min(both, key=lambda solid: solid.surface.diagonal)
        share = finding.gap / small.surface.diagonal
        if share > WIDEST:
            raise FemorsError(f"{words} {share:.0%} of the size of '{small.name}': {unit}")
        for solid in both:
            thick = 0.0 if solid.open_edges or not solid.share else thickness(solid.surface)
            least = max(THICK * thick, COARSE * solid.edge, LEAST * solid.surface.diagonal)
            if thick and finding.gap > least:
                raise FemorsError(
                    f"{words} {finding.gap / thick:.1f} times the thickness of '{solid.name}', which would "
                    f"be thinned by it: {unit}, or hold it rigid"
                )
