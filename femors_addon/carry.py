# SPDX-License-Identifier: GPL-3.0-or-later
"""Points carried by a kept field: forth from source to target, or back.

On the source's surface a point keeps its place in its triangle. Off it, it keeps its offset, which turns
with the surface below and keeps its length along the normal (`frames`); the farther away, the smoother the
deformation that it follows, and from `FADE` of the size on it is left more and more to the alignment alone.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from .cached import cached_property
from .frames import SmoothMap, principal_stretches, ramp
from .keptfield import KeptField
from .limits import require_nodes
from .mesh import Float, Int, Surface
from .nearest import Closest, SurfaceIndex
from .progress import FemorsError, Progress, part, silent
from .transforms import inverse, transformed

SHARE = 0.5  # of a point's distance: the spread of the map there
FADE = (0.15, 0.5)  # of the source's size: distances between which the deformation fades out
MENDED = 2.0  # mean edges: how far from the surface the map is made to agree with the triangles
MEMORY_LEAST, MEMORY_NODE = 40e6, 3.5e3  # bytes: what a transfer was measured to take, and per node of all
ROUNDS = 12  # of the inverse's correction
EXACT = 1e-9  # of the size: an error of the inverse that is corrected no further


@dataclasses.dataclass(frozen=True, eq=False)
class Carried:
    """Points (p, 3) where a field has carried them, and what is known of each.

    Attributes
    ----------
    points : (p, 3) float64
    distance : (p,) float64
        How far each point was from the surface that the field is known on, in the target's unit
        (after the alignment), negative inside; unsigned where the field has no faces.
    error : (p,) float64
        Of an inverse: how far the way forth ends from where the point came; zero for the way forth.
    """

    points: Float
    distance: Float
    error: Float


class Carrier:
    """A kept field, ready to carry points.

    Parameters
    ----------
    field : KeptField
    """

    def __init__(self, field: KeptField) -> None:
        self.field = field
        self.size = field.aligned.diagonal
        self._home = inverse(field.transform)

    def require(self, points: int) -> None:
        """Raise `FemorsError` where so many points and the field need more memory than is allowed."""
        require_nodes(len(self.field.centres) + points, "a transfer", MEMORY_LEAST, MEMORY_NODE)

    @cached_property
    def forth(self) -> _Way:
        """From aligned positions to the target."""
        return _Way(self.field.aligned, self.field.morphed, self.field.spread)

    @cached_property
    def back(self) -> _Way:
        """From the target to aligned positions."""
        return _Way(self.field.morphed, self.field.aligned, self.field.spread)

    def carry(self, points: ArrayLike, strength: float = 1.0, progress: Progress = silent) -> Carried:
        """Carry points (p, 3) from source to target.

        Parameters
        ----------
        strength : float
            0 leaves each point where it is, 1 carries it all the way; between, along a straight line.

        Raises
        ------
        FemorsError
            Coordinates that are not finite, a strength outside 0 to 1, more memory needed than is allowed.
        """
        points = _checked(points, strength)
        self.require(len(points))
        moved, distance = self.forth(transformed(self.field.transform, points), progress)
        return Carried(_blend(points, moved, strength), distance, np.zeros(len(points)))

    def uncarry(self, points: ArrayLike, strength: float = 1.0, progress: Progress = silent) -> Carried:
        """Carry points (p, 3) from target to source: the inverse of `carry`, corrected in rounds.

        The distance is that from the morphed surface.
        """
        points = _checked(points, strength)
        self.require(len(points))
        here, distance = self.back(points, part(progress, 0.0, 0.2))
        best, error = here.copy(), np.full(len(points), np.inf)
        rows = np.arange(len(points))  # of those that are not there yet
        for number in range(ROUNDS):
            step = part(progress, 0.2 + 0.8 * number / ROUNDS, 0.2 + 0.8 * (number + 1) / ROUNDS)
            there, _ = self.forth(here[rows], step)
            miss = points[rows] - there
            length = np.linalg.norm(miss, axis=1)
            better = length < error[rows]
            rows, miss, length = rows[better], miss[better], length[better]
            best[rows], error[rows] = here[rows], length
            still = length > EXACT * self.size
            rows, miss = rows[still], miss[still]
            if not len(rows):
                break
            here = best.copy()
            here[rows] += miss  # the deformation after the alignment is near the identity
        source = transformed(self._home, best)
        return Carried(_blend(points, source, strength), distance, error)

    def at(self, points: ArrayLike) -> Closest:
        """Return the closest points of the aligned surface to points (p, 3) of the source's space."""
        return self.forth.closest(transformed(self.field.transform, _checked(points, 1.0)))

    def signed(self, points: ArrayLike) -> Float:
        """Return (p,) distances of points of the source's space from its surface, after the alignment."""
        here = transformed(self.field.transform, _checked(points, 1.0))
        return self.forth.signed(here, self.forth.closest(here))

    @cached_property
    def stretches(self) -> Float:
        """(m, 2) largest and smallest stretch of each face, from the source to the target."""
        return principal_stretches(self.field.origin, self.field.morphed)

    def residual_at(self, found: Closest) -> Float:
        """Return (p,) how far morphed surface and target are apart around closest points of the source."""
        return np.einsum("pk,pk->p", self.field.residual[self._corners(found)], found.barycentric)

    def stretch_at(self, found: Closest) -> Float:
        """Return (p,) of the two stretches at closest points of the source that which is farther from 1."""
        if not len(self.field.faces):
            return np.full(len(found.face), np.nan)
        both = self.stretches[found.face]
        with np.errstate(divide="ignore"):
            logs = np.abs(np.log(both))
        return np.where(logs[:, 0] >= logs[:, 1], both[:, 0], both[:, 1])

    def _corners(self, found: Closest) -> Int:
        return self.field.faces[found.face] if len(self.field.faces) else found.face[:, None].repeat(3, 1)


class _Way:
    """One direction of a field: from one surface to another, and smoothly beyond."""

    def __init__(self, before: Surface, after: Surface, spread: float) -> None:
        self.before, self.after = before, after
        self.size = before.diagonal or 1.0
        self.edge = before.mean_edge or spread
        self.map = SmoothMap(before, after, spread)

    @cached_property
    def index(self) -> SurfaceIndex | None:
        """Search structure of the surface; None without faces."""
        return SurfaceIndex(self.before) if len(self.before.faces) else None

    def closest(self, points: Float, progress: Progress = silent) -> Closest:
        """Closest points of the surface, or the nearest centres where there are no faces."""
        if self.index is not None:
            return self.index.closest(points, progress)
        distance, near = cKDTree(self.before.vertices).query(points)
        bary = np.tile([1.0, 0.0, 0.0], (len(points), 1))
        return Closest(distance, self.before.vertices[near], near.astype(np.int32), bary)

    def __call__(self, points: Float, progress: Progress = silent) -> tuple[Float, Float]:
        """Return where points (p, 3) go, and their signed distance (p,) from the surface."""
        found = self.closest(points, part(progress, 0.0, 0.3))
        moved = self.map(points, found.distance, SHARE, part(progress, 0.3, 0.8))
        near = np.flatnonzero(found.distance < MENDED * self.edge)
        if len(near) and self.index is not None:
            corners = self.before.faces[found.face[near]]
            place = np.einsum("pk,pkc->pc", found.barycentric[near], self.after.vertices[corners])
            gap = place - self.map(found.point[near], np.zeros(len(near)), SHARE, part(progress, 0.8, 1.0))
            moved[near] += ramp(found.distance[near], 0.0, MENDED * self.edge)[:, None] * gap
        fade = ramp(found.distance, FADE[0] * self.size, FADE[1] * self.size)
        moved = points + fade[:, None] * (moved - points)
        return moved, self.signed(points, found)

    def signed(self, points: Float, found: Closest) -> Float:
        """Return the signed distance (p,) of points to their closest points; negative inside."""
        if self.index is None:
            return found.distance
        side = np.einsum("ij,ij->i", points - found.point, self.index.pseudonormals(found))
        return np.where(side < 0, -found.distance, found.distance)


def _checked(points: ArrayLike, strength: float) -> Float:
    out = np.array(points, dtype=np.float64).reshape(-1, 3)
    if not np.isfinite(out).all():
        raise FemorsError("a point to be carried has coordinates that are not finite numbers")
    if not 0.0 <= strength <= 1.0:
        raise FemorsError(f"Strength: {strength} is outside 0 to 1")
    return out


def _blend(before: Float, after: Float, strength: float) -> Float:
    return after if strength == 1.0 else before + strength * (after - before)
