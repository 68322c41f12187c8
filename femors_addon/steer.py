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

from .align import landmark_transform, transformed
from .mesh import Float, Surface
from .nearest import SurfaceIndex
from .progress import FemorsError

WIDTH = 2.0  # spreads of the iteration: how far from a landmark its pull has fallen to 1 / e
LEAST = 0.06  # of the size: the same at least, or a pull would fold the surface
ON_SURFACE = 0.02  # of the size: a landmark so near is pulled along the surface, its height is left alone
WRONG = 0.05  # of the size: error of a pair beside the others from which on it may be a wrong one
WRONG_ALIGNED = 0.03  # the same after the alignment by the surfaces
BETTER = 0.4  # of the misfit that is left where a wrong pair is left out
TRIPLES = 500  # that are tried, at most twice as many
TIMES = 4.0  # median residuals of the others that a wrong pair's is above


@dataclasses.dataclass(frozen=True, eq=False)
class Pairs:
    """Paired landmarks: source and target (k, 3), their names, and which of them are believed."""

    source: Float
    target: Float
    names: tuple[str, ...]
    good: np.ndarray  # (k,) bool

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
        return cls(source, target, listed, _agreeing(source, target, size))

    def after(self, matrix: Float, size: float) -> Pairs:
        """Look again, after an alignment by the surfaces: no pair may be far worse than the others."""
        residual = np.linalg.norm(transformed(matrix, self.source) - self.target, axis=1)
        good = self.good.copy()
        for row in np.flatnonzero(good):
            others = np.delete(residual, row)
            if residual[row] > max(WRONG_ALIGNED * size, TIMES * float(np.median(others))):
                good[row] = False
        return dataclasses.replace(self, good=good) if good.sum() >= 3 else self

    def warnings(self) -> list[str]:
        """Return a sentence that names the pairs that are not believed, or nothing."""
        wrong = [f"'{name}'" for name, good in zip(self.names, self.good, strict=True) if not good]
        if not wrong:
            return []
        verb = "does" if len(wrong) == 1 else "do"
        words = f"landmark pair {', '.join(wrong)} {verb} not fit the others (a wrong pair?)"
        return [f"{words} and was left out"]


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
    """

    names: tuple[str, ...]
    aligned: Float
    residual: Float
    good: np.ndarray
    pulled: bool

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
        good, before = self.residual[self.good], self.aligned[self.good]
        how = "pulled" if self.pulled else "aligned by, not pulled"
        return (
            f"{len(good)} landmarks ({how}): residual {good.mean():.3g} in the mean, {good.max():.3g} at "
            f"most (after the alignment {before.mean():.3g} and {before.max():.3g})"
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
