# SPDX-License-Identifier: GPL-3.0-or-later
"""Closest points on single triangles, many pairs at a time; slivers and faces without area included."""

from __future__ import annotations

import dataclasses

import numpy as np

from .mesh import Float, Int
from .triples import dot

THIN = 1e-4  # squared sine of the angle at corner a, below which dot products have lost too many digits
NEAR = 1e-8  # of |p - a|^2: squared distances below have been rounded away, and are worked out anew


@dataclasses.dataclass(frozen=True, eq=False)
class Triangles:
    """What the distance to each face needs, worked out once.

    Attributes
    ----------
    table : (m, 12) float64
        Corner a, edges ab and ac, their products ab ab, ac ac and ab ac: a face's numbers stand together
        in memory, and are laid out number by number only for the faces that are asked for.
    balls : (m, 4) float64
        Centroid and distance of the farthest corner from it.
    thin_rank : (m,) int32
        Rank among the thin faces, -1 for the others.
    """

    table: Float
    balls: Float
    thin: _Thin
    thin_rank: Int

    @classmethod
    def of(cls, corners: Float) -> Triangles:
        """Prepare faces (m, 3, 3)."""
        a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        ab2, ac2, abac = dot(ab, ab), dot(ac, ac), dot(ab, ac)
        thin = np.flatnonzero(~(ab2 * ac2 - abac * abac > THIN * ab2 * ac2))
        rank = np.full(len(corners), -1, dtype=np.int32)
        rank[thin] = np.arange(len(thin), dtype=np.int32)
        table = np.column_stack((a, ab, ac, ab2, ac2, abac))
        middle = (ab + ac) / 3.0
        radius = np.max(
            [dot(middle, middle), dot(ab - middle, ab - middle), dot(ac - middle, ac - middle)], axis=0
        )
        return cls(table, np.column_stack((a + middle, np.sqrt(radius))), _Thin.of(corners[thin]), rank)

    def within(self, p: Float, ids: Int, distance: Float) -> np.ndarray:
        """True (k,) where a face may be as close to p (k, 3) as the distance (k,): its ball is."""
        x, y, z, radius = _columns(self.balls, ids)
        x -= p[:, 0]
        y -= p[:, 1]
        z -= p[:, 2]
        radius += distance
        return x * x + y * y + z * z <= radius * radius * (1.0 + 1e-9)

    def closest(self, p: Float, ids: Int) -> tuple[Float, Float, Float]:
        """Squared distance and weights (v of corner b, w of corner c) for pairs of point and face.

        The foot of the perpendicular where it lies inside, else the best of the three edges; all in
        dot products, so that a pair costs no more than three vectors.
        """
        ax, ay, az, abx, aby, abz, acx, acy, acz, ab2, ac2, abac = _columns(self.table, ids)
        apx, apy, apz = p[:, 0] - ax, p[:, 1] - ay, p[:, 2] - az
        d1 = abx * apx + aby * apy + abz * apz
        d2 = acx * apx + acy * apy + acz * apz
        ap2 = apx * apx + apy * apy + apz * apz
        det = ab2 * ac2 - abac * abac
        vn, wn = ac2 * d1 - abac * d2, ab2 * d2 - abac * d1
        inner = (vn > 0) & (wn > 0) & (vn + wn < det)
        distance, v, w = _edges(d1, d2, ap2, ab2, ac2, abac)
        rows = np.flatnonzero(inner)
        v[rows], w[rows] = vn[rows] / det[rows], wn[rows] / det[rows]
        distance[rows] = ap2[rows] - v[rows] * d1[rows] - w[rows] * d2[rows]
        rows = np.flatnonzero(distance < NEAR * ap2)
        if len(rows):
            self._anew(p, ids, rows, inner, (distance, v, w))
        if len(self.thin.corners):
            rows = np.flatnonzero(self.thin_rank[ids] >= 0)
            distance[rows], v[rows], w[rows] = self.thin.closest(p[rows], self.thin_rank[ids[rows]])
        return distance, v, w

    def _anew(
        self, p: Float, ids: Int, rows: Int, inner: np.ndarray, found: tuple[Float, Float, Float]
    ) -> None:
        """Work out the small distances of some pairs from vectors, where products have lost their digits."""
        distance, v, w = found
        table = self.table[ids[rows]]
        ap, ab, ac = p[rows] - table[:, :3], table[:, 3:6], table[:, 6:9]
        gap = ap - v[rows, None] * ab - w[rows, None] * ac
        distance[rows] = dot(gap, gap)
        edge = ~inner[rows]
        rows, ap, ab, ac = rows[edge], ap[edge], ab[edge], ac[edge]
        corners = np.stack((np.zeros_like(ab), ab, ac), axis=1)
        distance[rows], weights = _on_edges(ap, corners)
        v[rows], w[rows] = weights[:, 1], weights[:, 2]


def _columns(table: Float, rows: Int) -> Float:
    """Rows (k,) of a table (m, c), number by number: (c, k), each contiguous."""
    return np.ascontiguousarray(table.take(rows, axis=0).T)


def _edges(
    d1: Float, d2: Float, ap2: Float, ab2: Float, ac2: Float, abac: Float
) -> tuple[Float, Float, Float]:
    """Squared distance and weights of the closest point on the edges ab, ac and bc, by products only."""
    s, t = _clamped(d1, ab2), _clamped(d2, ac2)
    bc2 = ab2 + ac2 - 2.0 * abac
    r = _clamped(d2 - d1 + ab2 - abac, bc2)
    on_ab, on_ac = ap2 + s * (s * ab2 - 2.0 * d1), ap2 + t * (t * ac2 - 2.0 * d2)
    on_bc = ap2 - 2.0 * d1 + ab2 + r * (r * bc2 - 2.0 * (d2 - d1 + ab2 - abac))
    first = (on_ab <= on_ac) & (on_ab <= on_bc)
    second = ~first & (on_ac <= on_bc)
    distance = np.where(first, on_ab, np.where(second, on_ac, on_bc))
    v = np.where(first, s, np.where(second, 0.0, 1.0 - r))
    return distance, v, np.where(first, 0.0, np.where(second, t, r))


@dataclasses.dataclass(frozen=True, eq=False)
class _Thin:
    """Faces nearly or wholly without area, each in axes along and across its longest edge."""

    corners: Float  # (k, 3, 3), the longest edge from the first to the second
    order: Int  # (k, 3) where these corners stand in the face
    along: Float  # (k, 3) unit
    across: Float  # (k, 3) unit; zero where there is no height
    length: Float  # (k,)
    foot: Float  # (k,) of the third corner, along the longest edge
    height: Float  # (k,)

    @classmethod
    def of(cls, corners: Float) -> _Thin:
        sides = np.stack([np.linalg.norm(corners[:, i - 2] - corners[:, i], axis=1) for i in range(3)])
        order = (sides.argmax(axis=0)[:, None] + np.arange(3)) % 3
        corners = np.take_along_axis(corners, order[:, :, None], axis=1)
        length = sides.max(axis=0)
        along = (corners[:, 1] - corners[:, 0]) / np.where(length > 0, length, 1.0)[:, None]
        third = corners[:, 2] - corners[:, 0]
        foot = dot(third, along)
        across = third - foot[:, None] * along
        across -= dot(across, along)[:, None] * along  # once more: what is left of it may be all rounding
        height = np.linalg.norm(across, axis=1)
        across /= np.where(height > 0, height, 1.0)[:, None]
        return cls(corners, order, along, across, length, foot, height)

    def closest(self, p: Float, rank: Int) -> tuple[Float, Float, Float]:
        """As `Triangles.closest`, from vectors instead of dot products."""
        corners = self.corners[rank]
        best, weights = _on_edges(p, corners)
        flat = np.flatnonzero(self.height[rank] > 1e-15 * self.length[rank])
        one, start = rank[flat], p[flat] - corners[flat, 0]
        w = dot(start, self.across[one]) / self.height[one]
        v = (dot(start, self.along[one]) - w * self.foot[one]) / self.length[one]
        tried = np.zeros_like(weights)
        tried[flat] = np.column_stack((1.0 - v - w, v, w))
        _keep_closer(p, corners, tried, (tried > 0).all(axis=1), best, weights)
        out = np.empty_like(weights)
        np.put_along_axis(out, self.order[rank], weights, axis=1)
        return best, out[:, 1], out[:, 2]


def _on_edges(p: Float, corners: Float) -> tuple[Float, Float]:
    """Squared distance (q,) of points to the edges of faces (q, 3, 3), and weights (q, 3) at the corners."""
    best, weights = np.full(len(p), np.inf), np.zeros((len(p), 3))
    for i, j in ((0, 1), (0, 2), (1, 2)):
        edge = corners[:, j] - corners[:, i]
        share = _clamped(dot(p - corners[:, i], edge), dot(edge, edge))
        tried = np.zeros_like(weights)
        tried[:, i], tried[:, j] = 1.0 - share, share
        _keep_closer(p, corners, tried, np.ones(len(p), dtype=bool), best, weights)
    return best, weights


def _keep_closer(
    p: Float, corners: Float, tried: Float, allowed: np.ndarray, best: Float, weights: Float
) -> None:
    """Where points of these weights are closer to p, take them over."""
    gap = p - np.einsum("pk,pkc->pc", tried, corners)
    distance = dot(gap, gap)
    better = allowed & (distance < best)
    best[better], weights[better] = distance[better], tried[better]


def _clamped(along: Float, length: Float) -> Float:
    """Parameter in [0, 1] of the foot on an edge; 0 on an edge without length."""
    foot: Float = np.divide(along, length, out=np.zeros_like(along), where=length > 0)
    clamped: Float = np.clip(foot, 0.0, 1.0)
    return clamped
