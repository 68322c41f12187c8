# SPDX-License-Identifier: GPL-3.0-or-later
"""ICP: two sampled meshes brought together, from one start or from many at once.

It minimises the distance to the tangent plane at the nearest node (Chen & Medioni 1991), with a small
share of the point-to-point distance that keeps what the planes leave free, over matches found in both
directions; from the partial mesh only, and trimmed (Chetverikov et al. 2002), where one covers a part
of the other.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from . import triples
from .crew import together
from .mesh import Float, Surface
from .reduce import reduced
from .transforms import inverse, transformed

SAMPLE = 1500  # nodes that ICP works with
POINT_SHARE = 0.05  # weight of the point-to-point distance beside the point-to-plane distance
TRIM = 0.8  # share of the matches kept where one mesh is partial
FACING_AWAY = 4.0  # factor on the squared distance of a match whose normals oppose: it counts double
GROWTH = 0.5  # logarithm of the scale that one step of ICP may take
FEWEST = 12  # matches that fix a transform
CYCLE, SAME = 4, 1e-9  # steps back, and how nearly the same misfit: ICP may go round in a few poses for ever


@dataclasses.dataclass(frozen=True, eq=False)
class Cloud:
    """Nodes of a mesh to be searched in, and fewer of them to search with.

    Attributes
    ----------
    nodes, normals : (n, 3) float64
        All nodes and their unit normals.
    tree : cKDTree
        Of the nodes.
    sample, sample_normals : (s, 3) float64
        What stands for the mesh where it searches in the other one.
    """

    nodes: Float
    normals: Float
    tree: cKDTree
    sample: Float
    sample_normals: Float

    @classmethod
    def of(cls, surface: Surface, sample: Surface | None = None) -> Cloud:
        """Take a surface, and a reduced version of it where there is one already."""
        if sample is None:
            sample = reduced(surface, SAMPLE)
        tree = cKDTree(surface.vertices)
        return cls(surface.vertices, surface.vertex_normals, tree, sample.vertices, sample.vertex_normals)

    def thinned(self, count: int) -> Cloud:
        """The sample as the whole, and every k-th node of it, about `count`, as the sample."""
        chosen = slice(None, None, max(len(self.sample) // count, 1))
        tree = cKDTree(self.sample)
        return Cloud(self.sample, self.sample_normals, tree, self.sample[chosen], self.sample_normals[chosen])


@dataclasses.dataclass(frozen=True, eq=False)
class Registration:
    """What ICP brings together: the source onto the target.

    Attributes
    ----------
    source, target : Cloud
        The two meshes.
    partial : {"none", "source", "target"}
        Which of them shows only a part of the other.
    tolerance : float
        ICP ends when no sample moves by more than this, in the target's unit.
    """

    source: Cloud
    target: Cloud
    partial: str
    tolerance: float

    def thinned(self, count: int) -> Registration:
        """The same with about `count` samples on either side."""
        return dataclasses.replace(self, source=self.source.thinned(count), target=self.target.thinned(count))


class Fit(NamedTuple):
    """A transform (4, 4) of the source, and the misfit that it leaves."""

    matrix: Float
    misfit: float


class Matches(NamedTuple):
    """Points (s, p, 3) under each of s transforms, and what each of these leaves.

    Attributes
    ----------
    x, y, n : (s, p, 3) float64
        Points of the moved source, points of the target, and the target's normals at these.
    chosen : (s, p) float64
        1 for the matches that count, 0 for the others.
    misfit : (s,) float64
        Root mean square distance; what was not matched is in it.
    """

    x: Float
    y: Float
    n: Float
    chosen: Float
    misfit: Float

    def some(self, rows: np.ndarray) -> Matches:
        """Those of some of the transforms."""
        return Matches(*(column[rows] for column in self))


# --- matches --------------------------------------------------------------------------------------
def matched(work: Registration, matrices: Float) -> Matches:
    """Match each sample with the nearest node of the other mesh, where both face the same way.

    Parameters
    ----------
    work : Registration
        What is to be brought together.
    matrices : (s, 4, 4) float64
        Transforms of the source.
    """
    source, target, partial = work.source, work.target, work.partial
    back = np.array([inverse(matrix) for matrix in matrices])
    turned = back[:, :3, :3]  # normals go by the inverse transpose; outward stays outward under a mirror

    def forth() -> tuple[Float, Float, Float, Float, Float]:
        moved = _each(matrices, source.sample)
        distance, hit = target.tree.query(moved)
        return distance, source.sample_normals @ turned, moved, target.nodes[hit], target.normals[hit]

    def backward() -> tuple[Float, Float, Float, Float, Float]:
        _, hit = source.tree.query(_each(back, target.sample))
        moved = _each(matrices, source.nodes[hit])
        distance = np.linalg.norm(moved - target.sample, axis=2)
        there = (np.broadcast_to(those, moved.shape) for those in (target.sample, target.sample_normals))
        return distance, source.normals[hit] @ turned, moved, *there

    kept, square = [], []
    ways = [forth] * (partial != "target") + [backward] * (partial != "source")
    for distance, ours, x, y, n in together(ways):
        facing = np.einsum("spi,spi->sp", ours, n) > 0
        kept.append((x, y, n, _chosen(distance, facing, partial)))
        square.append(_penalised(distance, facing, partial))
    x, y, n, chosen = (np.concatenate(parts, axis=1) for parts in zip(*kept, strict=True))
    return Matches(x, y, n, chosen, np.sqrt(np.concatenate(square, axis=1).mean(axis=1)))


def unlike(work: Registration, matrix: Float, normal: float) -> float:
    """Root mean square distance of two whole meshes' samples, each to the nearest in position and normal.

    Parameters
    ----------
    work : Registration
    matrix : (4, 4) float64
        Transform of the source.
    normal : float
        Share of the target's size that a unit normal stands for.
    """
    source, target = work.source, work.target
    weight = normal * float(np.linalg.norm(np.ptp(target.sample, axis=0)))
    turned = triples.unit(source.sample_normals @ inverse(matrix)[:3, :3])
    ours = np.hstack((transformed(matrix, source.sample), weight * turned))
    theirs = np.hstack((target.sample, weight * target.sample_normals))
    ways = (cKDTree(theirs).query(ours)[0], cKDTree(ours).query(theirs)[0])
    return float(np.sqrt(np.mean(np.concatenate(ways) ** 2)))


def _each(matrices: Float, points: Float) -> Float:
    """Apply each of the transforms (s, 4, 4) to its points, (p, 3) of all or (s, p, 3): (s, p, 3)."""
    return np.asarray(points @ matrices[:, :3, :3].transpose(0, 2, 1) + matrices[:, None, :3, 3])


def _chosen(distance: Float, facing: np.ndarray, partial: str) -> Float:
    """Which matches (s, p) count: those that face each other, but the farthest where a mesh is partial."""
    if partial == "none":
        return facing.astype(float)
    last = np.maximum((TRIM * (facing.sum(axis=1) - 1)).astype(int), 0)
    lasts = np.sort(np.where(facing, distance, np.inf), axis=1)[np.arange(len(last)), last]
    return (facing & (distance <= lasts[:, None])).astype(float)


def _penalised(distance: Float, facing: np.ndarray, partial: str) -> Float:
    """Squared distances for the comparison of poses, without the largest where a mesh is partial."""
    square = distance**2 * np.where(facing, 1.0, FACING_AWAY)
    if partial == "none":
        return square
    return np.sort(square, axis=1)[:, : max(int(TRIM * square.shape[1]), 1)]


# --- steps ----------------------------------------------------------------------------------------
_TURNS = np.array(
    [
        [[0, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[0, 0, 1], [0, 0, 0], [-1, 0, 0]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 0]],
    ],
    dtype=float,
)
_BASES = {
    "rigid": _TURNS,
    "similarity": np.concatenate((_TURNS, np.eye(3)[None])),
    "affine": np.eye(9).reshape(9, 3, 3),
}
"""Generators (k, 3, 3) of the linear part of a small transform, by its kind."""


def icp(work: Registration, starts: Float, kind: str, iterations: int) -> list[Fit]:
    """Iterate from each of some transforms (s, 4, 4), side by side; return the best one met from each.

    Parameters
    ----------
    work : Registration
        What is to be brought together.
    starts : (s, 4, 4) float64
        Where the source is laid first.
    kind : {"rigid", "similarity", "affine"}
        What each step may do.
    iterations : int
        At most so many steps.
    """
    matrices, best = np.array(starts), np.array(starts)
    lowest, active = np.full(len(best), math.inf), np.arange(len(best))
    recent = np.full((len(best), CYCLE), math.inf)
    for number in range(iterations):
        matches = matched(work, matrices[active])
        better = matches.misfit < lowest[active]
        best[active[better]] = matrices[active[better]]
        lowest[active[better]] = matches.misfit[better]
        known = np.abs(recent[active] - matches.misfit[:, None]) <= SAME * matches.misfit[:, None]
        recent[active, number % CYCLE] = matches.misfit
        going = (matches.chosen.sum(axis=1) >= FEWEST) & ~known.any(axis=1)
        active, matches = active[going], matches.some(going)
        if not len(active):
            break
        steps = _steps(matches, kind)
        change = np.abs(_each(steps, matches.x) - matches.x).max(axis=2)
        after = steps @ matrices[active]
        # else it would collapse or turn inside out
        sound = np.isfinite(after).all(axis=(1, 2)) & (np.linalg.det(steps[:, :3, :3]) >= 1e-6)
        matrices[active[sound]] = after[sound]
        active = active[sound & ((change * matches.chosen).max(axis=1) >= work.tolerance)]
        if not len(active):
            break
    last = matched(work, matrices).misfit
    return [
        Fit(matrix, float(there)) if there <= here * 1.001 else Fit(before, float(here))
        for matrix, there, before, here in zip(matrices, last, best, lowest, strict=True)
    ]


def _steps(matches: Matches, kind: str) -> Float:
    """Small transforms (s, 4, 4) that lessen the matches' distances, by linear least squares."""
    basis, chosen = _BASES[kind], matches.chosen
    count, points = chosen.shape
    centre = np.einsum("sp,spi->si", chosen, matches.x) / chosen.sum(axis=1)[:, None]
    local = (matches.x - centre[:, None]) * chosen[:, :, None]
    scale = np.maximum(np.abs(local).max(axis=(1, 2)), 1e-300)[:, None]
    local /= scale[:, None]
    # moves (s, p, k, 3): each generator's of each point, then the three shifts; none of what does not count
    turns = (local.reshape(-1, 3) @ basis.reshape(-1, 3).T).reshape(count, points, len(basis), 3)
    moves = np.concatenate((turns, chosen[:, :, None, None] * np.eye(3)), axis=2)
    gap = (matches.y - matches.x) / scale[:, None]
    along = np.einsum("spka,spa->spk", moves, matches.n)
    flat = moves.transpose(0, 1, 3, 2).reshape(count, 3 * points, -1)
    over, across = along.transpose(0, 2, 1), flat.transpose(0, 2, 1)
    system = over @ along + POINT_SHARE * (across @ flat)
    right = over @ np.einsum("spa,spa->sp", gap, matches.n)[:, :, None]
    right += POINT_SHARE * (across @ gap.reshape(count, -1, 1))
    own = np.arange(system.shape[1])
    system[:, own, own] += 1e-12 * np.trace(system, axis1=1, axis2=2)[:, None]
    theta = np.linalg.solve(system, right)[:, :, 0]
    out = np.tile(np.eye(4), (count, 1, 1))
    if kind == "affine":
        out[:, :3, :3] += np.einsum("sk,kab->sab", theta[:, :-3], basis)
    else:
        growth = 1.0 if kind == "rigid" else np.exp(np.clip(theta[:, 3], -GROWTH, GROWTH))[:, None, None]
        out[:, :3, :3] = growth * Rotation.from_rotvec(theta[:, :3]).as_matrix()
    out[:, :3, 3] = centre + scale * theta[:, -3:] - (out[:, :3, :3] @ centre[:, :, None])[:, :, 0]
    return out
