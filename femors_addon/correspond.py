# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement vectors between a moving source and a target, in both directions.

A pair is kept where the two surfaces face the same way; a node without a partner is left to the
field, which takes it along with its neighbours.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .crew import at_once
from .cutouts import normals_at
from .grnn import DisplacementField
from .mesh import Float, Surface
from .nearest import SurfaceIndex, weighted
from .progress import Progress, silent

LONGEST = 0.6  # spreads that one iteration may move a node
OUTLIER = 4.0  # median lengths beyond which a partial mesh's pair is left out
FACING = 0.3  # cosine that the normals of a pair must have, at least


@dataclasses.dataclass(frozen=True, eq=False)
class Vectors:
    """Training set of a field: where (k, 3), and the displacement asked for there (k, 3)."""

    centres: Float
    displacements: Float

    @property
    def rms(self) -> float:
        """Root mean square length of the displacements."""
        return float(np.sqrt(np.mean(np.sum(self.displacements**2, axis=1)))) if len(self.centres) else 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class Target:
    """The target of a level: all of it to be searched, some of its nodes to search from."""

    index: SurfaceIndex
    nodes: Float
    normals: Float

    @classmethod
    def of(cls, index: SurfaceIndex, sample: Surface) -> Target:
        return cls(index, sample.vertices, sample.vertex_normals)


def by_surface(source: Surface, target: Target, partial: str, progress: Progress = silent) -> Vectors:
    """Closest compatible surface points, source to target and target to source.

    Where one mesh is partial only its own nodes ask; matches to the open border of the searched
    mesh, which stands for all that is missing beyond, are left out. `progress` is told the same again and
    again where both ways go at once, see `crew.at_once`.
    """
    whole = target.index.surface

    def there(progress: Progress) -> tuple[Float, Float]:
        found = target.index.closest(source.vertices, progress)
        normals = interpolated_normals(whole, found.face, found.barycentric)
        kept = np.einsum("ij,ij->i", source.vertex_normals, normals) > FACING
        kept &= ~at_border(whole, found.face, found.barycentric)
        vector = found.point - source.vertices
        kept &= _sound(vector, source.vertex_normals, normals, partial)
        return source.vertices[kept], vector[kept]

    def back(progress: Progress) -> tuple[Float, Float]:
        found = SurfaceIndex(source).closest(target.nodes, progress)
        normals = interpolated_normals(source, found.face, found.barycentric)
        kept = np.einsum("ij,ij->i", target.normals, normals) > FACING
        kept &= ~at_border(source, found.face, found.barycentric)
        vector = target.nodes - found.point
        kept &= _sound(vector, normals, target.normals, partial)
        return found.point[kept], vector[kept]

    source.vertex_normals, whole.vertex_normals  # noqa: B018  both ways ask for them: worked out once
    return _both([there] * (partial != "target") + [back] * (partial != "source"), progress)


def by_nearest(source: Surface, target: Surface, normal_weight: float, partial: str) -> Vectors:
    """Nearest nodes in position and weighted normal, both ways, as published.

    The training set holds the target's nodes with the vector from their nearest source node, and the
    source's nodes with the vector to their nearest target node.
    """
    ours = np.hstack((source.vertices, normal_weight * source.vertex_normals))
    theirs = np.hstack((target.vertices, normal_weight * target.vertex_normals))

    def back(_progress: Progress) -> tuple[Float, Float]:
        hit = cKDTree(ours).query(theirs)[1]
        vector = target.vertices - source.vertices[hit]
        kept = _sound(vector, source.vertex_normals[hit], target.vertex_normals, partial)
        return target.vertices[kept], vector[kept]

    def there(_progress: Progress) -> tuple[Float, Float]:
        hit = cKDTree(theirs).query(ours)[1]
        vector = target.vertices[hit] - source.vertices
        kept = _sound(vector, source.vertex_normals, target.vertex_normals[hit], partial)
        return source.vertices[kept], vector[kept]

    return _both([back] * (partial != "source") + [there] * (partial != "target"))


def _both(ways: Sequence[Callable[[Progress], tuple[Float, Float]]], progress: Progress = silent) -> Vectors:
    """The vectors of one way or two, one after the other."""
    centres, vectors = zip(*at_once(*ways, progress=progress), strict=True)
    return Vectors(np.concatenate(centres), np.concatenate(vectors))


def _sound(vector: Float, normal: Float, other: Float, partial: str) -> np.ndarray:
    """Pairs (k,) to keep. All of them, but where one mesh is partial: the face that closes a cut has
    no counterpart, and gives itself away by its direction or by the length of its vectors.
    """
    if partial == "none":
        return np.ones(len(vector), dtype=bool)
    length = np.linalg.norm(vector, axis=1)
    facing = np.einsum("ij,ij->i", normal, other) > FACING
    return facing & (length <= OUTLIER * np.median(length[facing])) if facing.any() else facing


def widening(field: DisplacementField, points: Float, progress: Progress = silent) -> Float:
    """Evaluate a field at points (p, 3), with a spread that grows as the centres recede.

    For what lies beyond a partial target: the field itself is there what the nearest centre says, and
    the error of a single vector, added up over the iterations, would carry half a bone away. The
    spread is that of the field up to one spread from the centres, and the distance from there on.
    """
    out = field(points, progress)
    distance = cKDTree(field.centres).query(points)[0]
    spread = field.spread
    while (distance > spread).any():
        rows = np.flatnonzero((distance > spread) & (distance <= 2.0 * spread))
        share = np.log2(distance[rows] / spread)[:, None]
        near, far = (
            dataclasses.replace(field, spread=width)(points[rows], progress)
            for width in (spread, 2.0 * spread)
        )
        out[rows] = (1.0 - share) * near + share * far
        spread *= 2.0
    return out


def shortened(displacements: Float, spread: float) -> Float:
    """Limit displacements (k, 3) to `LONGEST` spreads: what differs more over a spread folds space."""
    length = np.linalg.norm(displacements, axis=1, keepdims=True)
    limit = LONGEST * spread
    return displacements * np.where(length > limit, limit / np.maximum(length, limit), 1.0)


def compatible(
    moved: Surface, nodes: NDArray, target: SurfaceIndex, partial: str, close: float = 0.0
) -> tuple[Float, np.ndarray]:
    """Return the target's points (r, 3) closest to some nodes, and which nodes (r,) may go there.

    Those that face as it does, or are nearer than `close` to it; where one mesh is partial not to its end.
    """
    found = target.closest(moved.vertices[nodes])
    normals = interpolated_normals(target.surface, found.face, found.barycentric)
    kept = np.einsum("ij,ij->i", normals_at(moved, nodes), normals) > FACING
    kept |= found.distance < close
    if partial != "none":
        kept &= ~at_border(target.surface, found.face, found.barycentric)
    return found.point, kept


def interpolated_normals(surface: Surface, face: np.ndarray, barycentric: Float) -> Float:
    """Vertex normals (p, 3) interpolated on faces; not of unit length."""
    return weighted(surface.vertex_normals, surface, face, barycentric)


def at_border(surface: Surface, face: np.ndarray, barycentric: Float) -> np.ndarray:
    """True (p,) where a closest point lies on an edge or vertex of the open border."""
    border = surface.border
    if not border.any():
        return np.zeros(len(face), dtype=bool)
    return ((barycentric <= 1e-9) | border[surface.faces[face]]).all(axis=1)
