# SPDX-License-Identifier: GPL-3.0-or-later
"""The generalized regression neural network: one smooth field from scattered displacement vectors.

    field(x) = sum_i w_i d_i / sum_i w_i,    w_i = exp(-ln2 (|x - x_i| / s)^2)

Specht (1991); the spread s is the distance at which a centre's weight has fallen to one half, as in
MATLAB's ``newgrnn``. `DisplacementField.exact` is the definition, in blocks. Calling the field takes
the fastest way that fits the spread, within `TOLERANCE` of the largest displacement:

- *blocks*: with its nearest centre a spreads away, a query leaves out centres farther than
  sqrt(a^2 + CUT^2) spreads; queries and centres are gathered cell by cell and multiplied by BLAS in
  single precision. Where centres are spread evenly over a surface, what is left out weighs 2^-CUT^2
  of what is kept.
- *grid*: for spreads that span many centres. Displacements and weights are laid on a regular grid by
  cubic B-splines, smoothed by separable Gaussians (narrowed by what the splines themselves smooth)
  and read back by the same splines.
- *far*: beyond `REACHES` the nearest centres alone, as many as the bound asks for. Weights are taken
  relative to the nearest centre's (log-sum-exp): the field goes over to its value, never to 0 / 0.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage, sparse
from scipy.spatial import cKDTree

from .limits import in_threads
from .mesh import Float, Int, frozen
from .progress import FemorsError, Progress, silent

LN2 = math.log(2.0)
TOLERANCE = 1e-4
CUT = 3.9
ROUGH, ROUGH_CUT, ROUGH_GRID = 2e-3, 3.2, 2.2  # the same three, for steps that are measured anew
REACHES = (1.3, 3.0, 6.0)  # spreads to the nearest centre: the classes of queries
WIDEST = 3.0  # cut-off lengths that a cell may measure: single precision bears no more
CELL_FILL = 6  # centres a cell, at least, on average
GRID_PER_SIGMA = 3.2
GRID_CELLS = 3_000_000
TAPS_COST = 200  # of laying a centre on the grid or reading a query there, in kernel values of the blocks
CACHED = 250_000  # kernel values of a meeting of cells at a time: 1 MB, for the processor's cache
BLOCK = 4_000_000  # kernel values at a time: 16 MB in single, 32 MB in double precision


@dataclasses.dataclass(frozen=True, eq=False)
class DisplacementField:
    """A GRNN over displacement vectors.

    Parameters
    ----------
    centres : (n, 3) float64
        Where the displacements are known; n > 0, finite.
    displacements : (n, 3) float64
        The displacement at each centre, in the unit of the coordinates.
    spread : float
        Distance at which a weight is one half; > 0, in the unit of the coordinates.
    rough : bool
        Whether `ROUGH` of the largest displacement is near enough, as for a step that is measured anew.

    Raises
    ------
    FemorsError
        No centres, unequal counts, values that are not finite, or a spread that is not positive.
    """

    centres: Float
    displacements: Float
    spread: float
    rough: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "centres", frozen(self.centres, np.float64, 3))
        object.__setattr__(self, "displacements", frozen(self.displacements, np.float64, 3))
        object.__setattr__(self, "spread", float(self.spread))
        if len(self.centres) == 0 or len(self.centres) != len(self.displacements):
            raise FemorsError(
                f"a displacement field needs as many displacements as centres, and at least one; "
                f"got {len(self.displacements)} and {len(self.centres)}"
            )
        if not (np.isfinite(self.centres).all() and np.isfinite(self.displacements).all()):
            raise FemorsError("a displacement field needs finite centres and displacements")
        if not (self.spread > 0 and math.isfinite(self.spread)):
            raise FemorsError(f"the spread must be a positive length, not {self.spread}")

    # --- evaluation ---------------------------------------------------------------------------
    def __call__(self, points: ArrayLike, progress: Progress = silent) -> Float:
        """Return the displacement (p, 3) at points (p, 3), within `TOLERANCE` of the definition.

        The bound is relative to the largest displacement, and holds where centres are spread evenly
        over surfaces or volumes, near or far. Beside a centre that is alone, thousands of others four
        spreads away may weigh more than the cut-off allows for: `exact` bears that, too.
        """
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        if len(points) * len(self.centres) <= BLOCK // 8:
            return self.exact(points, progress)
        nearest = self._tree.query(points)[0] / self.spread
        out = np.empty_like(points)
        start = 0.0
        for limit in (*REACHES, math.inf):
            rows = np.flatnonzero((nearest >= start) & (nearest < limit))
            if len(rows):
                out[rows] = self._within(points[rows], nearest[rows], limit, progress)
            start = limit
        return out

    def _within(self, points: Float, nearest: Float, limit: float, progress: Progress) -> Float:
        """Evaluate queries whose nearest centre is less than `limit` spreads away."""
        if limit == math.inf:
            return self._far(points, progress)
        cells = Cells.of(self.centres, self.spread * math.hypot(limit, ROUGH_CUT if self.rough else CUT))
        if limit == REACHES[0]:
            grid = _Grid.fitting(self.centres, points, self.spread, self.rough)
            taps = TAPS_COST * (len(points) + len(self.centres))
            if grid is not None and grid.cost + taps < len(points) * cells.typical:
                return grid.smooth(self, points, progress)
        return self._by_cells(cells, points, nearest, progress)

    def exact(self, points: ArrayLike, progress: Progress = silent) -> Float:
        """Return the displacement (p, 3) by the definition, in double precision, block by block."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        out = np.empty_like(points)
        size = max(BLOCK // (2 * len(self.centres)), 1)
        for start in range(0, len(points), size):
            progress(start / max(len(points), 1), "displacement field")
            out[start : start + size] = self._shifted(points[start : start + size], slice(None))
        return out

    def _shifted(self, points: Float, chosen: slice | Int) -> Float:
        """Weights relative to the nearest centre's: defined at any distance."""
        centres, displacements = self.centres[chosen], self.displacements[chosen]
        square = np.zeros((len(points), len(centres)))
        for axis in range(3):
            square += (points[:, axis, None] - centres[None, :, axis]) ** 2
        square -= square.min(axis=1, keepdims=True)
        weights = np.exp(square * (-LN2 / self.spread**2))
        return (weights @ displacements) / weights.sum(axis=1, keepdims=True)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.centres)

    def _by_cells(self, cells: Cells, points: Float, nearest: Float, progress: Progress) -> Float:
        """Evaluate over the centres in the 27 cells around each query."""
        out = np.empty_like(points)
        values = np.column_stack((self.displacements, np.ones(len(self.centres)))).astype(np.float32)
        scale = math.sqrt(LN2) / self.spread
        # relative to the nearest centre's weight: no query's sum is faint
        shift = (LN2 * nearest**2).astype(np.float32)

        def meet(meeting: tuple[Float, Int, Int]) -> int:
            origin, rows, chosen = meeting
            x = ((points[rows] - origin) * scale).astype(np.float32)
            c = ((self.centres[chosen] - origin) * scale).astype(np.float32)
            # 2 x c - c^2 + (shift - x^2) in one product
            left = np.column_stack((2.0 * x, np.ones(len(x), np.float32), shift[rows] - _square(x)))
            right = np.column_stack((c, -_square(c), np.ones(len(c), np.float32)))
            exponent = left @ right.T
            np.exp(exponent, out=exponent)
            sums = exponent @ values[chosen]
            out[rows] = sums[:, :3] / sums[:, 3:]
            return len(rows)

        seen = 0
        progress(0.0, "displacement field")
        for count in in_threads(meet, cells.meetings(points)):
            seen += count
            progress(seen / len(points), "displacement field")
        return out

    def _far(self, points: Float, progress: Progress) -> Float:
        """The definition over the nearest centres only, as many as can matter."""
        out = np.empty_like(points)
        open_points, k = np.arange(len(points)), min(16, len(self.centres))
        while len(open_points):
            still = []
            for start in range(0, len(open_points), max(BLOCK // (8 * k), 1)):
                progress(0.0, "displacement field")
                rows = open_points[start : start + max(BLOCK // (8 * k), 1)]
                distance, order = self._tree.query(points[rows], k=k)
                square = (distance.reshape(len(rows), k) / self.spread) ** 2
                relative = square - square[:, :1]
                weights = np.exp(-LN2 * relative)
                near = self.displacements[order.reshape(len(rows), k)]
                out[rows] = np.einsum("pk,pkc->pc", weights, near) / weights.sum(axis=1, keepdims=True)
                # the centres not seen weigh at most as much as the last one seen, each
                left = (len(self.centres) - k) * weights[:, -1]
                still.append(rows[left > TOLERANCE * weights.sum(axis=1)])
            open_points = np.concatenate(still) if k < len(self.centres) else np.empty(0, dtype=int)
            k = min(4 * k, len(self.centres))
            if k > 4096:
                out[open_points] = self.exact(points[open_points], progress)
                break
        return out


@dataclasses.dataclass(frozen=True, eq=False)
class Cells:
    """Centres sorted into cubes of one cut-off length, so that 27 cubes hold all within reach."""

    size: float
    low: Float
    shape: tuple[int, int, int]
    keys: Int  # (n,) cell of each centre, ascending
    order: Int  # (n,) centre indices in that order

    @classmethod
    def of(cls, centres: Float, size: float) -> Cells:
        low = centres.min(axis=0)
        widest = WIDEST * size
        # never more cells than a 64-bit key can count
        size = max(size, float(np.ptp(centres, axis=0).max()) / 1e5)
        while True:
            cell = np.floor((centres - low) / size).astype(np.int64) + 1
            nx, ny, nz = (int(n) for n in cell.max(axis=0) + 2)
            keys = (cell[:, 0] * ny + cell[:, 1]) * nz + cell[:, 2]
            order = np.argsort(keys, kind="stable")
            keys = keys[order]
            # a cell costs a few calls: fewer, fuller cells are cheaper where the spread is tiny
            full = np.count_nonzero(np.diff(keys)) * CELL_FILL < len(keys)
            if full or size > widest:
                return cls(size, low, (nx, ny, nz), keys, order)
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

    def meetings(self, points: Float) -> Iterator[tuple[Float, Int, Int]]:
        """Yield (origin, query rows, centre indices), at most `CACHED` pairs at a time, or 16 queries."""
        cell = np.floor((points - self.low) / self.size).astype(np.int64) + 1
        inside = np.flatnonzero(((cell >= 0) & (cell < self.shape)).all(axis=1))
        cell = cell[inside]
        keys = (cell[:, 0] * self.shape[1] + cell[:, 1]) * self.shape[2] + cell[:, 2]
        order = np.argsort(keys, kind="stable")
        unique, first = np.unique(keys[order], return_index=True)
        starts, stops = self._bounds(unique)
        for start, stop, rows in zip(starts, stops, np.split(inside[order], first[1:]), strict=True):
            ranges = [self.order[a:b] for a, b in zip(start, stop, strict=True) if b > a]
            if not ranges:
                continue
            chosen = np.concatenate(ranges)
            origin = points[rows[0]]
            step = max(CACHED // len(chosen), 16)
            for at in range(0, len(rows), step):
                yield origin, rows[at : at + step], chosen


@dataclasses.dataclass(frozen=True, eq=False)
class _Grid:
    """A regular grid around the queries, for spreads that span many centres."""

    low: Float
    step: float
    shape: tuple[int, int, int]
    sigma: float  # of the Gaussian, in cells
    radius: int  # of the Gaussian's cut-off, in cells

    @classmethod
    def fitting(cls, centres: Float, points: Float, spread: float, rough: bool = False) -> _Grid | None:
        """Return a grid over what queries and centres share, or None where it would be too large."""
        sigma = spread / math.sqrt(2.0 * LN2)
        step = sigma / (ROUGH_GRID if rough else GRID_PER_SIGMA)
        cut = (ROUGH_CUT if rough else CUT) * spread
        reach = cut + 3 * step
        # queries lie within reach of the centres, so that both fit with a margin for the splines
        low = np.maximum(centres.min(axis=0), points.min(axis=0) - reach)
        high = np.minimum(centres.max(axis=0), points.max(axis=0) + reach)
        low = np.minimum(low, points.min(axis=0)) - 2 * step
        high = np.maximum(high, points.max(axis=0)) + 2 * step
        extent = np.maximum((high - low) / step, 1.0)
        if float(np.prod(extent + 4)) > GRID_CELLS:
            return None
        nx, ny, nz = (int(n) + 4 for n in extent)
        return cls(low, step, (nx, ny, nz), sigma / step, math.ceil(cut / step))

    @property
    def cost(self) -> float:
        """Work in units of one kernel value of the block rule."""
        taps = 3 * (2 * self.radius + 1)
        return 4 * math.prod(self.shape) * taps * 0.5

    def smooth(self, field: DisplacementField, points: Float, progress: Progress) -> Float:
        """Evaluate the field's smoothed sums at points (p, 3), all within reach of a centre."""
        cells = math.prod(self.shape)
        grids = np.zeros((cells, 4))
        values = np.column_stack((field.displacements, np.ones(len(field.centres))))
        for rows in _parts(len(field.centres)):
            progress(0.4 * rows.start / len(field.centres), "displacement field")
            grids += self._taps(field.centres[rows]).T @ values[rows]
        # a cubic B-spline has variance 1/3: taken off the kernel for spreading and for reading
        narrow = math.sqrt(self.sigma**2 - 2.0 / 3.0)
        kernel = _gauss(narrow, self.radius)
        for column in range(4):
            progress(0.4 + 0.1 * column, "displacement field")
            grid = np.ascontiguousarray(grids[:, column]).reshape(self.shape)
            for axis in range(3):
                grid = ndimage.correlate1d(grid, kernel, axis=axis, mode="constant")
            grids[:, column] = grid.ravel()
        out = np.empty_like(points)
        for rows in _parts(len(points)):
            progress(0.8 + 0.2 * rows.start / len(points), "displacement field")
            sums = self._taps(points[rows]) @ grids
            out[rows] = sums[:, :3] / sums[:, 3:]
        return out

    def _taps(self, points: Float) -> sparse.csr_matrix:
        """B-spline weights (p, cells), 64 of each point; those of points off the grid are zero."""
        at = (points - self.low) / self.step
        base = np.floor(at).astype(np.int32)
        t = at - base
        inside = ((base >= 1) & (base + 2 < self.shape)).all(axis=1)
        base = np.clip(base, 1, np.array(self.shape, dtype=np.int32) - 3)
        spline = np.stack(
            ((1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3), axis=1
        ) / (6.0)
        offset = np.arange(-1, 3, dtype=np.int32)
        x, y, z = (base[:, axis, None] + offset for axis in range(3))
        index = ((x[:, :, None] * self.shape[1] + y[:, None, :])[..., None] * self.shape[2]) + z[
            :, None, None, :
        ]
        weights = spline[:, :, None, None, 0] * spline[:, None, :, None, 1] * spline[:, None, None, :, 2]
        weights *= inside[:, None, None, None]
        start = np.arange(0, 64 * len(points) + 1, 64, dtype=np.int32)
        taps = (weights.ravel(), index.ravel(), start)
        return sparse.csr_matrix(taps, shape=(len(points), math.prod(self.shape)))


def _square(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Squared length (k,) of each row, in the rows' precision."""
    return np.asarray(np.einsum("ij,ij->i", vectors, vectors))


def _parts(count: int) -> list[slice]:
    """Parts of so many points whose taps fit into a block."""
    return [slice(start, start + BLOCK // 128) for start in range(0, count, BLOCK // 128)]


def _gauss(sigma: float, radius: int) -> Float:
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    return kernel / kernel.sum()
