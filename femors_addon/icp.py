# SPDX-License-Identifier: GPL-3.0-or-later
"""ICP: two sampled meshes brought together from a start that is near enough.

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

from .mesh import Float, Surface
from .reduce import reduced
from .transforms import homogeneous, inverse, transformed

SAMPLE = 1500  # nodes that ICP works with
POINT_SHARE = 0.05  # weight of the point-to-point distance beside the point-to-plane distance
TRIM = 0.8  # share of the matches kept where one mesh is partial
FACING_AWAY = 4.0  # factor on the squared distance of a match whose normals oppose: it counts double
GROWTH = 0.5  # logarithm of the scale that one step of ICP may take
FEWEST = 12  # matches that fix a transform


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
    """Points (p, 3): x of the moved source, y of the target, n the target's normal at y; and the misfit."""

    x: Float
    y: Float
    n: Float
    misfit: float  # root mean square distance; what was not matched is in it


# --- matches --------------------------------------------------------------------------------------
def matched(work: Registration, matrix: Float) -> Matches:
    """Match each sample with the nearest node of the other mesh, where both face the same way."""
    source, target, partial = work.source, work.target, work.partial
    back = inverse(matrix)
    turned = back[:3, :3]  # normals go by the inverse transpose; outward stays outward under a mirror
    directions = []
    if partial != "target":
        moved = transformed(matrix, source.sample)
        distance, hit = target.tree.query(moved)
        ours = source.sample_normals @ turned
        directions.append((distance, ours, moved, target.nodes[hit], target.normals[hit]))
    if partial != "source":
        _, hit = source.tree.query(transformed(back, target.sample))
        moved = transformed(matrix, source.nodes[hit])
        distance = np.linalg.norm(moved - target.sample, axis=1)
        ours = source.normals[hit] @ turned
        directions.append((distance, ours, moved, target.sample, target.sample_normals))
    kept, square = [], []
    for distance, ours, x, y, n in directions:
        facing = np.einsum("ij,ij->i", ours, n) > 0
        chosen = _chosen(distance, facing, partial)
        kept.append((x[chosen], y[chosen], n[chosen]))
        square.append(_penalised(distance, facing, partial))
    x, y, n = (np.concatenate(parts) for parts in zip(*kept, strict=True))
    return Matches(x, y, n, math.sqrt(float(np.mean(np.concatenate(square)))))


def _chosen(distance: Float, facing: np.ndarray, partial: str) -> np.ndarray:
    """Which matches count: those that face each other, without the farthest where a mesh is partial."""
    if partial == "none" or not facing.any():
        return np.flatnonzero(facing)
    return np.flatnonzero(facing & (distance <= np.quantile(distance[facing], TRIM)))


def _penalised(distance: Float, facing: np.ndarray, partial: str) -> Float:
    """Squared distances for the comparison of poses, without the largest where a mesh is partial."""
    square = distance**2 * np.where(facing, 1.0, FACING_AWAY)
    if partial == "none":
        return square
    return np.sort(square)[: max(int(TRIM * len(square)), 1)]


def misfits(work: Registration, matrices: Float) -> Float:
    """Misfit (s,) of many transforms (s, 4, 4) of whole meshes at once, from every second sample.

    As `matched` tells it, but distances from the target are taken in the source's frame, and scaled.
    """
    square = []
    back = np.array([inverse(matrix) for matrix in matrices])
    scale = np.cbrt(np.abs(np.linalg.det(matrices[:, :3, :3])))[:, None]
    directions = ((matrices, work.source, work.target, 1.0), (back, work.target, work.source, scale))
    for there, one, two, unit in directions:
        linear, shift = there[:, :3, :3], there[:, None, :3, 3]
        moved = one.sample[::2] @ linear.transpose(0, 2, 1) + shift
        distance, hit = two.tree.query(moved)
        # normals go by the inverse transpose: to have them the other way round is the same sign
        turned = two.normals[hit] @ linear
        facing = np.einsum("spi,pi->sp", turned, one.sample_normals[::2]) > 0
        square.append((unit * distance) ** 2 * np.where(facing, 1.0, FACING_AWAY))
    misfit: Float = np.sqrt(np.concatenate(square, axis=1).mean(axis=1))
    return misfit


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


def icp(work: Registration, start: Float, kind: str, iterations: int) -> Fit:
    """Iterate from a transform (4, 4); return the best one met.

    Parameters
    ----------
    work : Registration
        What is to be brought together.
    start : (4, 4) float64
        Where the source is laid first.
    kind : {"rigid", "similarity", "affine"}
        What each step may do.
    iterations : int
        At most so many steps.
    """
    matrix, best = start, Fit(start, math.inf)
    for _ in range(iterations):
        matches = matched(work, matrix)
        if matches.misfit < best.misfit:
            best = Fit(matrix, matches.misfit)
        if len(matches.x) < FEWEST:
            break
        step = _step(matches, kind)
        change = np.abs(transformed(step, matches.x) - matches.x).max()
        after = step @ matrix
        if not np.isfinite(after).all() or np.linalg.det(step[:3, :3]) < 1e-6:
            break  # it would collapse or turn inside out
        matrix = after
        if change < work.tolerance:
            break
    last = Fit(matrix, matched(work, matrix).misfit)
    return last if last.misfit <= best.misfit * 1.001 else best


def _step(matches: Matches, kind: str) -> Float:
    """Small transform (4, 4) that lessens the matches' distances, by linear least squares."""
    basis = _BASES[kind]
    centre = matches.x.mean(axis=0)
    scale = max(float(np.abs(matches.x - centre).max()), 1e-300)
    local = (matches.x - centre) / scale
    moves = np.einsum("kab,pb->pka", basis, local)
    moves = np.concatenate((moves, np.broadcast_to(np.eye(3), (len(local), 3, 3))), axis=1)
    gap = (matches.y - matches.x) / scale
    along = np.einsum("pka,pa->pk", moves, matches.n)
    flat = moves.transpose(0, 2, 1).reshape(-1, moves.shape[1])
    system = along.T @ along + POINT_SHARE * (flat.T @ flat)
    right = along.T @ np.einsum("pa,pa->p", gap, matches.n) + POINT_SHARE * (flat.T @ gap.ravel())
    system[np.diag_indices_from(system)] += 1e-12 * np.trace(system)
    theta = np.linalg.solve(system, right)
    linear = np.einsum("k,kab->ab", theta[:-3], basis)
    if kind == "affine":
        linear = np.eye(3) + linear
    else:
        growth = 1.0 if kind == "rigid" else math.exp(min(max(theta[3], -GROWTH), GROWTH))
        linear = growth * Rotation.from_rotvec(theta[:3]).as_matrix()
    return homogeneous(linear, centre + scale * theta[-3:] - linear @ centre)
