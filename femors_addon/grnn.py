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

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage, sparse
from scipy.spatial import cKDTree

from .cached import cached_property
from .cells import LN2, MOST, Cells
from .crew import over
from .mesh import Float, Int, frozen
from .progress import FemorsError, Progress, silent

TOLERANCE = 1e-4
CUT = 3.9
ROUGH, ROUGH_CUT, ROUGH_GRID = 2e-3, 3.2, 1.8  # the same three, for steps that are measured anew
REACHES = (1.3, 3.0, 6.0)  # spreads to the nearest centre: the classes of queries
GRID_PER_SIGMA = 3.2
GRID_CELLS = 3_000_000
TAP_COST = 3.2  # of each node of the grid that a centre is laid on or a query read from, in kernel values
FEW = 16  # points or centres: to sort the centres takes longer than to look at them all
BLOCK = 4_000_000  # kernel values at a time: 16 MB in single, 32 MB in double precision
ASKED = 8_000  # queries of the tree at a time


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
        few = min(len(points), len(self.centres)) <= FEW
        if few or len(points) * len(self.centres) <= BLOCK // 8:
            return self.exact(points, progress)
        nearest = self._nearest(points)
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
        reach = self.spread * math.hypot(limit, ROUGH_CUT if self.rough else CUT)
        if limit == math.inf or float(np.ptp(self.centres, axis=0).max()) > MOST * reach:
            return self._far(points, progress)
        cells = Cells.of(self.centres, reach)
        if limit == REACHES[0]:
            grid = _Grid.fitting(self.centres, points, self.spread, self.rough)
            handled = len(points) + len(self.centres)
            if grid is not None and grid.cost(handled) < len(points) * cells.typical:
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

    def _nearest(self, points: Float) -> Float:
        """Distance (p,) of each query to the nearest centre, in spreads."""
        parts = (points[start : start + ASKED] for start in range(0, len(points), ASKED))
        return np.concatenate(list(over(lambda part: self._tree.query(part)[0], parts))) / self.spread

    def _by_cells(self, cells: Cells, points: Float, nearest: Float, progress: Progress) -> Float:
        """Evaluate over the centres in the 27 cells around each query."""
        values = np.column_stack((self.displacements, np.ones(len(self.centres))))
        # relative to the nearest centre's weight: no query's sum is faint
        sums = cells.sums(values, self.spread, points, LN2 * nearest**2, progress)
        return (sums[:, :3] / sums[:, 3:]).astype(np.float64)

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
class _Grid:
    """A regular grid around the queries, for spreads that span many centres."""

    low: Float
    step: float
    shape: tuple[int, int, int]
    sigma: float  # of the Gaussian, in cells
    radius: int  # of the Gaussian's cut-off, in cells
    order: int  # of the B-splines: 3 cubic, 2 quadratic

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
        return cls(low, step, (nx, ny, nz), sigma / step, math.ceil(cut / step), 2 if rough else 3)

    def cost(self, handled: int) -> float:
        """Work with so many centres and queries, in units of one kernel value of the block rule."""
        smoothing = 4 * math.prod(self.shape) * 3 * (2 * self.radius + 1) * 0.5
        return smoothing + TAP_COST * (self.order + 1) ** 3 * handled

    def smooth(self, field: DisplacementField, points: Float, progress: Progress) -> Float:
        """Evaluate the field's smoothed sums at points (p, 3), all within reach of a centre."""
        cells = math.prod(self.shape)
        grids = np.zeros((cells, 4))
        values = np.column_stack((field.displacements, np.ones(len(field.centres))))
        for rows in _parts(len(values)):
            progress(0.4 * rows.start / len(values), "displacement field")
            grids += self._taps(field.centres[rows]).T @ values[rows]
        # a B-spline has a twelfth of its order plus one as variance: taken off for laying and for reading
        narrow = math.sqrt(self.sigma**2 - (self.order + 1) / 6.0)
        kernel = _gauss(narrow, self.radius)

        def smoothed(column: int) -> int:
            grid = np.ascontiguousarray(grids[:, column]).reshape(self.shape)
            for axis in range(3):
                grid = ndimage.correlate1d(grid, kernel, axis=axis, mode="constant")
            grids[:, column] = grid.ravel()
            return column

        for column in over(smoothed, range(4)):
            progress(0.4 + 0.1 * column, "displacement field")
        out = np.empty_like(points)

        for rows in _parts(len(points)):
            progress(0.8 + 0.2 * rows.start / len(points), "displacement field")
            sums = self._taps(points[rows]) @ grids
            out[rows] = sums[:, :3] / sums[:, 3:]
        return out

    def _taps(self, points: Float) -> sparse.csr_matrix:
        """B-spline weights (p, cells), 64 or 27 of each point; those of points off the grid are zero."""
        count, each = len(points), (self.order + 1) ** 3
        weights, index = np.empty((count, each)), np.empty((count, each), np.int32)

        def fill(start: int) -> None:
            rows = slice(start, start + ASKED)
            self._tap(points[rows], weights[rows], index[rows])

        for _ in over(fill, range(0, count, ASKED)):
            pass
        start = np.arange(0, each * count + 1, each, dtype=np.int32)
        taps = (weights.ravel(), index.ravel(), start)
        return sparse.csr_matrix(taps, shape=(count, math.prod(self.shape)))

    def _tap(self, points: Float, weights: Float, index: Int) -> None:
        """Write the weights and the nodes (p, taps) of some points."""
        at = (points - self.low) / self.step
        width = self.order + 1
        base = (np.floor(at) if self.order == 3 else np.rint(at)).astype(np.int32)
        t = at - base
        inside = ((base >= 1) & (base + width - 2 < self.shape)).all(axis=1)
        base = np.clip(base, 1, np.array(self.shape, dtype=np.int32) - width + 1)
        spline = np.stack(_cubic(t) if self.order == 3 else _quadratic(t), axis=1)
        spline[:, :, 0] *= inside[:, None]
        offset = np.arange(-1, width - 1, dtype=np.int32)
        x, y, z = (base[:, axis, None] + offset for axis in range(3))
        column = (x[:, :, None] * self.shape[1] + y[:, None, :])[..., None] * self.shape[2]
        cube = (len(points), width, width, width)
        np.add(column, z[:, None, None, :], out=index.reshape(cube))
        plane = spline[:, :, None, 0] * spline[:, None, :, 1]
        np.multiply(plane[..., None], spline[:, None, None, :, 2], out=weights.reshape(cube))


def _cubic(t: Float) -> tuple[Float, ...]:
    """Weights of the four nodes around a point, t in [0, 1) after the second."""
    near, far = 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1
    return (1 - t) ** 3 / 6.0, near / 6.0, far / 6.0, t**3 / 6.0


def _quadratic(t: Float) -> tuple[Float, ...]:
    """Weights of the three nodes around a point, t in [-0.5, 0.5] from the middle one."""
    return 0.5 * (0.5 - t) ** 2, 0.75 - t * t, 0.5 * (0.5 + t) ** 2


def _parts(count: int) -> list[slice]:
    """Parts of so many points whose taps fit into a block."""
    return [slice(start, start + BLOCK // 128) for start in range(0, count, BLOCK // 128)]


def _gauss(sigma: float, radius: int) -> Float:
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    return kernel / kernel.sum()
