# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a running morph has its source by now, for somebody who looks on."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from .cleaning import Cleaned
from .mesh import Float, Surface
from .progress import Preview
from .transforms import transformed

NEIGHBOURS = 6  # reduced nodes that a dense node follows


class Watch:
    """Hands every vertex of the given source to a `Preview`, whatever level is worked on.

    A reduced level's displacement comes to the dense mesh by a weighted mean of its nearest nodes: good
    enough to look at, and a hundred times cheaper than the field. Without a preview nothing is computed.

    Parameters
    ----------
    preview : Preview or None
    given : (n, 3) array
        The source's vertices as given.
    ours : Cleaned
        The cleaned source.
    matrix : (4, 4) array
        The alignment.
    levels : list of Surface
        From the coarsest level to the dense one, aligned.
    """

    def __init__(
        self, preview: Preview | None, given: Float, ours: Cleaned, matrix: Float, levels: list[Surface]
    ) -> None:
        self._preview = preview
        self._levels = levels
        self._carry: dict[int, sparse.csr_matrix] = {}
        if preview is not None:
            self._used = ours.vertex_map >= 0
            self._map = ours.vertex_map[self._used]
            self._start = transformed(matrix, given)

    def __call__(self, level: int, displacement: Float) -> None:
        """Show the displacement (n, 3) of a level's nodes; may raise what the preview raises."""
        if self._preview is None:
            return
        if level < len(self._levels) - 1:
            if level not in self._carry:
                self._carry[level] = _nearby(self._levels[level].vertices, self._levels[-1].vertices)
            displacement = self._carry[level] @ displacement
        seen = self._start.copy()
        seen[self._used] += displacement[self._map]
        self._preview(seen)

    def dense(self, displacement: Float) -> None:
        """Show a displacement (n, 3) of the dense nodes."""
        self(len(self._levels) - 1, displacement)


def _nearby(coarse: Float, dense: Float) -> sparse.csr_matrix:
    """Return the (dense, coarse) matrix of weights, rows summing to one."""
    count = min(NEIGHBOURS, len(coarse))
    far, near = cKDTree(coarse).query(dense, k=count)
    far, near = far.reshape(-1, count), near.reshape(-1, count)
    spread = np.maximum(far.mean(axis=1, keepdims=True), 1e-300)
    weight = np.exp(-((far / spread) ** 2))
    weight /= weight.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(dense)), count)
    return sparse.csr_matrix((weight.ravel(), (rows, near.ravel())), shape=(len(dense), len(coarse)))
