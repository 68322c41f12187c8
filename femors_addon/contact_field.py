# SPDX-License-Identifier: GPL-3.0-or-later
"""The displacement field of contact: a GRNN that is zero away from it.

    u(x) = W(x) sum_i w_i c_i n_i / max(sum_i w_i, D),    w_i = exp(-ln2 (|x - x_i| / s)^2)

The centres are the nodes in contact alone. In the paper, thousands of nodes without contact stand in the
sum with zero vectors; here the density D of the patch stands for them, so that the field falls off beside
it and costs nothing there. W goes smoothly from 1 at `FADE` spreads from the patch to 0 at `END`. The
amounts c are found so that the field does along each way n what is asked of it there, not its mean.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from . import triples
from .cells import LN2, Cells
from .mesh import Float, Int
from .sides import Contacts

FADE, END = 1.7, 2.6  # spreads from the patch: where the field begins to fade, and where it is zero
CUT = 2.4  # spreads beyond which a weight (below 2 %) is left out
ROUNDS = 4  # corrections of the amounts
PER_SPREAD = 3.0  # centres a spread, at most, along each axis


@dataclasses.dataclass(frozen=True, eq=False)
class ContactField:
    """A field made by `fitted`.

    Attributes
    ----------
    centres : (k, 3) float64
    vectors : (k, 3) float64
        Amount times way of each centre.
    spread : float
    background : float
        The density D.
    """

    centres: Float
    vectors: Float
    spread: float
    background: float

    @classmethod
    def fitted(
        cls, contacts: Contacts, asked: Float, spread: float, least: Float | None = None, rounds: int = ROUNDS
    ) -> ContactField:
        """Return the field that moves contacts along their ways by what is asked of each (k,).

        With `least` (k,), at least by what is asked, and no amount is below it.
        """
        rows = representatives(contacts.points, asked, spread / PER_SPREAD)
        points, ways, asked = contacts.points[rows], contacts.ways[rows], asked[rows]
        weights = _Weights.of(points, spread)
        density = weights.totals()
        violated = density[asked > 0] if (asked > 0).any() else density
        background = float(np.median(violated))
        scale = 1.0 / np.maximum(density, background)
        amounts = np.zeros(len(points))
        acting: NDArray[np.bool_] = np.zeros(len(points), dtype=bool)
        kernel = None
        for _ in range(rounds):
            fresh = (amounts != 0) & ~acting
            if fresh.any():
                acting |= fresh
                kernel = weights.matrix(acting)  # most stay at nothing where the field may only push
            if kernel is not None:
                moved = kernel @ (amounts[acting, None] * ways[acting])
                amounts -= scale * np.einsum("ij,ij->i", ways, moved)
            amounts += asked
            if least is not None:
                np.maximum(amounts, least[rows], out=amounts)
        return cls(points, amounts[:, None] * ways, spread, background)

    def __call__(self, points: Float) -> tuple[Int, Float]:
        """Return the rows of points (p, 3) that move, and their displacements."""
        low = self.centres.min(axis=0) - END * self.spread
        high = self.centres.max(axis=0) + END * self.spread
        rows = np.flatnonzero(triples.every((points > low) & (points < high)))
        acting = self.centres[triples.some(self.vectors != 0)]
        if not len(rows) or not len(acting):
            return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        far = cKDTree(acting).query(points[rows], distance_upper_bound=END * self.spread)[0] / self.spread
        rows, far = rows[far < END], far[far < END]
        sums = _sums(self.centres, self.vectors, self.spread, points[rows])
        out = sums[:, :3] / np.maximum(sums[:, 3:], self.background)
        t = np.clip((far - FADE) / (END - FADE), 0.0, 1.0)
        return rows, out * (1.0 - t * t * (3.0 - 2.0 * t))[:, None]


@dataclasses.dataclass(frozen=True, eq=False)
class _Weights:
    """Weights (w,) of points for each other, those beyond `CUT` left out, and the rows (w,) of both."""

    row: Int
    column: Int
    value: Float
    count: int

    @classmethod
    def of(cls, points: Float, spread: float) -> _Weights:
        tree = cKDTree(points)
        found = tree.sparse_distance_matrix(tree, CUT * spread, output_type="ndarray")
        return cls(found["i"], found["j"], np.exp(-LN2 * (found["v"] / spread) ** 2), len(points))

    def totals(self) -> Float:
        """Return the sum (k,) of each point's weights."""
        return np.asarray(np.bincount(self.row, self.value, self.count), dtype=np.float64)

    def matrix(self, chosen: NDArray[np.bool_]) -> sparse.csr_matrix:
        """Return the weights (k, c) of the chosen points for all."""
        kept = np.flatnonzero(chosen[self.column])
        place = self.row[kept], (np.cumsum(chosen) - 1)[self.column[kept]]
        return sparse.csr_matrix((self.value[kept], place), shape=(self.count, int(chosen.sum())))


def _sums(centres: Float, vectors: Float, spread: float, points: Float) -> Float:
    """Sums (p, 4) of weighted vectors and of weights, in single precision."""
    values = np.column_stack((vectors, np.ones(len(centres))))
    return Cells.of(centres, CUT * spread).sums(values, spread, points).astype(np.float64)


def representatives(points: Float, asked: Float, size: float) -> Int:
    """Return one row for each cube of this size that has points: that of which most is asked."""
    if len(points) < 2:
        return np.arange(len(points))
    cell = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    extent = cell.max(axis=0) + 1
    keys = (cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2]
    order = np.lexsort((-asked, keys))
    first = np.concatenate(([True], np.diff(keys[order]) > 0))
    return np.sort(order[first])
