# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums of Gaussian weights over the centres within reach, cube by cube, in single precision."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise

import numpy as np

from .cached import cached_property
from .crew import at_once, over
from .mesh import Float, Int, Single
from .progress import Progress, silent

LN2 = math.log(2.0)
MOST = 1e5  # cells along an axis: more than a 64-bit key could count
WIDEST = 3.0  # cut-off lengths that a cell may measure: single precision bears no more
CELL_FILL = 6  # centres a cell, at least, on average
# kernel values in one call: 1.6 MB, for the processor's cache, and one to two milliseconds
TOGETHER = 400_000
HANDED = 4  # such calls that a thread is given at once: it takes a tenth of a millisecond to give
LARGEST = 3_200_000  # the same where one cell meets tens of thousands of centres
FEWEST, MOST_QUERIES = 16, 128  # queries of one cell in one call, where it has as many
FEW, FILLED = 32, (4, 16)  # queries: counts are filled up to a multiple of these, up to so many and beyond
# multiplications in a product of two matrices: where there are more, OpenBLAS lets one thread at a time go
LOCKED = 260_000
NOTHING = -1e4  # exponent of a weight that is to be nothing


@dataclasses.dataclass(frozen=True, eq=False)
class Cells:
    """Centres sorted into cubes of one cut-off length, so that 27 cubes hold all within reach."""

    size: float
    low: Float
    shape: tuple[int, int, int]
    centres: Float  # (n, 3)
    keys: Int  # (n,) cell of each centre, ascending
    order: Int  # (n,) centre indices in that order

    @classmethod
    def of(cls, centres: Float, size: float) -> Cells:
        low = centres.min(axis=0)
        widest = WIDEST * size
        size = max(size, float(np.ptp(centres, axis=0).max()) / MOST)
        while True:
            cell = _cell(centres, low, size)
            nx, ny, nz = (int(n) for n in cell.max(axis=0) + 2)
            keys = (cell[:, 0] * ny + cell[:, 1]) * nz + cell[:, 2]
            order = np.argsort(keys, kind="stable")
            keys = keys[order]
            # each cell's neighbours are looked up: fewer, fuller cells are cheaper where the spread is tiny
            full = np.count_nonzero(np.diff(keys)) * CELL_FILL < len(keys)
            if full or size > widest:
                return cls(size, low, (nx, ny, nz), centres, keys, order)
            size *= 1.5

    @cached_property
    def typical(self) -> float:
        """Centres in the 27 cells around a centre, on average over a sample."""
        sample = self.keys[:: max(len(self.keys) // 256, 1)]
        start, stop = self._bounds(sample)
        return float((stop - start).sum(axis=1).mean())

    def _bounds(self, keys: Int) -> tuple[Int, Int]:
        """Where the nine rows of three cells around cells (k,) start and stop in `order`, (k, 9) each."""
        plane, row = self.shape[1] * self.shape[2], self.shape[2]
        around = np.array([i * plane + j * row for i in (-1, 0, 1) for j in (-1, 0, 1)])
        base = np.asarray(keys)[:, None] + around
        start = np.searchsorted(self.keys, base - 1, side="left")
        return start, np.searchsorted(self.keys, base + 1, side="right")

    def sums(
        self,
        values: Float,
        spread: float,
        points: Float,
        shift: Float | None = None,
        progress: Progress = silent,
    ) -> Single:
        """Return the sums (p, k) float32 of the values (n, k) of the centres, weighted at points (p, 3).

        A weight is exp(-ln2 (r / spread)^2), times exp(shift) with `shift` (p,); those of centres farther
        than the size of a cell may be left out, and are zero for points more than a cell from all centres.
        """
        scale, k = math.sqrt(LN2) / spread, values.shape[1]
        (place, given), (rows, keys, middle, left) = at_once(
            lambda _: self._laid_out(values, scale), lambda _: self._asked(points, shift, scale)
        )
        found = np.zeros((len(rows), k), np.float32)
        meetings = self._meetings(keys)

        def meet(some: slice) -> int:
            first, query = meetings.first[some], meetings.queries(some)
            index, none = meetings.centres(some)
            right = np.empty((len(first), 5, index.shape[1]), np.float32)
            for axis in range(3):
                here = middle[axis, first][:, None]
                np.subtract(place[axis].take(index), here, out=right[:, axis], casting="same_kind")
            np.negative(_square(right[:, :3].swapaxes(0, 1)), out=right[:, 3])
            right[:, 3][none] = NOTHING
            right[:, 4] = 1.0
            query = _in_parts(query, right[0].size)
            weights = np.matmul(left.take(query, axis=0), right[:, None])
            np.exp(weights, out=weights)
            found[query] = np.matmul(weights, given.take(index, axis=0)[:, None])
            return some.stop

        blocks = meetings.blocks()
        parts = (blocks[start : start + HANDED] for start in range(0, len(blocks), HANDED))
        for stops in over(lambda part: [meet(some) for some in part], parts):
            progress(stops[-1] / len(meetings.first), "displacement field")
        out = np.zeros((len(points), k), np.float32)
        out[rows] = found
        return out

    def _laid_out(self, values: Float, scale: float) -> tuple[Float, Single]:
        """Return the centres' places (3, n) times `scale`, and their values (n, k), cell by cell."""
        place = np.ascontiguousarray(((self.centres[self.order] - self.low) * scale).T)
        return place, values[self.order].astype(np.float32)

    def _asked(self, points: Float, shift: Float | None, scale: float) -> tuple[Int, Int, Float, Single]:
        """Return which points (q,) lie among the cells, cell by cell; of each cell the key (q,) and the
        middle (3, q) times `scale`; (q, 5) what gives exponents when multiplied by a centre's (c, -c^2, 1).
        """
        cell = _cell(points, self.low, self.size)
        inside = np.flatnonzero(((cell >= 0) & (cell < self.shape)).all(axis=1))
        rows = inside[np.argsort(self._key(cell[inside]), kind="stable")]
        cell = cell[rows]
        # single precision bears the places within a few cells: they are taken from the middle of the query's
        middle = np.ascontiguousarray((cell - 0.5).T) * (self.size * scale)
        x = (((points[rows] - self.low) * scale).T - middle).astype(np.float32)
        # 2 x c - c^2 + (shift - x^2) in one product
        left = np.empty((len(rows), 5), np.float32)
        np.multiply(x.T, 2.0, out=left[:, :3])
        left[:, 3] = 1.0
        left[:, 4] = -_square(x) if shift is None else shift[rows] - _square(x)
        return rows, self._key(cell), middle, left

    def _meetings(self, keys: Int) -> _Meetings:
        """Return which queries, whose cells are `keys` (p,), ascending, meet which centres."""
        first = np.flatnonzero(np.concatenate((np.ones(min(len(keys), 1), bool), keys[1:] != keys[:-1])))
        start, stop = self._bounds(keys[first])
        length = stop - start
        centres = length.sum(axis=1)
        queries = np.diff(first, append=len(keys))
        # queries of one cell in parts, none where no centre is near
        most = np.clip(LARGEST // np.maximum(centres, 1), FEWEST, MOST_QUERIES)
        parts = -(-queries // most) * (centres > 0)
        cell = np.repeat(np.arange(len(first)), parts)
        nth = np.arange(len(cell)) - np.repeat(np.cumsum(parts) - parts, parts)
        begin = first[cell] + nth * most[cell]
        count = np.minimum(most[cell], first[cell] + queries[cell] - begin)
        # those of like sizes stand together: little is to be filled up
        order = np.lexsort((centres[cell], _filled(count)))
        cell = cell[order]
        return _Meetings(begin[order], count[order], start[cell], length[cell])

    def _key(self, cell: Int) -> Int:
        return np.asarray((cell[:, 0] * self.shape[1] + cell[:, 1]) * self.shape[2] + cell[:, 2])


@dataclasses.dataclass(frozen=True, eq=False)
class _Meetings:
    """Queries of a cell and the centres in the 27 around it, m times; computed by blocks of like sizes."""

    first: Int  # (m,) the first query
    count: Int  # (m,) of queries, which follow each other
    start: Int  # (m, 9) where the rows of three cells start among the centres
    length: Int  # (m, 9) how many centres they have

    def blocks(self) -> list[slice]:
        """Cut into blocks of at most about `TOGETHER` kernel values, filled up to as many queries each."""
        filled = _filled(self.count)
        centres = self.length.sum(axis=1)
        # no block has one of more than twice as many centres as another: that is how far they are filled up
        like = np.stack((filled, np.frexp(centres)[1], np.cumsum(filled * centres) // TOGETHER))
        cut = np.flatnonzero((like[:, 1:] != like[:, :-1]).any(axis=0)) + 1
        return [slice(a, b) for a, b in pairwise([0, *cut.tolist(), len(self.count)]) if b > a]

    def queries(self, some: slice) -> Int:
        """Return the queries (b, q) of a block, filled up with the last of each."""
        count = self.count[some, None]
        return self.first[some, None] + np.minimum(np.arange(_filled(count[:1]).item()), count - 1)

    def centres(self, some: slice) -> tuple[Int, np.ndarray]:
        """Return the centres (b, c) of a block, filled up with the first of each, and which are filling."""
        length = self.length[some]
        total = length.sum(axis=1)
        flat = length.ravel()
        there = np.repeat(self.start[some].ravel() - np.cumsum(flat) + flat, flat) + np.arange(total.sum())
        index = np.repeat(there[np.cumsum(total) - total], total.max()).reshape(len(total), -1)
        filling = np.arange(index.shape[1]) >= total[:, None]
        index[~filling] = there
        return index, filling


def _filled(count: Int) -> Int:
    """Return counts of queries filled up."""
    to = np.where(count > FEW, FILLED[1], FILLED[0])
    return np.asarray(-(-count // to) * to)


def _in_parts(query: Int, each: int) -> Int:
    """Return queries (b, q) as (b, parts, q / parts): products of `each` a query, `LOCKED` if need be."""
    size = query.shape[1]
    while size * each > LOCKED and size > FEWEST and size % 2 == 0:
        size //= 2
    return query.reshape(len(query), -1, size)


def _cell(points: Float, low: Float, size: float) -> Int:
    """Cell (p, 3) int64 of each point; the first that has centres is 1."""
    return np.asarray(np.floor((points - low) / size).astype(np.int64) + 1)


def _square(vectors: Single) -> Single:
    """Squared length (...) of vectors (3, ...), in their precision."""
    return np.asarray(vectors[0] * vectors[0] + vectors[1] * vectors[1] + vectors[2] * vectors[2])
