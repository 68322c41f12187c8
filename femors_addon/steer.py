# SPDX-License-Identifier: GPL-3.0-or-later
"""Paired landmarks that steer a morph: pairs that do not fit the others, and the pull on the rest.

The pull adds to the displacement, after each iteration, a Gaussian interpolant of what is left between the
landmarks. Like the field's spread, its width falls from iteration to iteration: first whole regions go
along, at last the surroundings. The surfaces lead across, the landmarks along.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from .align import Alignment, align
from .mesh import Float, Surface
from .nearest import SurfaceIndex
from .progress import FemorsError, Progress, part, silent
from .transforms import landmark_transform, transformed

WIDTH = 2.0  # spreads of the iteration: how far from a landmark its pull has fallen to 1 / e
LEAST = 0.06  # of the size: the same at least, or a pull would fold the surface
ON_SURFACE = 0.02  # of the size: a landmark so near is pulled along the surface, its height is left alone
WRONG = 0.05  # of the size: error of a pair beside the others from which on it may be a wrong one
WRONG_ALIGNED = 0.03  # the same after the alignment by the surfaces
BETTER = 0.4  # of the misfit that is left where a wrong pair is left out
TRIPLES = 500  # that are tried, at most twice as many
TIMES = 4.0  # residuals of the better half that a wrong pair's is above
OFF = 0.03  # of the size: a landmark farther from its own surface is spoken of
WORSE = 1.5  # times the misfit without landmarks, from which on they have misled the alignment,
LEAST_MISFIT = 0.001  # with a misfit of so much of the size more
NEAR = 0.1  # of the size: pairs that are closer after an alignment speak for it; others do not pull
NEAR_UNALIGNED = 0.25  # the same where nothing is aligned
MOST = 6  # names in a sentence
SAMPLE = 1500  # vertices by which the fits of alignments are compared,
KEPT = 0.8  # the farthest fifth left out


@dataclasses.dataclass(frozen=True, eq=False)
class Pairs:
    """Paired landmarks: source and target (k, 3), their names, and which of them are believed."""

    source: Float
    target: Float
    names: tuple[str, ...]
    good: np.ndarray  # (k,) bool
    left: Float | None = None  # (k,) between them after the alignment
    notes: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()

    @classmethod
    def of(cls, source: Float, target: Float, names: Sequence[str] | None, size: float) -> Pairs:
        """Check the pairs; one that does not fit the others under a similarity is not believed.

        Raises
        ------
        FemorsError
            Not as many on both sides, not finite, or fewer than three.
        """
        if len(source) != len(target):
            raise FemorsError(f"landmarks must be paired: source has {len(source)}, target has {len(target)}")
        if names is not None and len(names) != len(source):
            raise FemorsError(f"{len(names)} names are given for {len(source)} landmarks")
        listed = tuple(names) if names is not None else tuple(str(n) for n in range(1, len(source) + 1))
        if len(source) < 3:
            raise FemorsError(f"alignment needs at least 3 paired landmarks, not {len(source)}")
        if not (np.isfinite(source).all() and np.isfinite(target).all()):
            raise FemorsError("landmarks have coordinates that are not finite")
        return cls(source, target, listed, _agreeing(source, target, size))

    def seen_on(self, source: Surface, target: Surface) -> Pairs:
        """Look at how far each landmark is from the surface that it should be on."""
        notes, faults = list(self.notes), list(self.faults)
        for word, points, surface in (("source", self.source, source), ("target", self.target, target)):
            away = SurfaceIndex(surface).closest(points).distance
            rows = np.flatnonzero(away > OFF * surface.diagonal)
            if not len(rows):
                continue
            noun = "landmark is" if len(rows) == 1 else "landmarks are"
            words = (
                f"{len(rows)} {word} {noun} far off the {word}'s surface: {_listed(self.names, away, rows)}"
            )
            if 2 * len(rows) > len(away):
                faults.append(f"{words}; are they in another frame, other axes (LPS, RAS) or another unit?")
            else:
                notes.append(words)
        return dataclasses.replace(self, notes=tuple(notes), faults=tuple(faults))

    def after(self, matrix: Float, size: float, near: float = np.inf) -> Pairs:
        """Judge all pairs by what is left after an alignment: none may be far worse than the better half.

        Parameters
        ----------
        near : float
            Share of the size; what is farther apart is wrong whatever the others are.
        """
        residual = self.residual(matrix)
        half = float(np.sort(residual)[(len(residual) - 1) // 2])
        good = residual <= min(max(WRONG_ALIGNED * size, TIMES * half), near * size)
        if not np.isfinite(near) and good.sum() < 3:
            good = self.good
        return dataclasses.replace(self, good=good, left=residual)

    def residual(self, matrix: Float) -> Float:
        """Return (k,) distances between the landmarks of each pair, the source's moved by a matrix."""
        return np.asarray(np.linalg.norm(transformed(matrix, self.source) - self.target, axis=1))

    def warnings(self) -> list[str]:
        """Return what is to be said of the pairs: of landmarks off their surface, of pairs left out."""
        out = [*self.faults, *self.notes]
        rows = np.flatnonzero(~self.good)
        if len(rows):
            does, was = ("does", "was") if len(rows) == 1 else ("do", "were")
            known = np.full(len(self.good), np.nan) if self.left is None else self.left
            noun = "pair" if len(rows) == 1 else "pairs"
            beside = "the others" if self.good.any() else "the surfaces"
            out.append(
                f"landmark {noun} {_listed(self.names, known, rows)} {does} not fit {beside} "
                f"({'a wrong pair' if len(rows) == 1 else 'wrong pairs'}?) and {was} left out"
            )
        return out


def _listed(names: Sequence[str], lengths: Float, rows: np.ndarray) -> str:
    """Names with their lengths, the largest first."""
    rows = rows[np.argsort(-lengths[rows], kind="stable")]
    words = [f"'{names[r]}'" + (f" ({lengths[r]:.3g})" if np.isfinite(lengths[r]) else "") for r in rows]
    return ", ".join(words[:MOST]) + (", ..." if len(words) > MOST else "")


def lead(
    source: Surface,
    target: Surface,
    kind: str,
    pairs: Pairs,
    *,
    partial: str = "none",
    fix_units: bool = False,
    fix_mirror: bool = False,
    samples: tuple[Surface, Surface] | None = None,
    progress: Progress = silent,
) -> tuple[Alignment, Pairs]:
    """Align by pairs of landmarks, unless the surfaces alone tell that the pairs mislead.

    Both alignments are made. The landmarks' is taken where it fits the surfaces about as well and most
    pairs are close under it; else that of the surfaces, and by it the pairs are judged.

    Returns
    -------
    Alignment, Pairs
        The pairs with those left out that do not fit it.
    """

    def aligned(landmarks: tuple[Float, Float] | None, step: Progress) -> Alignment:
        return align(
            source,
            target,
            kind,
            partial=partial,
            fix_units=fix_units,
            fix_mirror=fix_mirror,
            landmarks=landmarks,
            samples=samples,
            progress=step,
        )

    size, pairs = target.diagonal, pairs.seen_on(source, target)
    if kind == "none":
        plain = aligned(None, progress)
        return plain, pairs.after(plain.matrix, size, NEAR_UNALIGNED)
    led = aligned((pairs.source[pairs.good], pairs.target[pairs.good]), part(progress, 0.0, 0.4))
    free = aligned(None, part(progress, 0.4, 1.0))
    fits = [_fit(one.matrix, source, target, partial) for one in (led, free)]
    near = [int((pairs.residual(one.matrix) < NEAR * size).sum()) for one in (led, free)]
    misled = fits[0] > WORSE * fits[1] + LEAST_MISFIT * size
    free_misfits = fits[1] > WORSE * fits[0] + LEAST_MISFIT * size
    if not misled and (free_misfits or (near[0] >= near[1] and 2 * near[0] > len(pairs.good))):
        return led, pairs.after(led.matrix, size)
    if misled:
        words = (
            f"the landmarks would align the source worse than the surfaces do (RMS {fits[0]:.3g}, not "
            f"{fits[1]:.3g}): the alignment goes by the surfaces alone"
        )
        pairs = dataclasses.replace(pairs, notes=(words, *pairs.notes))
    pairs = pairs.after(free.matrix, size, NEAR)
    if 2 * pairs.good.sum() < len(pairs.good):
        words = "most pairs of landmarks do not fit the surfaces; are they of these meshes, in their frame?"
        pairs = dataclasses.replace(pairs, faults=(*pairs.faults, words))
    return free, pairs


def _fit(matrix: Float, source: Surface, target: Surface, partial: str) -> float:
    """Root mean square distance between two surfaces, trimmed."""
    moved = source.moved(transformed(matrix, source.vertices))
    far = []
    for here, there, whole in ((moved, target, "target"), (target, moved, "source")):
        if partial != whole:
            sample = here.vertices[:: max(len(here.vertices) // SAMPLE, 1)]
            distance = np.sort(SurfaceIndex(there).closest(sample).distance)
            far.append(distance[: max(int(KEPT * len(distance)), 1)])
    return float(np.sqrt(np.mean(np.concatenate(far) ** 2)))


def _agreeing(source: Float, target: Float, size: float) -> np.ndarray:
    """Return (k,) which pairs agree: the most that a similarity of three of them brings together.

    Consensus of samples (Fischler & Bolles 1981), here of all triples or evenly many of them. A few pairs
    are doubted only where most agree, and fit far better without them.
    """
    count = len(source)
    everyone = np.ones(count, dtype=bool)
    triples = list(itertools.combinations(range(count), 3))
    best, most = everyone, (0, 0.0)
    for triple in triples[:: max(len(triples) // TRIPLES, 1)]:
        try:
            matrix = landmark_transform(source[list(triple)], target[list(triple)])
        except FemorsError:  # on one line
            continue
        miss = np.linalg.norm(transformed(matrix, source) - target, axis=1)
        near = miss < WRONG * size
        if (int(near.sum()), -float(miss[near].sum())) > most:
            best, most = near, (int(near.sum()), -float(miss[near].sum()))
    if best.sum() < max(4, count // 2 + 1) or best.all():
        return everyone
    matrix = landmark_transform(source[best], target[best])
    good = np.linalg.norm(transformed(matrix, source) - target, axis=1) < WRONG * size
    if good.all() or good.sum() < 4:
        return everyone
    return good if _misfit(source[good], target[good]) < BETTER * _misfit(source, target) else everyone


def _misfit(source: Float, target: Float) -> float:
    """Root mean square error of the best similarity, by its degrees of freedom."""
    matrix = landmark_transform(source, target)
    square = float(np.sum((transformed(matrix, source) - target) ** 2))
    return (square / max(3 * len(source) - 7, 1)) ** 0.5


@dataclasses.dataclass(frozen=True, eq=False)
class Steering:
    """What became of the pairs of landmarks.

    Attributes
    ----------
    names : tuple of str
    aligned, residual : (k,) float64
        Distance between the landmarks of each pair after the alignment, and after the morph.
    good : (k,) bool
        False for a pair that was left out.
    pulled : bool
        Whether the landmarks pulled, and did not only align.
    faults : tuple of str
        What says that the landmarks are not those of these meshes.
    """

    names: tuple[str, ...]
    aligned: Float
    residual: Float
    good: np.ndarray
    pulled: bool
    faults: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, object]:
        """Return everything, for JSON."""
        return {
            "names": list(self.names),
            "aligned": self.aligned.tolist(),
            "residual": self.residual.tolist(),
            "left_out": [name for name, good in zip(self.names, self.good, strict=True) if not good],
            "pulled": self.pulled,
        }

    def sentence(self) -> str:
        """Return the residual in words."""
        rows = np.flatnonzero(self.good)
        if not len(rows):
            return "no pair of landmarks was believed"
        left, before = self.residual[rows], self.aligned[rows]
        worst = self.names[rows[np.argmax(left)]]
        noun = "landmark" if len(rows) == 1 else "landmarks"
        how = "pulled" if self.pulled else "aligned by, not pulled"
        return (
            f"{len(rows)} {noun} ({how}): residual {left.mean():.3g} in the mean, {left.max():.3g} at "
            f"most ('{worst}'); after the alignment {before.mean():.3g} and {before.max():.3g}"
        )


class Pull:
    """The pull of landmarks on one mesh.

    Parameters
    ----------
    rest : Surface
        The aligned source, of this level.
    source, target : (k, 3)
        Landmarks, after the alignment.
    index : SurfaceIndex
        The target's surface.
    size : float
        Of the target.
    weight : float
        Share of what is left that each pull takes, from 0 to 1.
    """

    def __init__(
        self, rest: Surface, source: Float, target: Float, index: SurfaceIndex, size: float, weight: float
    ) -> None:
        found, aim = SurfaceIndex(rest).closest(source), index.closest(target)
        self._corners, self._bary = rest.faces[found.face], found.barycentric
        on = (found.distance < ON_SURFACE * size) & (aim.distance < ON_SURFACE * size)
        self._from = np.where(on[:, None], found.point, source)
        self._to = np.where(on[:, None], aim.point, target)
        self._weight, self._rest, self._size = weight, rest, size

    def left(self, displacement: Float) -> Float:
        """Return (k, 3) what is left between the landmarks under a displacement (n, 3)."""
        moved = np.einsum("kc,kcx->kx", self._bary, displacement[self._corners])
        return self._to - self._from - moved

    def __call__(self, displacement: Float, spread: float) -> Float:
        """Return the displacement (n, 3) with the pull added; `spread` is that of the iteration."""
        width = max(WIDTH * spread, LEAST * self._size)
        # least squares: two landmarks at one place get their mean
        inverse = np.linalg.pinv(_kernel(self._from, self._from, width), rcond=1e-3, hermitian=True)
        pull = _kernel(self._rest.vertices, self._from, width) @ (inverse @ self.left(displacement))
        return displacement + self._weight * pull


def _kernel(points: Float, centres: Float, width: float) -> Float:
    square = np.sum((points[:, None, :] - centres[None, :, :]) ** 2, axis=2)
    return np.exp(-square / width**2)
