# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether what is to be carried is in the unit of length, and in the axes, of the field that carries it.

Nothing tells it but where the things would lie in others: on the field's source, or nowhere near.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from .mesh import Float
from .nearest import SurfaceIndex

FAR = 0.05  # of the source's size: what lies farther out is not by it
ON = 0.002  # of the source's size: what is so near is on its surface
SMALL = 0.01  # of the source's size: points that span less and are not on it may be in another unit
UNLIKE = 20.0  # times the source's size, or as small a part of it: a mesh may be in another unit
LARGEST = 4.0  # times the source's size: a unit that makes a thing larger is not its own
UNITS = {
    10.0: "millimetres and centimetres",
    25.4: "millimetres and inches",
    100.0: "centimetres and metres",
    1000.0: "millimetres and metres",
    1e6: "micrometres and metres",
}
MARKS = 0.01  # of their span: landmarks nearer the source in the median are in its unit
BETTER = 0.1  # of that share: what another unit must bring it down to
SPANS = (0.05, 2.0)  # of the source's size: what landmarks in its unit span
TURN = np.array((-1.0, -1.0, 1.0))  # from LPS to RAS, and back
TURNED = 4  # landmarks, at least, that tell other axes
SAMPLE = 2000  # points that are looked at


@dataclasses.dataclass(frozen=True, eq=False)
class FieldUnit:
    """The unit of a field, known by what its things are carried off.

    Parameters
    ----------
    index : SurfaceIndex or None
        The surface that they are carried off; None for a field without faces, of which nothing is said.
    name : str
        What a sentence calls it: the source (or the target) of the field of that name.
    """

    index: SurfaceIndex | None
    name: str

    def small(self, points: Float) -> list[str]:
        """Return what to say of points (p, 3) that lie closer together than things on a source do."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        if self.index is None or len(points) < 3:
            return []
        size, span = self.index.surface.diagonal, _span(points)
        if span >= SMALL * size or np.median(self.index.closest(points).distance) <= ON * size:
            return []
        return [f"the points span {span:.3g}, the field's surface {size:.3g}: another unit (metres)?"]

    def of_landmarks(self, points: Float) -> list[str]:
        """Return faults of landmarks (p, 3) that lie on the surface in another unit or axes than theirs.

        Their own unit may put them near it by chance (in metres all are at the origin, which may lie in the
        bone), so that what counts is their distance as a share of their span.
        """
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        span = _span(points)
        if self.index is None or len(points) < 3 or not span > 0:
            return []
        size, sample = self.index.surface.diagonal, points[:: max(len(points) // SAMPLE, 1)]

        def share(factor: float, turned: bool = False) -> float:
            return self._away(sample * factor * (TURN if turned else 1.0)) / (span * factor)

        own = share(1.0)
        if own <= MARKS:
            return []
        factors = [1.0, *(one for unit in UNITS for one in (unit, 1.0 / unit))]
        fit = [one for one in factors if SPANS[0] <= span * one / size <= SPANS[1]]
        for turned in (False, True)[: 1 + (len(points) >= TURNED)]:
            shares = [share(one, turned) for one in fit]
            if shares and min(shares) <= min(BETTER * own, MARKS):
                return [self._otherwise(fit[int(np.argmin(shares))], turned)]
        return []

    def _otherwise(self, factor: float, turned: bool) -> str:
        """Say in which unit, or in which axes, landmarks would lie on the surface."""
        if turned:
            also = "" if factor == 1.0 else f" and they {factor:g} times as large"
            return (
                f"the landmarks would lie on the {self.name}, were x and y of the other sign{also}: probably "
                "in other axes (LPS, RAS); turn them, or set the axes of the meshes"
            )
        larger, ratio = ("larger", factor) if factor > 1 else ("smaller", 1.0 / factor)
        unit = min(UNITS, key=lambda one: abs(one - ratio))
        return (
            f"the landmarks would lie on the {self.name}, were they {unit:g} times {larger}: {_units(unit)}"
        )

    def unlike(self, points: Float) -> tuple[list[str], list[str]]:
        """Return notes and faults on a mesh's points (p, 3) that are far larger or smaller than the source.

        A part may have any size, so the unit that brings it nearest to the source, for the size that it has
        then, is taken for its own; it is a fault where that is another. A small mesh by the source's surface
        in the field's unit, such as a graft or a screw, is left alone.
        """
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        span = _span(points)
        if self.index is None or not span > 0:
            return [], []
        size = self.index.surface.diagonal
        if 1 / UNLIKE <= span / size <= UNLIKE:
            return [], []
        large = span > size
        ratio = span / size if large else size / span
        sample = points[:: max(len(points) // SAMPLE, 1)]

        def away(factor: float) -> float:
            return self._away(sample / factor if large else sample * factor)

        fit = [one for one in UNITS if (ratio / one if large else one / ratio) <= LARGEST] or [max(UNITS)]
        fit += [] if large else [1.0]
        factor = min(fit, key=lambda one: away(one) * (one if large else 1.0 / one))
        if factor == 1.0 and away(1.0) <= FAR * size:
            return [], []
        words = f"is {ratio:.4g} times {'larger' if large else 'smaller'} than the {self.name}"
        return ([words], []) if factor == 1.0 else ([], [f"{words}: {_units(factor)}"])

    def _away(self, points: Float) -> float:
        assert self.index is not None
        return float(np.median(self.index.closest(points).distance))


def _span(points: Float) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0


def _units(factor: float) -> str:
    return f"probably in another unit of length ({UNITS[factor]} differ by {factor:g}); give both in one unit"
