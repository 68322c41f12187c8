# SPDX-License-Identifier: GPL-3.0-or-later
"""From the numbers that a deck gives its nodes and elements to indices."""

from __future__ import annotations

import numpy as np

from .cached import cached_property
from .mesh import Int
from .volume_faces import Ids


class Lookup:
    """From the ids (k,) of one scope to indices, which start at `first`."""

    def __init__(self, ids: Ids, first: int) -> None:
        self.ids = ids
        self._order = np.argsort(ids, kind="stable").astype(np.int32)
        self.sorted = ids[self._order]
        self.first = first

    @cached_property
    def _table(self) -> Int | None:
        """The index of every number from the lowest id to the highest; None where those are too far apart."""
        low, high = int(self.sorted[0]), int(self.sorted[-1])
        if high - low > 8 * len(self.sorted) + 100_000:
            return None
        out = np.full(high - low + 1, -1, np.int32)
        out[self.sorted - low] = self._order + np.int32(self.first)
        return out

    def __call__(self, ids: Ids) -> Int:
        """Return the index of each id, -1 where there is none."""
        if not len(self.sorted):
            return np.full(len(ids), -1, np.int32)
        low = self.sorted[0]
        if self._table is not None:
            inside = (ids >= low) & (ids <= self.sorted[-1])
            return np.where(inside, self._table[np.where(inside, ids - low, 0)], np.int32(-1))
        place = np.minimum(np.searchsorted(self.sorted, ids), len(self.sorted) - 1)
        found = self.sorted[place] == ids
        return np.where(found, self._order[place] + np.int32(self.first), np.int32(-1))

    def between(self, low: int, high: int, step: int) -> Int:
        """Return the indices of the ids low, low + step ... up to high that there are."""
        start, stop = np.searchsorted(self.sorted, [low, high + 1])
        ids = self.sorted[start:stop]
        return self._order[start:stop][(ids - low) % step == 0] + np.int32(self.first)

    def twins(self) -> tuple[int, int] | None:
        """Return the indices of the first two that share an id, or None."""
        same = np.flatnonzero(self.sorted[1:] == self.sorted[:-1])
        if not len(same):
            return None
        one, two = self._order[[same[0], same[0] + 1]] + self.first
        return int(one), int(two)
