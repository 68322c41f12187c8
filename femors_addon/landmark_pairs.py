# SPDX-License-Identifier: GPL-3.0-or-later
"""Paired landmarks, and which pairs are believed: by each other, by the surfaces, by an alignment."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from .mesh import Float, Surface
from .nearest import SurfaceIndex
from .progress import FemorsError, counted, listed
from .transforms import landmark_transform, transformed

WRONG = 0.05  # of the size: error of a pair beside the others from which on it may be a wrong one
WRONG_ALIGNED = 0.03  # the same after the alignment by the surfaces
BETTER = 0.4  # of the misfit that is left where a wrong pair is left out
TRIPLES = 500  # that are tried, at most twice as many
TIMES = 4.0  # residuals of the better half that a wrong pair's is above
OFF = 0.03  # of the size: a landmark farther from its own surface is spoken of


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
            raise FemorsError(
                f"{counted(len(names), 'name is', 'names are')} given for {counted(len(source), 'landmark')}"
            )
        called = tuple(names) if names is not None else tuple(str(n) for n in range(1, len(source) + 1))
        if len(source) < 3:
            raise FemorsError(f"alignment needs at least 3 paired landmarks, not {len(source)}")
        if not (np.isfinite(source).all() and np.isfinite(target).all()):
            raise FemorsError("landmarks have coordinates that are not finite")
        return cls(source, target, called, _agreeing(source, target, size))

    def seen_on(self, source: Surface, target: Surface) -> Pairs:
        """Look at how far each landmark is from the surface that it should be on."""
        notes, faults = list(self.notes), list(self.faults)
        for word, points, surface in (("source", self.source, source), ("target", self.target, target)):
            away = SurfaceIndex(surface).closest(points).distance
            rows = np.flatnonzero(away > OFF * surface.diagonal)
            if not len(rows):
                continue
            noun = "landmark is" if len(rows) == 1 else "landmarks are"
            those = _with_lengths(self.names, away, rows)
            words = f"{len(rows)} {word} {noun} far off the {word}'s surface: {those}"
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
                f"landmark {noun} {_with_lengths(self.names, known, rows)} {does} not fit {beside} "
                f"({'a wrong pair' if len(rows) == 1 else 'wrong pairs'}?) and {was} left out"
            )
        return out


def _with_lengths(names: Sequence[str], lengths: Float, rows: np.ndarray) -> str:
    """Names with their lengths, the largest first."""
    rows = rows[np.argsort(-lengths[rows], kind="stable")]
    return listed(
        f"'{names[row]}'" + (f" ({lengths[row]:.3g})" if np.isfinite(lengths[row]) else "") for row in rows
    )


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
