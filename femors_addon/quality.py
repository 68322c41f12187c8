# SPDX-License-Identifier: GPL-3.0-or-later
"""Every measure of a morphed mesh, in one place: how well it fits, how well it is shaped.

The definitions are those of Andreassen et al. (2024); they reproduce the figures stored with the
authors' example. No measure of an empty or degenerate mesh is ever NaN or infinite.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from . import triples
from .crew import at_once, blockwise
from .intersect import Piercings, crossings, piercings, self_intersections
from .mesh import Float, Int, Surface
from .nearest import SurfaceIndex
from .progress import Progress, part, repeating, silent

__all__ = [
    "Comparison",
    "Piercings",
    "Stat",
    "aspect_ratio",
    "compare",
    "crossings",
    "degenerate",
    "dihedral_angles",
    "edge_faults",
    "flipped_faces",
    "folded_faces",
    "nearest_vertex_distance",
    "piercings",
    "self_intersections",
    "skewness",
]

WORST_ASPECT = 1e6
"""Aspect ratio given to a face with a side of no length, and the largest given to any."""

SMALL, NOTHING = 0.1, 1e-9
"""Below the first, figures are written with significant digits; below the second they are rounding."""


@dataclasses.dataclass(frozen=True)
class Stat:
    """A sample in four numbers: median, 1st and 99th percentile, maximum; all 0 for an empty one."""

    median: float
    p01: float
    p99: float
    maximum: float

    @classmethod
    def of(cls, values: ArrayLike) -> Stat:
        """Summarise finite values of any shape (percentiles by linear interpolation)."""
        values = np.asarray(values, dtype=np.float64).ravel()
        if not len(values):
            return cls(0.0, 0.0, 0.0, 0.0)
        median, p01, p99 = np.percentile(values, (50, 1, 99))
        return cls(float(median), float(p01), float(p99), float(values.max()))

    def as_dict(self) -> dict[str, float]:
        """Return the four numbers by name."""
        return dataclasses.asdict(self)

    def __str__(self) -> str:
        """Return for instance ``0.130 [0.002, 0.870] max 2.62``, in metres ``0.00013 [2e-06, 0.00087] ...``.

        Three decimals; three significant digits where those would show little, the 99th percentile
        being below 0.1. Rounding (a maximum below 1e-9) stays 0.000.
        """
        if self.p99 < SMALL and self.maximum >= NOTHING:
            median, p01, p99, maximum = (
                f"{value:.3g}" if abs(value) >= NOTHING else "0"
                for value in (self.median, self.p01, self.p99, self.maximum)
            )
            return f"{median} [{p01}, {p99}] max {maximum}"
        return f"{self.median:.3f} [{self.p01:.3f}, {self.p99:.3f}] max {_short(self.maximum)}"


def _short(value: float) -> str:
    """Three significant digits, without an exponent and never fewer than the whole part."""
    digits = 2 - int(np.floor(np.log10(abs(value)))) if value else 2
    return f"{value:.{min(max(digits, 0), 3)}f}"


# --- the shape of faces -----------------------------------------------------------------------------
def aspect_ratio(surface: Surface) -> Float:
    """Longest side over shortest side of each face (m,), from 1 to `WORST_ASPECT`."""

    def of(a: Float, b: Float, c: Float) -> Float:
        squared = _squared_sides(a, b, c)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.sqrt(triples.greatest(squared) / triples.least(squared))
        return np.where(ratio < WORST_ASPECT, ratio, WORST_ASPECT)  # also where it is NaN

    return surface.told(of)


def skewness(surface: Surface) -> Float:
    """Equiangular skewness of each face (m,): 0 equilateral, 1 degenerate.

    ``max((largest - 60) / 120, (60 - smallest) / 60)`` of the angles in degrees; as an angle sum of
    180 makes the second the larger of the two, or its equal, it is ``1 - smallest / 60``.
    """

    def of(a: Float, b: Float, c: Float) -> Float:
        smallest = np.full(len(a), np.pi / 3)
        area = triples.length(triples.crossed(a, b, c))
        for here, one, two in ((a, b, c), (b, c, a), (c, a, b)):
            angle = np.arctan2(area, np.einsum("ij,ij->i", one - here, two - here))
            smallest = np.minimum(smallest, angle)
        return 1.0 - smallest / (np.pi / 3)

    return surface.told(of)


def dihedral_angles(surface: Surface) -> Float:
    """Angle between the normals of the two faces at an edge, in degrees: 0 flat, 180 folded back.

    One value per half-edge (2k,), so that each edge with two faces counts twice; the surface has to
    be wound consistently. A face without area has no direction and counts as flat.
    """
    pairs, normals = surface.edge_faces[0], surface.face_normals

    def of(block: slice) -> Float:
        one, two = (normals.take(face, axis=0) for face in pairs[block].T)
        # Kahan's form: exact for small angles, where the arc cosine loses half the digits
        apart, along = triples.length(one - two), triples.length(one + two)
        angle: Float = np.degrees(2.0 * np.arctan2(apart, along))
        angle[~(triples.some(one != 0) & triples.some(two != 0))] = 0.0
        return angle

    angle = blockwise(of, len(pairs))
    twice = np.empty((len(angle), 2))
    twice[:] = angle[:, None]  # np.repeat would hold the interpreter
    return twice.ravel()


def degenerate(surface: Surface) -> np.ndarray:
    """True (m,) for the faces without area: height below 1e-12 of the longest side."""

    def of(a: Float, b: Float, c: Float) -> np.ndarray:
        longest = triples.greatest(_squared_sides(a, b, c))
        return ~(triples.length(triples.crossed(a, b, c)) > 1e-12 * longest)

    return surface.told(of)


def edge_faults(surface: Surface) -> tuple[int, int]:
    """Return how many edges have one face only (open), and how many three or more (not manifold)."""
    sides = surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    _, count = np.unique(np.sort(sides, axis=1) @ [len(surface.vertices), 1], return_counts=True)
    return int((count == 1).sum()), int((count > 2).sum())


def flipped_faces(before: Surface, after: Surface) -> Int:
    """Return the faces (k,) int32 that a movement has folded over or flattened to nothing.

    A face is folded over where its normal opposes the mean of the normals at its own corners, so that
    a mesh which is mirrored as a whole has none. Faces that were so `before` do not count. Of several
    closed components, those turned inside out count with all their faces, unless all are.

    Parameters
    ----------
    before, after : Surface
        The same faces at two sets of positions.
    """
    if before.faces is not after.faces and not np.array_equal(before.faces, after.faces):
        raise ValueError("flipped_faces() compares one mesh at two sets of positions")
    folded = (opposed(after) & ~opposed(before)) | inverted(before, after)
    return np.flatnonzero(folded | (degenerate(after) & ~degenerate(before))).astype(np.int32)


def folded_faces(surface: Surface) -> Int:
    """Return the faces (k,) int32 that lie turned against their neighbourhood."""
    return np.flatnonzero(opposed(surface)).astype(np.int32)


def opposed(surface: Surface) -> np.ndarray:
    """True (m,) for the faces turned against their neighbourhood."""
    return surface.facing < -1e-9


def inverted(before: Surface, after: Surface) -> np.ndarray:
    """True (m,) for the faces of closed components whose volume has changed its sign, unless all have."""
    count, part = len(before.faces), before.components
    closed = before.closed
    parts = len(closed)
    if parts < 2 or not closed.any():  # turned, it is so as a whole
        return np.zeros(count, dtype=bool)
    change = np.sign(_volumes(before, part, parts)) * np.sign(_volumes(after, part, parts))
    turned = closed & (change < 0)
    if not (closed & (change > 0)).any():  # mirrored as a whole
        return np.zeros(count, dtype=bool)
    return turned[part]


def _volumes(surface: Surface, part: np.ndarray, parts: int) -> Float:
    """Signed volume of each closed component (parts,), 0 where it is rounding only."""
    centre = triples.total(surface.corners) / 3.0
    faces = np.maximum(np.bincount(part, minlength=parts), 1)
    middle = np.column_stack([np.bincount(part, axis, minlength=parts) / faces for axis in centre.T])
    away = centre - middle[part]
    volume = np.bincount(part, np.einsum("ij,ij->i", away, surface.face_cross), minlength=parts) / 6.0
    reach = np.bincount(part, triples.length(away) * surface.face_areas, minlength=parts)
    return np.where(np.abs(volume) > 1e-9 * reach, volume, 0.0)


def _squared_sides(a: Float, b: Float, c: Float) -> Float:
    """Squared lengths (m, 3) of the sides of triangles with corners (m, 3)."""
    return np.column_stack([np.einsum("ij,ij->i", side, side) for side in (a - c, b - a, c - b)])


# --- distances --------------------------------------------------------------------------------------
def nearest_vertex_distance(points: ArrayLike, target_vertices: ArrayLike) -> Float:
    """Distance (p,) from each point to the nearest target vertex: the paper's "Hausdorff" distance."""
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    target = np.asarray(target_vertices, dtype=np.float64).reshape(-1, 3)
    if not len(points) or not len(target):
        return np.zeros(len(points))
    tree = cKDTree(target, balanced_tree=False)
    return blockwise(lambda block: np.asarray(tree.query(points[block])[0]), len(points))


def _used(surface: Surface) -> Float:
    """The positions of the vertices that faces use; a loose vertex is no part of the surface."""
    used = np.zeros(len(surface.vertices), dtype=bool)
    used[surface.faces.ravel()] = True
    return surface.vertices[used]


# --- all of them ------------------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True)
class Comparison:
    """A morphed mesh against its target and against what it was.

    Attributes
    ----------
    surface_to_target, target_to_surface : Stat
        Exact distance from the vertices of the one to the surface of the other. The first is small
        by construction wherever vertices are projected; the second shows what was not covered.
    hausdorff : Stat
        Distance from each morphed vertex to the nearest target vertex. It does not go to zero: on a
        perfect surface it is about 0.4 of the target's edge length.
    aspect, skewness, dihedral : Stat
        Shape of the morphed faces, see `aspect_ratio`, `skewness`, `dihedral_angles` (degrees).
    movement : Stat
        Distance from each source vertex to its morphed position.
    flipped : int
        Faces folded over or flattened by the movement, see `flipped_faces`.
    self_intersecting : int
        Morphed faces that cross another, see `self_intersections`.
    sample : int
        Vertices of each mesh, at most, that the distances were measured at; 0 for all of them.
    """

    surface_to_target: Stat
    target_to_surface: Stat
    hausdorff: Stat
    aspect: Stat
    skewness: Stat
    dihedral: Stat
    movement: Stat
    flipped: int
    self_intersecting: int
    sample: int = dataclasses.field(default=0, compare=False)

    def as_dict(self) -> dict[str, dict[str, float] | int]:
        """Return the figures as plain numbers by name."""
        return {name: value for name, value in dataclasses.asdict(self).items() if name != "sample"}


def compare(
    source: Surface,
    morphed: Surface,
    target: Surface,
    *,
    target_index: SurfaceIndex | None = None,
    to_target: Float | None = None,
    from_target: Float | None = None,
    self_intersecting: int | None = None,
    sample: int = 0,
    progress: Progress = silent,
) -> Comparison:
    """Measure `morphed` (the faces of `source` at new positions) against `target`.

    All three cleaned: merged and wound consistently. What is known already need not be measured again:
    `target_index` is the search structure of `target`, `to_target` (n,) the morphed vertices' distances
    to it, `from_target` (k,) the way back, `self_intersecting` the number of morphed faces that cross
    others. With a `sample` above 0 every k-th vertex of a mesh that has more than so many is looked at.
    """
    points, aims = _used(morphed), _used(target)
    everything = aims
    sample = sample if max(len(points), len(aims)) > sample else 0
    if sample:
        points, aims = (those[:: len(those) // (sample + 1) + 1] for those in (points, aims))
    there = back = np.zeros(0)
    if len(points) and len(aims):
        index = target_index or SurfaceIndex(target)
        there = index.closest(points, part(progress, 0.0, 0.4)).distance if to_target is None else to_target
        back = (
            SurfaceIndex(morphed).closest(aims, part(progress, 0.4, 0.8)).distance
            if from_target is None
            else from_target
        )
    if self_intersecting is None:
        self_intersecting = len(np.unique(self_intersections(morphed, part(progress, 0.8, 0.9))))
    progress(0.9, "shapes of elements")

    def figure(measure: Callable[[Surface], Float]) -> Callable[[Progress], Stat]:
        return lambda _: Stat.of(measure(morphed))

    flipped, nearest, dihedral, skew, aspect = at_once(
        lambda _: len(flipped_faces(source, morphed)),
        lambda _: Stat.of(nearest_vertex_distance(points, everything)),
        figure(dihedral_angles),
        figure(skewness),
        figure(aspect_ratio),
        progress=repeating(progress, 0.9, "shapes of elements"),
    )
    return Comparison(
        surface_to_target=Stat.of(there),
        target_to_surface=Stat.of(back),
        hausdorff=nearest,
        aspect=aspect,
        skewness=skew,
        dihedral=dihedral,
        movement=Stat.of(triples.length(morphed.vertices - source.vertices)),
        flipped=flipped,
        self_intersecting=self_intersecting,
        sample=sample,
    )
