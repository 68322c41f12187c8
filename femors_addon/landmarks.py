# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks predicted on a target: how sure each is, and the median over several templates."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from .carry import Carrier
from .mesh import Float
from .progress import FemorsError, counted, listed

FAR = 0.03  # of the source's size: a landmark farther from its surface is spoken of
UNSEEN = 0.05  # of the same: the target shows nothing of what is farther from it than that after the morph
MOST = 5  # names in a sentence


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction:
    """Landmarks on a target, each with what tells how far to trust it; all lengths in the target's unit.

    Attributes
    ----------
    names : tuple of str
    points : (k, 3) float64
    distance : (k,) float64
        Of the landmark from the source's surface, after the alignment; negative inside.
    residual : (k,) float64
        How far the target's surface is from the morphed one around the landmark, at most.
    stretch : (k,) float64
        Of the surface there, source to target, in the direction in which it is farther from 1.
    projected : (k,) float64
        How far the landmark was moved onto the target's surface; 0 where it was not.
    spread : (k,) float64
        Median distance of the templates' predictions from `points`; NaN with one template.
    templates : (k,) int
        How many have predicted it.
    before : (k, 3) float64 or None
        Where each was on the source; on that of the first template that has it.
    """

    names: tuple[str, ...]
    points: Float
    distance: Float
    residual: Float
    stretch: Float
    projected: Float
    spread: Float
    templates: np.ndarray
    before: Float | None = None

    def columns(self) -> dict[str, list[object]]:
        """Return what is beside the points, by heading, for a table."""
        out: dict[str, list[object]] = {
            name: list(map(float, getattr(self, name)))
            for name in ("distance", "residual", "stretch", "projected", "spread")
        }
        out["templates"] = list(map(int, self.templates))
        return out

    def unseen(self, size: float) -> list[str]:
        """Return faults of landmarks where the target shows nothing of the source: a sentence, or nothing."""
        count, those = _above(UNSEEN * size, self.names, self.residual)
        words = counted(count, "landmark lies", "landmarks lie")
        guess = "is a guess" if count == 1 else "are guesses"
        where = "where the target shows nothing of the source (so far away), and"
        return [f"{words} {where} {guess}: {those}"] if count else []

    def disagreeing(self, size: float) -> list[str]:
        """Return faults of landmarks that templates put in quite different places: a sentence, or nothing."""
        count, those = _above(FAR * size, self.names, self.spread)
        words = counted(count, "landmark is", "landmarks are")
        return [f"{words} put in quite different places by the templates: {those}"] if count else []

    def table(self) -> str:
        """Return the landmarks as lines for a person."""
        width = max([8, *(len(name) for name in self.names)])
        heads = ("x", "y", "z", "distance", "residual", "stretch", "projected", "spread")
        lines = [f"{'landmark':{width}}" + "".join(f"{head:>11}" for head in heads)]
        for row, name in enumerate(self.names):
            values = (*self.points[row], *(getattr(self, head)[row] for head in heads[3:]))
            lines.append(f"{name:{width}}" + "".join(f"{_short(value):>11}" for value in values))
        return "\n".join(lines)


def _short(value: float) -> str:
    return "-" if np.isnan(value) else f"{round(value, 3) + 0.0:.3f}"


def predicted(
    carrier: Carrier, names: Sequence[str], before: Float, after: Float, projected: Float | None = None
) -> Prediction:
    """Return landmarks that were carried from `before` to `after` (k, 3), with their confidence."""
    found = carrier.at(before)
    count = len(before)
    return Prediction(
        tuple(names),
        np.asarray(after, dtype=np.float64),
        carrier.signed(before),
        carrier.residual_at(found),
        carrier.stretch_at(found),
        np.zeros(count) if projected is None else projected,
        np.full(count, np.nan),
        np.ones(count, dtype=int),
        np.asarray(before, dtype=np.float64),
    )


def far_ones(names: Sequence[str], distance: Float, size: float) -> list[str]:
    """Return what to say of landmarks that are far from the source's surface: a sentence, or nothing."""
    count, those = _above(FAR * size, names, np.abs(distance))
    words = counted(count, "landmark is", "landmarks are")
    return [f"{words} off the source's surface and the less certain: {those}"] if count else []


def _above(least: float, names: Sequence[str], lengths: Float) -> tuple[int, str]:
    """Return how many lengths are above one, and the names of these with them, the largest first."""
    rows = np.flatnonzero(lengths > least)
    rows = rows[np.argsort(-lengths[rows], kind="stable")]
    return len(rows), listed((f"'{names[row]}' ({lengths[row]:.3g})" for row in rows), MOST)


def median_of(predictions: Sequence[Prediction]) -> tuple[Prediction, list[str]]:
    """Return the median of several templates' predictions, and what to say of it.

    Landmarks go by name, coordinate by coordinate (as in MALPACA, Zhang et al. 2022); one that some templates
    lack is predicted by the others. The confidences are medians, too.

    Raises
    ------
    FemorsError
        No prediction at all.
    """
    if not predictions:
        raise FemorsError("a template is needed")
    if len(predictions) == 1:
        return predictions[0], []
    names = tuple(dict.fromkeys(name for one in predictions for name in one.names))
    rows = [{name: row for row, name in enumerate(one.names)} for one in predictions]
    fields = ("distance", "residual", "stretch", "projected")
    first = None if any(one.before is None for one in predictions) else np.empty((len(names), 3))
    points, spread, counts = np.empty((len(names), 3)), np.empty(len(names)), np.empty(len(names), dtype=int)
    medians = {key: np.empty(len(names)) for key in fields}
    for number, name in enumerate(names):
        has = [(one, row[name]) for one, row in zip(predictions, rows, strict=True) if name in row]
        places = np.array([one.points[row] for one, row in has])
        points[number] = np.median(places, axis=0)
        apart = np.linalg.norm(places - points[number], axis=1)
        spread[number] = np.median(apart) if len(has) > 1 else np.nan
        counts[number] = len(has)
        if first is not None:
            first[number] = has[0][0].before[has[0][1]]  # type: ignore[index]
        for key in fields:
            medians[key][number] = np.median([getattr(one, key)[row] for one, row in has])
    notes = []
    fewer = [name for name, count in zip(names, counts, strict=True) if count < len(predictions)]
    if fewer:
        those = listed((f"'{name}'" for name in fewer), MOST)
        words = counted(len(fewer), "landmark is", "landmarks are")
        notes.append(f"{words} not in every template: {those}")
    return Prediction(names, points, spread=spread, templates=counts, before=first, **medians), notes
