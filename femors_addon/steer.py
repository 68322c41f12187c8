# SPDX-License-Identifier: GPL-3.0-or-later
"""Paired landmarks that steer a morph: the alignment that they lead, the pull, what became of them.

The pull adds to the displacement, after each iteration, a Gaussian interpolant of what is left between the
landmarks. Like the field's spread, its width falls from iteration to iteration: first whole regions go
along, at last the surroundings. The surfaces lead across, the landmarks along.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .align import Alignment, align
from .landmark_pairs import Pairs
from .mesh import Float, Surface
from .nearest import SurfaceIndex
from .progress import Progress, part, silent
from .transforms import transformed

WIDTH = 2.0  # spreads of the iteration: how far from a landmark its pull has fallen to 1 / e
LEAST = 0.06  # of the size: the same at least, or a pull would fold the surface
ON_SURFACE = 0.02  # of the size: a landmark so near is pulled along the surface, its height is left alone
WORSE = 1.5  # times the misfit without landmarks, from which on they have misled the alignment,
LEAST_MISFIT = 0.001  # with a misfit of so much of the size more
NEAR = 0.1  # of the size: pairs that are closer after an alignment speak for it; others do not pull
NEAR_UNALIGNED = 0.25  # the same where nothing is aligned
SAMPLE = 1500  # vertices by which the fits of alignments are compared,
KEPT = 0.8  # the farthest fifth left out


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

    Parameters
    ----------
    source, target, kind, partial, fix_units, fix_mirror, samples, progress
        As for `align.align`.
    pairs : Pairs
        Those believed lead.

    Returns
    -------
    Alignment, Pairs
        The pairs with those left out that do not fit it.
    """
    options: dict[str, Any] = {"partial": partial, "samples": samples}
    options |= {"fix_units": fix_units, "fix_mirror": fix_mirror}
    size, pairs = target.diagonal, pairs.seen_on(source, target)
    if kind == "none":
        plain = align(source, target, kind, progress=progress, **options)
        return plain, _unless_most_are_wrong(pairs.after(plain.matrix, size, NEAR_UNALIGNED))
    believed = pairs.source[pairs.good], pairs.target[pairs.good]
    step = part(progress, 0.0, 0.4)
    led = align(source, target, kind, landmarks=believed, progress=step, **options)
    free = align(source, target, kind, progress=part(progress, 0.4, 1.0), **options)
    led_fit, free_fit = (_fit(one.matrix, source, target, partial) for one in (led, free))
    led_near, free_near = (int((pairs.residual(one.matrix) < NEAR * size).sum()) for one in (led, free))
    misled = led_fit > WORSE * free_fit + LEAST_MISFIT * size
    lost = free_fit > WORSE * led_fit + LEAST_MISFIT * size  # the surfaces alone end in a wrong pose
    if not misled and (lost or (led_near >= free_near and 2 * led_near > len(pairs.good))):
        return led, pairs.after(led.matrix, size)
    if misled:
        words = (
            f"the landmarks would align the source worse than the surfaces do (RMS {led_fit:.3g}, not "
            f"{free_fit:.3g}): the alignment goes by the surfaces alone"
        )
        pairs = dataclasses.replace(pairs, notes=(words, *pairs.notes))
    return free, _unless_most_are_wrong(pairs.after(free.matrix, size, NEAR))


def _unless_most_are_wrong(pairs: Pairs) -> Pairs:
    """Believe none of pairs of which most are wrong: what is left may be near by chance."""
    if 2 * pairs.good.sum() >= len(pairs.good):
        return pairs
    words = "most pairs of landmarks do not fit the surfaces; are they of these meshes, in their frame?"
    return dataclasses.replace(
        pairs, good=np.zeros(len(pairs.good), dtype=bool), faults=(*pairs.faults, words)
    )


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
