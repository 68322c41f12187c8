# SPDX-License-Identifier: GPL-3.0-or-later
"""Alignment: by paired landmarks, or by rigid, similarity and affine ICP from any starting pose.

ICP minimises the distance to the tangent plane at the nearest node (Chen & Medioni 1991), with a
small share of the point-to-point distance that keeps what the planes leave free, over pairs found in
both directions; from the partial mesh only, and trimmed, where one covers a part of the other.
"""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from .mesh import Float, Surface
from .progress import FemorsError, Progress, silent
from .reduce import reduced

SAMPLE = 1500  # nodes that ICP works with
SCOUTS = 250  # nodes that starts are compared with
REFINED_STARTS = 10  # starts that are tried by ICP after the first look
ROUNDS = ((5, 6), (10, 3))  # steps of ICP for each start, and how many are kept
PLACES = 12  # parts of the whole that a partial mesh is laid on
POINT_SHARE = 0.05  # weight of the point-to-point distance beside the point-to-plane distance
TRIM = 0.8  # share of the pairs kept where one mesh is partial
UNIT_FACTORS = (10.0, 25.4, 100.0, 304.8, 1000.0)
GROWTH = 0.5  # logarithm of the scale that one step of ICP may take
MIRROR_MARGIN = 0.85  # a mirrored fit must be better by this factor to be spoken of


@dataclasses.dataclass(frozen=True, eq=False)
class Alignment:
    """Where the source is laid before it is deformed.

    Attributes
    ----------
    matrix : (4, 4) float64
        Source coordinates to aligned coordinates, for column vectors.
    residual : float
        Root mean square distance between the aligned samples, in the target's unit.
    warnings : tuple of str
        A unit mismatch, a mirrored pair.
    """

    matrix: Float
    residual: float
    warnings: tuple[str, ...] = ()


def transformed(matrix: Float, points: ArrayLike) -> Float:
    """Apply a (4, 4) matrix to points (p, 3)."""
    return np.asarray(points) @ matrix[:3, :3].T + matrix[:3, 3]


def homogeneous(linear: Float, translation: Float) -> Float:
    """Return the (4, 4) matrix of x -> linear x + translation."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = linear, translation
    return out


def inverse(matrix: Float) -> Float:
    """Return the inverse of an affine (4, 4) matrix, by cofactors.

    Closed form, for LAPACK's threads cost more than the work on a busy machine.
    """
    (a, b, c), (d, e, f), (g, h, i) = matrix[:3, :3].tolist()
    cofactors = [
        [e * i - f * h, c * h - b * i, b * f - c * e],
        [f * g - d * i, a * i - c * g, c * d - a * f],
        [d * h - e * g, b * g - a * h, a * e - b * d],
    ]
    linear = np.array(cofactors) / (a * cofactors[0][0] + b * cofactors[1][0] + c * cofactors[2][0])
    return homogeneous(linear, -linear @ matrix[:3, 3])


# --- landmarks ------------------------------------------------------------------------------------
def landmark_transform(source: ArrayLike, target: ArrayLike, kind: str = "similarity") -> Float:
    """Least-squares transform between paired landmarks (k, 3), k >= 3.

    Umeyama (1991) for ``rigid`` and ``similarity``; ``affine`` falls back to ``similarity`` where
    there are fewer than five landmarks or all lie in a plane.

    Raises
    ------
    FemorsError
        Unequal counts, fewer than three, or all on one line.
    """
    a, b = np.asarray(source, dtype=float).reshape(-1, 3), np.asarray(target, dtype=float).reshape(-1, 3)
    if len(a) != len(b):
        raise FemorsError(f"landmarks must be paired: source has {len(a)}, target has {len(b)}")
    if len(a) < 3:
        raise FemorsError(f"alignment needs at least 3 paired landmarks, not {len(a)}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise FemorsError("landmarks have coordinates that are not finite")
    ca, cb = a.mean(axis=0), b.mean(axis=0)
    spread, other = (np.linalg.svd(points, compute_uv=False) for points in (a - ca, b - cb))
    for name, widths in (("source", spread), ("target", other)):
        if widths[1] < 1e-6 * max(widths[0], np.finfo(float).tiny):
            raise FemorsError(f"the {name}'s landmarks lie on one line; choose at least one beside it")
    if kind == "affine" and len(a) >= 5 and spread[2] > 0.02 * spread[0]:
        linear = np.linalg.lstsq(a - ca, b - cb, rcond=None)[0].T
        return homogeneous(linear, cb - linear @ ca)
    u, s, vt = np.linalg.svd((b - cb).T @ (a - ca))
    sign = np.array([1.0, 1.0, math.copysign(1.0, np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * sign) @ vt
    scale = 1.0 if kind == "rigid" else float((s * sign).sum() / ((a - ca) ** 2).sum())
    return homogeneous(scale * rotation, cb - scale * rotation @ ca)


# --- ICP ------------------------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True, eq=False)
class _Side:
    """Nodes and normals of a mesh with a tree to be searched in, and fewer of them to search with."""

    nodes: Float
    normals: Float
    tree: cKDTree
    sample: Float
    sample_normals: Float

    @classmethod
    def of(cls, surface: Surface, sample: Surface | None) -> _Side:
        if sample is None:
            sample = reduced(surface, SAMPLE)
        return cls(
            surface.vertices,
            surface.vertex_normals,
            cKDTree(surface.vertices),
            sample.vertices,
            sample.vertex_normals,
        )

    def thinned(self, count: int) -> _Side:
        """The sample as the whole, and every k-th node of it as the sample."""
        chosen = slice(None, None, max(len(self.sample) // count, 1))
        return _Side(
            self.sample,
            self.sample_normals,
            cKDTree(self.sample),
            self.sample[chosen],
            self.sample_normals[chosen],
        )


@dataclasses.dataclass(frozen=True, eq=False)
class _Pairs:
    """Matched points: x of the moved source, y of the target, n the target's normal at y."""

    x: Float
    y: Float
    n: Float
    misfit: float  # root mean square distance, unmatched ones included


def _pairs(matrix: Float, source: _Side, target: _Side, partial: str) -> _Pairs:
    to_source = inverse(matrix)
    x, y, n, far = [], [], [], []
    turned = to_source[:3, :3]  # normals go by the inverse transpose; outward stays outward under a mirror
    if partial != "target":
        moved = transformed(matrix, source.sample)
        distance, hit = target.tree.query(moved)
        facing = np.einsum("ij,ij->i", source.sample_normals @ turned, target.normals[hit]) > 0
        chosen = _trimmed(distance, facing, partial)
        x.append(moved[chosen])
        y.append(target.nodes[hit[chosen]])
        n.append(target.normals[hit[chosen]])
        far.append(_penalised(distance, facing, partial))
    if partial != "source":
        back = transformed(to_source, target.sample)
        _, hit = source.tree.query(back)
        moved = transformed(matrix, source.nodes[hit])
        distance = np.linalg.norm(moved - target.sample, axis=1)
        facing = np.einsum("ij,ij->i", source.normals[hit] @ turned, target.sample_normals) > 0
        chosen = _trimmed(distance, facing, partial)
        x.append(moved[chosen])
        y.append(target.sample[chosen])
        n.append(target.sample_normals[chosen])
        far.append(_penalised(distance, facing, partial))
    misfit = math.sqrt(float(np.mean(np.concatenate(far))))
    return _Pairs(np.concatenate(x), np.concatenate(y), np.concatenate(n), misfit)


def _looks(starts: Float, source: _Side, target: _Side) -> Float:
    """Misfit (s,) of many transforms (s, 4, 4) at once, from every second sample: see `_pairs`."""
    square = []
    back = np.array([inverse(start) for start in starts])
    for matrices, one, two in ((starts, source, target), (back, target, source)):
        linear, shift = matrices[:, :3, :3], matrices[:, None, :3, 3]
        moved = one.sample[::2] @ linear.transpose(0, 2, 1) + shift
        distance, hit = two.tree.query(moved)
        # normals go by the inverse transpose: to have them the other way round is the same sign
        turned = two.normals[hit] @ linear
        facing = np.einsum("spi,pi->sp", turned, one.sample_normals[::2]) > 0
        scale = 1.0 if one is source else np.cbrt(np.abs(np.linalg.det(starts[:, :3, :3])))[:, None]
        square.append((scale * distance) ** 2 * np.where(facing, 1.0, 4.0))
    misfit: Float = np.sqrt(np.concatenate(square, axis=1).mean(axis=1))
    return misfit


def _trimmed(distance: Float, facing: np.ndarray, partial: str) -> np.ndarray:
    if partial == "none" or not facing.any():
        return np.flatnonzero(facing)
    return np.flatnonzero(facing & (distance <= np.quantile(distance[facing], TRIM)))


def _penalised(distance: Float, facing: np.ndarray, partial: str) -> Float:
    """Squared distances for the comparison of poses: a pair that faces away counts double."""
    square = distance**2 * np.where(facing, 1.0, 4.0)
    if partial == "none":
        return square
    return np.sort(square)[: max(int(TRIM * len(square)), 1)]


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


def _step(pairs: _Pairs, kind: str) -> Float:
    """Small transform (4, 4) that lessens the pairs' distances, by linear least squares."""
    basis = _BASES[kind]
    centre = pairs.x.mean(axis=0)
    scale = max(float(np.abs(pairs.x - centre).max()), 1e-300)
    local = (pairs.x - centre) / scale
    moves = np.einsum("kab,pb->pka", basis, local)
    moves = np.concatenate((moves, np.broadcast_to(np.eye(3), (len(local), 3, 3))), axis=1)
    gap = (pairs.y - pairs.x) / scale
    along = np.einsum("pka,pa->pk", moves, pairs.n)
    flat = moves.transpose(0, 2, 1).reshape(-1, moves.shape[1])
    system = along.T @ along + POINT_SHARE * (flat.T @ flat)
    right = along.T @ np.einsum("pa,pa->p", gap, pairs.n) + POINT_SHARE * (flat.T @ gap.ravel())
    system[np.diag_indices_from(system)] += 1e-12 * np.trace(system)
    theta = np.linalg.solve(system, right)
    linear = np.einsum("k,kab->ab", theta[:-3], basis)
    if kind == "affine":
        linear = np.eye(3) + linear
    else:
        growth = 1.0 if kind == "rigid" else math.exp(min(max(theta[3], -GROWTH), GROWTH))
        linear = growth * Rotation.from_rotvec(theta[:3]).as_matrix()
    return homogeneous(linear, centre + scale * theta[-3:] - linear @ centre)


def icp(
    matrix: Float, source: _Side, target: _Side, kind: str, partial: str, iterations: int, tolerance: float
) -> tuple[Float, float]:
    """Iterate from `matrix`; return the best transform met and its misfit.

    Ends when no sample moves by more than `tolerance` (in the target's unit).
    """
    best, lowest = matrix, math.inf
    for _ in range(iterations):
        pairs = _pairs(matrix, source, target, partial)
        if pairs.misfit < lowest:
            best, lowest = matrix, pairs.misfit
        if len(pairs.x) < 12:
            break
        step = _step(pairs, kind)
        change = np.abs(transformed(step, pairs.x) - pairs.x).max()
        after = step @ matrix
        if (
            not np.isfinite(after).all() or np.linalg.det(step[:3, :3]) < 1e-6
        ):  # collapses or turns inside out
            break
        matrix = after
        if change < tolerance:
            break
    pairs = _pairs(matrix, source, target, partial)
    return (matrix, pairs.misfit) if pairs.misfit <= lowest * 1.001 else (best, lowest)


# --- starts ---------------------------------------------------------------------------------------
def _frame(nodes: Float) -> tuple[Float, Float, float]:
    """Centroid, right-handed principal axes (columns, largest first) and RMS radius."""
    centre = nodes.mean(axis=0)
    _, _, axes = np.linalg.svd(nodes - centre, full_matrices=False)
    axes = axes.T * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])
    return centre, axes, float(np.sqrt(((nodes - centre) ** 2).sum(axis=1).mean()))


def canonical_frame(nodes: Float) -> Float:
    """Rigid transform (4, 4) into the principal frame, axes pointing to the longer tails."""
    centre, axes, _ = _frame(nodes)
    tails = (((nodes - centre) @ axes) ** 3).sum(axis=0)
    signs = np.where(tails[:2] < 0, -1.0, 1.0)
    axes = axes * np.append(signs, signs.prod())
    return homogeneous(axes.T, -axes.T @ centre)


def _turns() -> list[Float]:
    """Rotations to try in the principal frame: the four flips, the cube's others, and half steps."""
    cube = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[range(3), order] = signs
            if np.linalg.det(turn) > 0:
                cube.append(turn)
    cube.sort(key=lambda turn: -np.abs(np.trace(np.abs(turn))))
    eighth = [Rotation.from_rotvec(math.pi / 4 * axis).as_matrix() for axis in np.eye(3)]
    return cube + [half @ turn for half in eighth for turn in cube]


def _starts(
    source: _Side, target: _Side, own: Float, scaled: bool, partial: str, mirror: Float
) -> tuple[list[Float], int]:
    """Candidate transforms, and how many places they lay the source on.

    The user's own pose first, then principal axes onto each other, turn by turn and each turn at all
    places: the whole mesh's own, or parts of it about as large as the partial mesh.
    """
    mirrored = transformed(mirror, source.sample)
    ours, theirs = _frame(mirrored), _frame(target.sample)
    scale = theirs[2] / ours[2] if scaled and partial == "none" else 1.0
    places = [(ours, theirs)]
    if partial == "source":
        places += [(ours, part) for part in _parts_like(target.sample, ours[2])]
    if partial == "target":
        places += [(part, theirs) for part in _parts_like(mirrored, theirs[2])]
    out = [own @ mirror]
    for turn in _turns() if partial == "none" else _turns()[:24]:
        for (here, axes, _), (there, target_axes, _) in places:
            rotation = scale * target_axes @ turn @ axes.T
            out.append(homogeneous(rotation, there - rotation @ here) @ mirror)
    return out, len(places)


def _parts_like(nodes: Float, size: float) -> list[tuple[Float, Float, float]]:
    """Frames of parts of the nodes, around nodes that lie far apart, whose RMS radius is `size`."""
    out = []
    chosen = int(np.argmax(((nodes - nodes.mean(axis=0)) ** 2).sum(axis=1)))
    distance = np.full(len(nodes), np.inf)
    for _ in range(PLACES):
        square = ((nodes - nodes[chosen]) ** 2).sum(axis=1)
        nearest = nodes[np.argsort(square, kind="stable")] - nodes[chosen]
        count = np.arange(1, len(nodes) + 1)
        mean = np.cumsum(nearest, axis=0) / count[:, None]
        spread = np.cumsum((nearest**2).sum(axis=1)) / count - (mean**2).sum(axis=1)
        enough = int(np.searchsorted(np.maximum.accumulate(spread), size**2))
        out.append(_frame(nearest[: max(enough, 12)] + nodes[chosen]))
        distance = np.minimum(distance, square)
        chosen = int(np.argmax(distance))
    return out


def _best_start(
    source: _Side, target: _Side, own: Float, kind: str, partial: str, mirror: Float, tolerance: float
) -> tuple[Float, float]:
    """Compare the starts by one look, the best of them by ICP; return (transform, misfit)."""
    starts, places = _starts(source, target, own, kind != "rigid", partial, mirror)
    scouts, aims = source.thinned(SCOUTS), target.thinned(SCOUTS)
    if partial == "none":
        first = _looks(np.array(starts), scouts, aims)
    else:
        first = np.array([_pairs(start, scouts, aims, partial).misfit for start in starts])
    if partial == "none":  # the user's pose and the four flips always get their chance
        always = list(range(min(5, len(starts))))
    else:  # and the best turn at each place
        always = [0] + [
            1 + place + places * int(np.argmin(first[1 + place :: places])) for place in range(places)
        ]
    chosen = dict.fromkeys(always + [int(i) for i in np.argsort(first, kind="stable")[:REFINED_STARTS]])
    tried = [(starts[i], 0.0) for i in chosen]
    # a few steps tell the hopeless ones, where both are whole
    for iterations, kept in ROUNDS if partial == "none" else ((25, len(tried)),):
        tried = [icp(start, scouts, aims, "rigid", partial, iterations, tolerance * 10) for start, _ in tried]
        tried = sorted(tried, key=lambda found: found[1])[:kept]
    ranked = sorted(range(len(tried)), key=lambda i: tried[i][1])[:3]
    if partial != "none":  # where parts look alike only the details tell
        final = [icp(tried[i][0], source, target, "rigid", partial, 25, tolerance * 10) for i in ranked]
    else:
        final = [icp(tried[i][0], scouts, aims, kind, partial, 25, tolerance * 10) for i in ranked]
    return min(final, key=lambda found: found[1])


def unit_factor(source: Surface, target: Surface, partial: str = "none") -> float | None:
    """Return the factor that would bring the source to the target's unit, if one seems needed.

    A part may well be a tenth of the whole: where one mesh is partial the sizes must differ more.
    """
    ratio = _frame(target.vertices)[2] / _frame(source.vertices)[2]
    alike = 4.0 if partial == "none" else 60.0
    if 1.0 / alike < ratio < alike:
        return None
    if partial != "none":
        return 1000.0 if ratio > 1.0 else 0.001
    known = [f for factor in UNIT_FACTORS for f in (factor, 1.0 / factor)]
    factor = min(known, key=lambda f: abs(math.log(ratio / f)))
    return factor if abs(math.log(ratio / factor)) < math.log(2.0) else None


def align(
    source: Surface,
    target: Surface,
    kind: str = "affine",
    *,
    partial: str = "none",
    fix_units: bool = False,
    fix_mirror: bool = False,
    landmarks: tuple[Float, Float] | None = None,
    samples: tuple[Surface, Surface] | None = None,
    progress: Progress = silent,
) -> Alignment:
    """Lay the source onto the target.

    Parameters
    ----------
    source, target : Surface
        Cleaned surfaces.
    kind : {"none", "rigid", "similarity", "affine"}
        What the transform may do.
    partial : {"none", "source", "target"}
        Which of the two shows only a part of the other.
    fix_units, fix_mirror : bool
        Apply a unit factor or a mirror image where one is found; otherwise only say so.
    landmarks : ((k, 3), (k, 3)), optional
        Paired landmarks on source and target: the start, instead of trying poses.
    samples : (Surface, Surface), optional
        Reduced versions of the two, to search with, where they are there already.
    """
    warnings: list[str] = []
    start = np.eye(4)
    factor = unit_factor(source, target, partial)
    if factor is not None:
        words = f"the source seems to be in another unit: {factor:g} times its size would fit the target"
        if fix_units:
            warnings.append(words + ", and was applied")
            start = np.diag([factor, factor, factor, 1.0])
        else:  # to scale it all the same would be to convert the unit unasked
            warnings.append(words + "; tick Convert units to apply it (it was not scaled)")
            kind = "none" if kind == "none" else "rigid"
    if kind == "none":
        ours, theirs = _sides(source, target, start, samples)
        return Alignment(start, _pairs(np.eye(4), ours, theirs, partial).misfit, tuple(warnings))
    progress(0.0, "alignment: samples")
    # in its own principal frame the source is reduced alike from whatever pose it comes
    canonical = canonical_frame(transformed(start, source.vertices))
    start = canonical @ start
    ours, theirs = _sides(source, target, start, samples)
    tolerance = 1e-5 * target.diagonal
    if landmarks is not None:
        points = transformed(start, landmarks[0])
        first = landmark_transform(points, landmarks[1], "rigid" if kind == "rigid" else "similarity")
    else:
        own = inverse(canonical)
        first, mirrored = _choose_hand(ours, theirs, own, kind, partial, tolerance, fix_mirror, progress)
        warnings.extend(mirrored)
    progress(0.6, "alignment: rigid")
    matrix, residual = icp(first, ours, theirs, "rigid", partial, 60, tolerance)
    if kind != "rigid":
        progress(0.7, f"alignment: {kind}")
        matrix, residual = icp(matrix, ours, theirs, "similarity", partial, 60, tolerance)
    if kind == "affine":
        matrix, residual = icp(matrix, ours, theirs, "affine", partial, 100, tolerance)
    progress(1.0, "alignment")
    return Alignment(matrix @ start, residual, tuple(warnings))


def _choose_hand(
    ours: _Side,
    theirs: _Side,
    own: Float,
    kind: str,
    partial: str,
    tolerance: float,
    fix: bool,
    progress: Progress,
) -> tuple[Float, list[str]]:
    """Best start of the source as it is, and of its mirror image; which, and what to say of it."""
    progress(0.05, "alignment: starting pose")
    first, misfit = _best_start(ours, theirs, own, kind, partial, np.eye(4), tolerance)
    progress(0.3, "alignment: mirror image")
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    other, other_misfit = _best_start(ours, theirs, own, kind, partial, mirror, tolerance)
    if misfit <= tolerance or other_misfit > MIRROR_MARGIN * misfit:
        return first, []
    better = 100 * (1 - other_misfit / misfit)
    words = f"the source's mirror image fits the target better by {better:.0f} % (left against right?)"
    if fix:
        return other, [words + "; it was mirrored"]
    return first, [words + "; tick Mirror if better to use it"]


def _sides(
    source: Surface, target: Surface, start: Float, samples: tuple[Surface, Surface] | None
) -> tuple[_Side, _Side]:
    """The two as ICP needs them, the source moved by `start`."""
    one, two = samples or (None, None)
    moved = source.moved(transformed(start, source.vertices))
    sample = None if one is None else one.moved(transformed(start, one.vertices))
    return _Side.of(moved, sample), _Side.of(target, two)
