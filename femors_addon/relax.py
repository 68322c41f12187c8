# SPDX-License-Identifier: GPL-3.0-or-later
"""The end of a morph: nodes onto the target, elements back into shape."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from . import triples
from .correspond import FACING, at_border, interpolated_normals
from .crew import BLOCK, blockwise, in_blocks, together
from .features import FeatureLines
from .folds import Reference, bad_faces, folded, unfolded
from .grnn import DisplacementField
from .mesh import Float, Int, Surface
from .morph_settings import MorphSettings
from .nearest import Closest, SurfaceIndex
from .progress import Preview, Progress, repeating, silent, unseen

SLIDE = 0.45  # of the bending flow per round; below one half it is stable
SHAPE_ROUNDS = 10  # moves of shape matching between two projections
SHAPE_STEP = 0.8
FLOOR = 0.02  # weight of a face without distortion, where one that is badly distorted has one
TURN = 0.3  # cosine: no step may turn a face farther than this from its neighbourhood
BLUNT, BEND = 0.5, -0.34  # cosines of two faces: an edge of less than 60 degrees is bent to 110 at most
PRESSED = 1e-3  # of its area under that displacement: a face of less is pressed flat
SMOOTH = 8  # rounds of averaging that make a displacement take each neighbourhood along as one
TINY = np.finfo(np.float64).tiny
NEAR = 1.4  # mean edges: spread of the field that takes nodes without a partner along


def averaging(surface: Surface) -> sparse.csr_matrix:
    """(n, n) matrix that takes the mean over a node's neighbours, rows summing to one.

    Neighbours weigh by the inverse square of their distance, so that a short edge moves as one however
    large the faces around it are.
    """
    one, two = surface.edges.T
    length = triples.length(surface.vertices[one] - surface.vertices[two])
    weight = 1.0 / np.maximum(length, 1e-6 * max(surface.mean_edge, 1e-300)) ** 2
    n = len(surface.vertices)
    half = sparse.csr_matrix((weight, (one, two)), shape=(n, n))
    both = (half + half.T).tocsr()
    total = np.asarray(both.sum(axis=1)).ravel()
    return sparse.diags(1.0 / np.where(total > 0, total, 1.0)) @ both


def slide(moved: Surface, displacement: Float, mean: sparse.csr_matrix, rounds: int) -> Float:
    """Even out a displacement (n, 3) along the surface; what it does across the surface stays.

    The flow of the bending energy, sum |L d|^2 with L the umbrella operator: a displacement that
    varies linearly, a stretch or a turn, is left alone, so that the ends of a shaft tell its middle
    how far to slide. `moved` gives the surface's normals; border nodes stay.
    """
    normal, border = moved.vertex_normals, moved.border
    for _ in range(rounds):
        bend = mean @ displacement - displacement
        change = bend - mean @ bend
        change -= np.einsum("ij,ij->i", change, normal)[:, None] * normal
        change[border] = 0.0
        displacement = displacement + SLIDE * change
    return displacement


class ShapeMatching:
    """Moves nodes within the surface so that each face regains the shape that it had in the source.

    Every face is compared with its source face under the best similarity (a rotation and a scale of
    its own, in closed form in complex numbers), and each node goes to the mean of where its faces
    would have it. Shape and grading come back over a few edges; the large correspondence stays.

    It goes block by block through the processor's cache, numbers standing by axis and corner, for it is
    asked dozens of times.
    """

    def __init__(self, source: Surface) -> None:
        # indices as NumPy wants them, or each call would make them so
        self._corners = source.faces.T.astype(np.intp, order="C")
        flat = np.concatenate(
            in_blocks(lambda b: np.stack(self._flattened(source.vertices, b)[:2]), len(source.faces)), axis=2
        )
        self._along, self._across = flat  # (3, m) rest shape, the centroid at the origin
        square = (self._along**2).sum(axis=0) + (self._across**2).sum(axis=0)
        self._size = np.maximum(square, TINY)
        self._fixed, self._corners_of = source.border, self._by_node(len(source.vertices))

    def move(self, positions: Float) -> Float:
        """Return the move (n, 3) asked for at positions (n, 3); border nodes stay."""
        weight = np.empty((3, self._corners.shape[1]))
        wanted = np.empty((3, 3, self._corners.shape[1]))  # by axis, corner and face
        in_blocks(
            lambda b: self._changes(positions, b, weight[:, b], wanted[:, :, b]), self._corners.shape[1]
        )
        total = np.concatenate(together([partial(_mean, some, weight, wanted) for some in self._corners_of]))
        total[self._fixed] = 0.0
        return total

    def _by_node(self, count: int) -> list[sparse.csr_matrix]:
        """Matrices (k, 3 m), of some nodes each, that add up what stands by corner and face."""
        at = self._corners.ravel()
        first = np.arange(len(at) + 1, dtype=np.int32)
        return _cut(sparse.csc_matrix((np.ones(len(at)), at, first), shape=(count, len(at))).tocsr())

    def _changes(self, positions: Float, block: slice, weight: Float, wanted: Float) -> None:
        """Write the weights (3, k) of a block's faces, and the change (3, 3, k), by axis and corner."""
        here_x, here_y, along, across = self._flattened(positions, block)
        rest_x, rest_y, size = self._along[:, block], self._across[:, block], self._size[block]
        # the best rotation and scale, as a complex number: sum of conj(rest) times shape
        real = (_products(rest_x, here_x) + _products(rest_y, here_y)) / size
        imaginary = (_products(rest_x, here_y) - _products(rest_y, here_x)) / size
        x = real * rest_x
        x -= imaginary * rest_y
        x -= here_x
        y = real * rest_y
        y += imaginary * rest_x
        y -= here_y
        # worse faces speak louder, so that the worst of all is mended too
        fitted = np.maximum((real * real + imaginary * imaginary) * size, TINY)
        weight[:] = share = FLOOR + np.minimum((_products(x, x) + _products(y, y)) / fitted, 1.0)
        x *= share
        y *= share
        for axis in range(3):
            np.add(x * along[axis], y * across[axis], out=wanted[axis])

    def _flattened(self, positions: Float, block: slice) -> tuple[Float, Float, Float, Float]:
        """Each face of a block in its own plane: centroid at the origin, first side along the first axis.

        Returns (the corners' coordinates on that axis and on the one across it, each (3, k); the two
        axes (3, k), unit or zero).
        """
        one, two, three = self._corners[:, block]
        start = positions.take(one, axis=0)
        along, across = (
            np.ascontiguousarray((positions.take(end, axis=0) - start).T) for end in (two, three)
        )
        length = _normalised(along)
        foot = _products(across, along)
        across -= foot * along
        height = _normalised(across)
        middle, third = (length + foot) / 3.0, height / 3.0
        return (
            np.stack((-middle, length - middle, foot - middle)),
            np.stack((-third, -third, height - third)),
            along,
            across,
        )


def _cut(matrix: sparse.csr_matrix) -> list[sparse.csr_matrix]:
    """Cut a matrix into blocks of rows, for their products to go to the threads there are."""
    return [matrix[start : start + BLOCK] for start in range(0, max(matrix.shape[0], 1), BLOCK)]


def _times(matrix: sparse.csr_matrix, values: Float) -> Float:
    return np.asarray(matrix @ values)


def _mean(nodes: sparse.csr_matrix, weight: Float, wanted: Float) -> Float:
    """Mean (k, 3) of what the faces at some nodes want (3, 3, m), by axis, their weights being (3, m)."""
    shared = 1.0 / np.maximum(nodes @ weight.ravel(), TINY)
    return np.stack([(nodes @ axis.ravel()) * shared for axis in wanted], axis=1)


def _products(a: Float, b: Float) -> Float:
    """Products (k,) of vectors (3, k), summed in their order."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _normalised(vectors: Float) -> Float:
    """Give vectors (3, k) unit length in place, and return their lengths (k,); no length, no direction."""
    length: Float = np.sqrt(_products(vectors, vectors))
    vectors *= np.divide(1.0, length, out=np.zeros_like(length), where=length > 0)
    return length


@dataclasses.dataclass(frozen=True, eq=False)
class Shapes:
    """What `settle` keeps to, known before anything has moved.

    Attributes
    ----------
    matching : ShapeMatching
        The shapes of the source's elements.
    lines : FeatureLines
        Its feature lines and the target's.
    mean : (n, n) sparse
        Means over neighbours in the aligned source, see `averaging`.
    """

    matching: ShapeMatching
    lines: FeatureLines
    mean: sparse.csr_matrix

    @classmethod
    def of(cls, rest: Surface, reference: Reference, target: Surface, progress: Progress = silent) -> Shapes:
        """Take the source as it was, the same where displacements start from, and the target."""
        matching = ShapeMatching(rest)
        progress(0.3, "shapes of elements")
        lines = FeatureLines.between(rest, target)
        progress(0.6, "shapes of elements")
        reference.surface.facing, reference.slimness  # noqa: B018  worked out once, and kept
        return cls(matching, lines, averaging(reference.surface))


def settle(
    shapes: Shapes,
    reference: Reference,
    displacement: Float,
    target: SurfaceIndex,
    free: Float | None,
    settings: MorphSettings,
    progress: Progress,
    watch: Preview = unseen,
) -> tuple[Float, Int, Float]:
    """Lay the dense mesh onto the target with well-shaped elements.

    Parameters
    ----------
    shapes : Shapes
        Of the same reference and target.
    reference : Reference
        The source as the displacement starts from.
    displacement : (n, 3) float64
        What the iterations have found.
    free : (n,) float64 or None
        1 for the nodes that may move, 0 for those that stay as `displacement` has them.
    watch : Preview
        Given the displacement after each round.

    Returns
    -------
    displacement : (n, 3) float64
    left : (k,) int32
        Faces that are still folded over or cross others, though they did not in the reference.
    landed : (n, 3) float64
        Where on the target each node was laid last; NaN for those that were not.
    """
    share = 1.0 if free is None else free[:, None]
    aligned, mean = reference.surface, shapes.mean
    displacement = unfolded(reference, displacement, mean, folded, free)[0]
    rounds = settings.relaxation + (settings.projection > 0)
    landed, found = np.full_like(displacement, np.nan), None
    for number in range(rounds):
        under_way = repeating(progress, number / max(rounds + 1, 1), f"relaxation {number + 1} of {rounds}")
        begun = positions = aligned.vertices + displacement
        for _ in range(SHAPE_ROUNDS if number < settings.relaxation else 0):
            under_way(0.0, "")
            positions = positions + share * SHAPE_STEP * shapes.matching.move(positions)
        if settings.projection > 0:
            moved = aligned.moved(positions)
            # the rounds between follow the tangent planes of the first; the last is exact again
            if fresh := found is None or number == rounds - 1:
                found = target.closest(positions, under_way)
            step, landed = _to_target(moved, target.surface, found, fresh, shapes.lines, settings)
            positions = positions + share * settings.projection * step
        displacement = displacement + guarded(aligned, displacement, positions - begun, mean)
        watch(displacement)
    under_way = repeating(progress, rounds / (rounds + 1), "checking for folded faces")
    judge = partial(bad_faces, progress=under_way)
    displacement, left = unfolded(reference, displacement, mean, judge, free)
    return displacement, left, landed


def guarded(reference: Surface, displacement: Float, step: Float, mean: sparse.csr_matrix) -> Float:
    """Shorten a step (n, 3) at the nodes where it would turn faces over or pleat edges, down to none of it.

    A face is measured against its own direction under the smoothed displacement, which takes each
    neighbourhood along as one; an edge that is blunt in the reference, by the angle of its two faces.
    What begins without folds stays without.
    """
    smooth, rows = displacement, _cut(mean)
    for _ in range(SMOOTH):
        smooth = np.concatenate(together([partial(_times, some, smooth) for some in rows]))
    taken_along = reference.moved(reference.vertices + smooth)
    upright, flat = taken_along.face_normals, PRESSED * 2.0 * taken_along.face_areas
    start, corners, beside = reference.vertices + displacement, reference.faces, reference.edge_faces[0]

    def directions(faces: Int, share: Float) -> Float:
        """Normals (k, 3); shorter where a face is pressed onto a line, and points nowhere by its rounding."""
        there = start + share * step

        def of(block: slice) -> Float:
            some = faces[block]
            a, b, c = (there.take(corner, axis=0) for corner in corners[some].T)
            normal = triples.cross(b - a, c - a)
            size = (triples.length(normal) + flat[some])[:, None]
            return np.divide(normal, size, out=np.zeros_like(normal), where=size > 0)

        return blockwise(of, len(faces))

    def facing(faces: Int, share: Float) -> Float:
        return triples.dot(upright[faces], directions(faces, share))

    def bent(pairs: Int, share: Float) -> Float:
        return triples.dot(*(directions(side, share) for side in pairs.T))

    def blunt(some: NDArray[np.bool_]) -> Int:
        """Pairs (k, 2) of faces at blunt edges, one being among some (m,)."""
        pairs = beside[some[beside[:, 0]] | some[beside[:, 1]]]
        one, two = (reference.face_normals[side] for side in pairs.T)
        return pairs[triples.dot(one, two) > BLUNT]

    share, nothing = np.ones((len(step), 1)), np.zeros((len(step), 1))
    faces: Int = np.arange(len(corners), dtype=np.int32)
    normal = directions(faces, share)
    pleated = np.zeros(len(corners), dtype=bool)

    def along(block: slice) -> Float:
        """Cosines of the two faces at some edges."""
        return triples.dot(*(normal.take(side, axis=0) for side in beside[block].T))

    pleated[beside[blockwise(along, len(beside)) < BEND]] = True
    faces, pairs = faces[triples.dot(upright, normal) < TURN], blunt(pleated)
    for factor in (0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0):
        over = facing(faces, share) < np.minimum(TURN, facing(faces, nothing))
        sharp = bent(pairs, share) < np.minimum(BEND, bent(pairs, nothing))
        turned = np.union1d(faces[over], pairs[sharp].ravel())
        turned = turned[(share[corners[turned], 0] > 0).any(axis=1)]
        if not len(turned):
            break
        share[corners[turned].ravel()] *= factor
        # only where a node's step was shortened has anything changed
        changed = triples.some((share[:, 0] < 1.0).take(corners))
        faces, pairs = np.flatnonzero(changed).astype(np.int32), blunt(changed)
    return share * step


def _to_target(
    moved: Surface, target: Surface, found: Closest, fresh: bool, lines: FeatureLines, settings: MorphSettings
) -> tuple[Float, Float]:
    """Move (n, 3) to the closest compatible points; other nodes go along with their neighbours.

    Where `found` is not `fresh` the nodes have moved along the surface since, and go to the tangent
    planes at the points found. Also returns the points (n, 3) of the target that nodes go to, NaN for the
    others.
    """
    normals = interpolated_normals(target, found.face, found.barycentric)
    kept = np.einsum("ij,ij->i", moved.vertex_normals, normals) > FACING
    if settings.partial != "none":
        kept &= ~at_border(target, found.face, found.barycentric)
    if settings.partial == "target":  # what lies farther off has its counterpart beyond the target's end
        kept &= found.distance < 2.0 * max(moved.mean_edge, target.mean_edge)
    away = found.point - moved.vertices
    if not fresh:
        normals = triples.unit(normals)
        away = np.einsum("ij,ij->i", away, normals)[:, None] * normals
    step = np.where(kept[:, None], away, 0.0)
    if settings.partial != "target" and kept.any() and not kept.all():
        field = DisplacementField(moved.vertices[kept], step[kept], NEAR * moved.mean_edge)
        step[~kept] = field(moved.vertices[~kept])
    nodes, points = lines.onto(moved)
    step[nodes] = points - moved.vertices[nodes]
    landed = np.where(kept[:, None] & fresh, found.point, np.nan)
    landed[nodes] = points
    return step, landed
