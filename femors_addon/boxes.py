# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes around bodies: of many, most pairs are nowhere near each other, and these tell so at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from .mesh import Float, Surface


class Boxes:
    """Axis-aligned bounding boxes of surfaces, as they are when this is made."""

    def __init__(self, surfaces: Sequence[Surface]) -> None:
        corners = [surface.bounds for surface in surfaces]
        self._low, self._high = (np.array([c[end] for c in corners]).reshape(-1, 3) for end in (0, 1))

    def apart(self, pairs: ArrayLike) -> Float:
        """Return how far apart boxes are (k,), along the axis where that is most; negative if they overlap.

        No point of one surface is nearer to the other than that.

        Parameters
        ----------
        pairs : (k, 2) int
            The two surfaces by their numbers.
        """
        one, two = np.asarray(pairs, dtype=np.int64).reshape(-1, 2).T
        low = np.maximum(self._low[one], self._low[two])
        return np.asarray((low - np.minimum(self._high[one], self._high[two])).max(axis=1))
