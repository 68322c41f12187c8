# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes that two closed surfaces share, and in which they differ (XOR), by columns of the grid.

Straight lines run through both surfaces; along each the lengths inside one, the other and both are exact.
Only across the lines is it a sum over a grid. Three directions give three values: their mean is the
estimate, half of their range its uncertainty.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from .crew import over
from .mesh import Float, Surface
from .progress import FemorsError
from .raster import fragments

LINES = 320  # along the longer side of the grid
OFFSET = (0.137, 0.291)  # of a cell, so that lines meet no edge of a mesh that is as regular as the grid
TORN = 0.01  # share of lines that may be counted out where a surface is not quite closed


@dataclasses.dataclass(frozen=True)
class Overlap:
    """Volumes of two closed surfaces.

    Attributes
    ----------
    first, second : float
        Inside of each.
    common : float
        Inside of both.
    xor : float
        Inside of one only.
    xor_uncertainty : float
    """

    first: float
    second: float
    common: float
    xor: float
    xor_uncertainty: float

    @property
    def dice(self) -> float:
        """Twice the common volume over the sum of both: 1 where they are the same."""
        both = self.first + self.second
        return 2.0 * self.common / both if both > 0 else 0.0


def overlap(first: Surface, second: Surface, lines: int = LINES) -> Overlap:
    """Measure what two surfaces share; both closed, and wound consistently (see `cleaning.clean`).

    Raises
    ------
    FemorsError
        One of them is open.
    """
    for surface, name in ((first, "the first mesh"), (second, "the second mesh")):
        if surface.border.any():
            raise FemorsError(f"{name} is open, so that it has no volume: close its holes")
    low = np.minimum(first.bounds[0], second.bounds[0])
    high = np.maximum(first.bounds[1], second.bounds[1])
    cell = float((high - low).max()) / lines
    found = np.array(list(over(lambda axis: _along(axis, first, second, low, high, cell), range(3))))
    one, two, common = found.mean(axis=0)
    xor = found[:, 0] + found[:, 1] - 2.0 * found[:, 2]
    apart = max(0.0, float(xor.mean()))  # of two that are the same, rounding may be below nothing
    return Overlap(float(one), float(two), float(common), apart, float(np.ptp(xor) / 2.0))


def _along(axis: int, first: Surface, second: Surface, low: Float, high: Float, cell: float) -> Float:
    """Return the volumes (first, second, common) by lines along an axis."""
    across = [(axis + 1) % 3, (axis + 2) % 3]
    width, height = (int(np.ceil((high[k] - low[k]) / cell)) + 1 for k in across)
    lines, places, turns, owners = [], [], [], []
    for mesh, surface in enumerate((first, second)):
        corners = surface.corners
        flat = (corners[..., across] - low[across]) / cell + np.array(OFFSET)
        facing = np.sign(surface.face_cross[:, axis])
        for at, face, share in fragments(flat, width, height):
            lines.append(at)
            places.append(np.einsum("kc,kc->k", share, corners[face][..., axis]))
            turns.append(-facing[face])  # a line that meets a face from outside goes in
            owners.append(np.full(len(at), mesh))
    line, place, turn, owner = (np.concatenate(one) for one in (lines, places, turns, owners))
    count = width * height
    torn = np.zeros(count, dtype=bool)
    for mesh in (0, 1):
        torn |= np.bincount(line[owner == mesh], turn[owner == mesh], minlength=count) != 0
    met = np.unique(line)
    if torn[met].mean() > TORN:
        raise FemorsError("the surfaces are not closed or not wound one way: clean them first")
    kept = ~torn[line]
    line, place, turn, owner = line[kept], place[kept], turn[kept], owner[kept]
    order = np.lexsort((place, line))
    line, place, turn, owner = line[order], place[order], turn[order], owner[order]
    inside = [np.cumsum(np.where(owner == mesh, turn, 0))[:-1] > 0 for mesh in (0, 1)]
    length = np.where(line[1:] == line[:-1], np.diff(place), 0.0)
    sums = [length[inside[0]].sum(), length[inside[1]].sum(), length[inside[0] & inside[1]].sum()]
    # a line that was counted out stands for its neighbours
    return np.array(sums) * cell**2 * len(met) / max(len(met) - int(torn[met].sum()), 1)
