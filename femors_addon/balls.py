# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces that may meet: those whose enclosing balls overlap.

Balls are searched octave of size by octave of size, so that one large face does not widen the search of a
million small ones, and large faces are cut into pieces for it.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from . import triples
from .crew import in_blocks
from .mesh import Float, Surface

Index = NDArray[np.int64]

BLOCK_PAIRS, BLOCK_FACES = 300_000, 32_000
"""Pairs of faces searched together: about 15 MB; and faces, at most."""

AT_ONCE = 64_000
"""Pairs of faces looked at together: what they need stays in the processor's cache."""


def searches(a: Surface, b: Surface, within: float = 0.0) -> Iterator[Search]:
    """Return the parts of the search for pairs (face of a, face of b) whose enclosing balls overlap.

    Of two surfaces also the pairs whose balls are `within` a distance of each other.

    Balls are searched octave of size by octave of size, so that one large face does not widen the
    search of a million small ones. With ``b is a`` each pair is met once.
    """
    return _searches(*_classes(a, b, within))


def _classes(a: Surface, b: Surface, within: float) -> tuple[list[Balls], list[Balls]]:
    """Balls of both, by size; those of b are `within` larger. Of one surface the same list twice, if any."""
    faces_a, faces_b = np.arange(len(a.faces)), np.arange(len(b.faces))
    if len(faces_a) and len(faces_b) and a is not b:
        low, high = np.maximum(a.bounds[0], b.bounds[0]), np.minimum(a.bounds[1], b.bounds[1])
        low, high = low - within, high + within
        faces_a, faces_b = _within(a.corners, low, high), _within(b.corners, low, high)
    if not len(faces_a) or not len(faces_b):
        return [], []
    classes_a = size_classes(a, faces_a)
    classes_b = classes_a if a is b else size_classes(b, faces_b)
    if a is not b and within > 0:
        classes_b = [dataclasses.replace(balls, radius=balls.radius + within) for balls in classes_b]
    return classes_a, classes_b


def _searches(classes_a: list[Balls], classes_b: list[Balls]) -> Iterator[Search]:
    """Yield the searches of each class against each; of one list twice each two once."""
    for i, one in enumerate(classes_a):
        for two in classes_b[i:] if classes_a is classes_b else classes_b:
            if one is two:
                yield from _meetings(one)
            else:
                yield from (Search(one, two, part, slice(None)) for part in _parts(one, two))


def _within(corners: Float, low: Float, high: Float) -> Index:
    """Indices of the faces (m, 3, 3) whose bounding box reaches into a box."""
    return np.flatnonzero(
        triples.every((triples.least(corners) <= high) & (triples.greatest(corners) >= low))
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Balls:
    """Enclosing balls of about one size: tree of their centres, radii, and the face of each."""

    tree: cKDTree
    radius: Float
    face: Index


@dataclasses.dataclass(frozen=True, eq=False)
class Search:
    """Some balls of one class against some of another, by their places in the order of their trees.

    The same places of the same class: each pair of them once.
    """

    one: Balls
    two: Balls
    part: slice
    other: slice

    def candidates(self) -> Iterator[tuple[Index, Index]]:
        """Yield pairs (face, face) of balls that overlap, `AT_ONCE` at a time."""
        one, two = self.one, self.two
        reach = _reach(one, two)
        f, g = one.tree.indices[self.part], two.tree.indices[self.other]
        if one is two and self.part == self.other:
            centre = one.tree.data[f]
            pairs = cKDTree(centre, balanced_tree=False).query_pairs(reach, output_type="ndarray")
            first, second = pairs[:, 0], pairs[:, 1]
            apart = triples.squared(centre.take(first, axis=0) - centre.take(second, axis=0))
            yield from self._near(f[first], f[second], np.sqrt(apart))
            return
        g = _beside(two, g, triples.box(one.tree.data[f]), reach)
        if len(g):
            f = _beside(one, f, triples.box(two.tree.data[g]), reach)
        if len(f) and len(g):
            here, there = (cKDTree(b.tree.data[at], balanced_tree=False) for b, at in ((one, f), (two, g)))
            pairs = here.sparse_distance_matrix(there, reach, output_type="ndarray")
            yield from self._near(f[pairs["i"]], g[pairs["j"]], pairs["v"])

    def _near(self, f: Index, g: Index, apart: Float) -> Iterator[tuple[Index, Index]]:
        """Yield the faces of the balls (f, g), so far apart, that overlap."""
        near = np.flatnonzero(apart <= (self.one.radius[f] + self.two.radius[g]) * (1 + 1e-9))
        f, g = self.one.face[f[near]], self.two.face[g[near]]
        for start in range(0, len(f), AT_ONCE):
            yield f[start : start + AT_ONCE], g[start : start + AT_ONCE]


def _beside(balls: Balls, some: Index, box: tuple[Float, Float], reach: float) -> Index:
    """Keep those of some balls whose centres are within reach of a box."""
    centre = balls.tree.data.take(some, axis=0)
    close = triples.every(centre >= box[0] - reach)
    close &= triples.every(centre <= box[1] + reach)
    return some[close]


def _meetings(balls: Balls) -> Iterator[Search]:
    """Search a class in itself: each part, and each two parts that are near each other."""
    parts, reach = _parts(balls, balls), _reach(balls, balls)
    boxes = [triples.box(balls.tree.data[balls.tree.indices[part]]) for part in parts]
    low, high = (np.array(corners) for corners in zip(*boxes, strict=True))
    for i, part in enumerate(parts):
        yield Search(balls, balls, part, part)
        near = triples.every(low[i + 1 :] <= high[i] + reach) & triples.every(high[i + 1 :] >= low[i] - reach)
        for j in np.flatnonzero(near) + i + 1:
            yield Search(balls, balls, part, parts[j])


def overlapping(some: list[Balls], others: list[Balls]) -> tuple[Index, Index]:
    """Return the pairs (face of the first, face of the second) of balls that overlap, in no order.

    Faces in pieces are in several. The trees are searched as they are: cheap where either are few.
    """
    found = [np.empty((2, 0), dtype=np.int64)]
    for one in some:
        for two in others:
            pairs = one.tree.sparse_distance_matrix(two.tree, _reach(one, two), output_type="ndarray")
            i, j = pairs["i"], pairs["j"]
            near = np.flatnonzero(pairs["v"] <= (one.radius[i] + two.radius[j]) * (1 + 1e-9))
            found.append(np.stack((one.face[i[near]], two.face[j[near]])))
    first, second = np.concatenate(found, axis=1)
    return first, second


def _reach(one: Balls, two: Balls) -> float:
    """Distance between centres beyond which no two balls of these overlap."""
    return float(one.radius.max() + two.radius.max()) * (1 + 1e-9)


def _parts(one: Balls, two: Balls) -> list[slice]:
    """Cut the search of one class against another into parts of some `BLOCK_PAIRS` or `BLOCK_FACES`."""
    order, stride = one.tree.indices, 32
    sample = two.tree.query_ball_point(one.tree.data[order[::stride]], _reach(one, two), return_length=True)
    cost = np.maximum(np.asarray(sample) / BLOCK_PAIRS, 1.0 / BLOCK_FACES)
    block = np.cumsum(cost * stride).astype(np.int64)
    cuts = [0, *((np.flatnonzero(np.diff(block)) + 1) * stride).tolist(), len(order)]
    return [slice(start, stop) for start, stop in itertools.pairwise(cuts)]


def size_classes(surface: Surface, faces: Index) -> list[Balls]:
    """Sort the enclosing balls of some faces by octaves of size."""
    centre, radius, owner = _pieces(surface.vertices.take(surface.faces[faces], axis=0), faces)
    # below a thousandth of the usual size all are one class, and most of an even mesh are of one
    smallest = max(float(np.median(radius)) * 1.25 * 2.0**-10, float(radius.max()) * 2.0**-30)
    octave = np.zeros(len(radius), dtype=np.int64)
    if smallest > 0:
        octave = np.ceil(np.log2(np.maximum(radius, smallest) / smallest)).astype(np.int64)
    classes = []
    for level in np.unique(octave):
        rows = np.flatnonzero(octave == level)
        classes.append(Balls(cKDTree(centre[rows], balanced_tree=False), radius[rows], owner[rows]))
    return classes


def _pieces(corners: Float, owner: Index) -> tuple[Float, Float, Index]:
    """Enclosing balls of faces (m, 3, 3): (centres, radii, owner of each).

    The ball of a long thin face holds much that is not near it: faces larger than the usual are
    halved, the largest first, until there are some times as many pieces as faces.
    """
    centre, radius = enclosing_balls(corners)
    usual, budget = 2.0 * float(np.median(radius)), 3 * len(corners) + 1000
    while True:
        large = radius > max(usual, 0.5 * float(radius.max()))
        if not large.any() or len(radius) > budget:
            return centre, radius, owner
        halves = _halved(corners[large])
        new_centre, new_radius = enclosing_balls(halves)
        corners = np.concatenate((corners[~large], halves))
        centre = np.concatenate((centre[~large], new_centre))
        radius = np.concatenate((radius[~large], new_radius))
        owner = np.concatenate((owner[~large], np.tile(owner[large], 2)))


def enclosing_balls(corners: Float) -> tuple[Float, Float]:
    """Return centres (m, 3) and radii (m,) of balls around faces (m, 3, 3)."""

    def of(block: slice) -> tuple[Float, Float]:
        a, b, c = (np.ascontiguousarray(corners[block, i]) for i in range(3))
        centre = (a + b + c) / 3.0
        radius = triples.squared(a - centre)
        for corner in (b, c):
            np.maximum(radius, triples.squared(corner - centre), out=radius)
        return centre, np.sqrt(radius)

    centre, radius = zip(*in_blocks(of, len(corners)), strict=True)
    return np.concatenate(centre), np.concatenate(radius)


def _halved(corners: Float) -> Float:
    """Cut each face (m, 3, 3) at the middle of its longest side: first halves, then second halves."""
    rows = np.arange(len(corners))
    sides = [corners[:, (i + 1) % 3] - corners[:, i] for i in range(3)]
    start = np.argmax([triples.dot(side, side) for side in sides], axis=0)
    stop = (start + 1) % 3
    middle = 0.5 * (corners[rows, start] + corners[rows, stop])
    one, two = corners.copy(), corners.copy()
    one[rows, stop], two[rows, start] = middle, middle
    return np.concatenate((one, two))
