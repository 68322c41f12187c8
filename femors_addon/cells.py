# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums of Gaussian weights over the centres within reach, cube by cube, in single precision."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from .cached import cached_property
from .limits import in_threads
from .mesh import Float, Int, Single
from .progress import Progress, silent

LN2 = math.log(2.0)
MOST = 1e5  # cells along an axis: more than a 64-bit key could count
WIDEST = 3.0  # cut-off lengths that a cell may measure: single precision bears no more
CELL_FILL = 6  # centres a cell, at least, on average
CACHED = 1_000_000  # kernel values of a meeting of cells at a time: 4 MB, for the processor's cache
TOGETHER = 1_000_000  # kernel values between two reports of progress, and handed to a thread at once
CALLS = 30_000  # kernel values that take as long as the calls for one meeting of cells

Meeting = tuple[slice, list[slice]]  # queries of one cell, centres of the 27 around it


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
            # a cell costs a few calls: fewer, fuller cells are cheaper where the spread is tiny
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

    def meetings(self, cell: Int) -> Iterator[Meeting]:
        """Yield (queries, centres of the 27 cells around theirs) for each cell that has both.

        Parameters
        ----------
        cell : (p, 3) int
            The cells of the queries, sorted by key; the queries are a range of these.

        Centres are given as ranges in `order`.
        """
        keys = self._key(cell)
        first = np.flatnonzero(np.concatenate((np.ones(min(len(keys), 1), bool), keys[1:] != keys[:-1])))
        starts, stops = self._bounds(keys[first])
        for i, (start, stop) in enumerate(zip(starts.tolist(), stops.tolist(), strict=True)):
            ranges = [slice(a, b) for a, b in zip(start, stop, strict=True) if b > a]
            if ranges:
                yield slice(int(first[i]), int(first[i + 1]) if i + 1 < len(first) else len(keys)), ranges

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
        width = np.float32(self.size * scale)
        cell = _cell(self.centres[self.order], self.low, self.size)
        # all that a meeting needs of its centres, side by side: values, place in the cell, cell
        packed = np.empty((len(self.order), k + 6), np.float32)
        packed[:, :k] = values[self.order]
        packed[:, k : k + 3] = self._within(self.centres[self.order], cell, scale)
        packed[:, k + 3 :] = cell
        cell = _cell(points, self.low, self.size)
        inside = np.flatnonzero(((cell >= 0) & (cell < self.shape)).all(axis=1))
        rows = inside[np.argsort(self._key(cell[inside]), kind="stable")]
        cell = cell[rows]
        x = self._within(points[rows], cell, scale)
        # 2 x c - c^2 + (shift - x^2) in one product
        left = np.empty((len(rows), 5), np.float32)
        np.multiply(x, 2.0, out=left[:, :3])
        left[:, 3] = 1.0
        left[:, 4] = -_square(x) if shift is None else shift[rows] - _square(x)
        found = np.zeros((len(rows), k), np.float32)

        def meet(some: list[Meeting]) -> int:
            for queries, ranges in some:
                near = np.concatenate([packed[part] for part in ranges])
                c = near[:, k + 3 :] - cell[queries.start].astype(np.float32)
                c *= width
                c += near[:, k : k + 3]
                right = np.empty((5, len(near)), np.float32)
                right[:3] = c.T
                np.negative(_square(c), out=right[3])
                right[4] = 1.0
                step = max(CACHED // len(near), 16)
                for at in range(queries.start, queries.stop, step):
                    part = slice(at, min(at + step, queries.stop))
                    weights = left[part] @ right
                    np.exp(weights, out=weights)
                    np.matmul(weights, near[:, :k], out=found[part])
            return some[-1][0].stop

        meetings = np.count_nonzero(np.diff(self._key(cell))) + 1
        # where each has little to work on, threads would only wait for each other's calls
        each = in_threads if len(rows) * self.typical > CALLS * meetings else map
        for done in each(meet, _together(self.meetings(cell))):
            progress(done / len(points), "displacement field")
        out = np.zeros((len(points), k), np.float32)
        out[rows] = found
        return out

    def _key(self, cell: Int) -> Int:
        return np.asarray((cell[:, 0] * self.shape[1] + cell[:, 1]) * self.shape[2] + cell[:, 2])

    def _within(self, points: Float, cell: Int, scale: float) -> Single:
        """Place (p, 3) of points in their cells, from the middle of each, times `scale`."""
        return ((points - self.low - (cell - 0.5) * self.size) * scale).astype(np.float32)


def _together(meetings: Iterator[Meeting]) -> Iterator[list[Meeting]]:
    """Yield meetings of cells in lists of about as much work."""
    some, work = [], 0
    for queries, ranges in meetings:
        some.append((queries, ranges))
        work += (queries.stop - queries.start) * sum(part.stop - part.start for part in ranges) + CALLS
        if work > TOGETHER:
            yield some
            some, work = [], 0
    if some:
        yield some


def _cell(points: Float, low: Float, size: float) -> Int:
    """Cell (p, 3) int64 of each point; the first that has centres is 1."""
    return np.asarray(np.floor((points - low) / size).astype(np.int64) + 1)


def _square(vectors: Single) -> Single:
    """Squared length (k,) of each row, in the rows' precision."""
    return np.asarray(np.einsum("ij,ij->i", vectors, vectors))
