# SPDX-License-Identifier: GPL-3.0-or-later
"""Small plots as SVG text: histograms and curves with axes, and the bar of a colour map."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
from numpy.typing import ArrayLike

from .colours import table

WIDTH, HEIGHT = 460, 260
LEFT, RIGHT, TOP, BOTTOM = 62, 14, 26, 44
INKS = ("#2f6db3", "#d1692b", "#4c8f4c", "#8a5aa5")
BINS = 60


def histogram(series: Mapping[str, ArrayLike], label: str, what: str = "vertices") -> str:
    """Return a histogram of one or several samples in the same bins, up to the 99.5th percentile.

    Parameters
    ----------
    series : dict of str to array
        Samples by name.
    label : str
        Of the horizontal axis, with the unit.
    what : str
        What is counted.
    """
    samples = {name: np.asarray(values, dtype=float).ravel() for name, values in series.items()}
    samples = {name: values[np.isfinite(values)] for name, values in samples.items()}
    samples = {name: values for name, values in samples.items() if len(values)}
    if not samples:
        return ""
    low = min(float(values.min()) for values in samples.values())
    high = max(float(np.percentile(values, 99.5)) for values in samples.values())
    low = 0.0 if 0 < low < 0.3 * high else low
    high = high if high > low else low + max(abs(low), 1.0) * 1e-6
    edges = np.linspace(low, high, BINS + 1)
    shares = {
        name: 100.0 * np.histogram(np.minimum(values, high), edges)[0] / len(values)
        for name, values in samples.items()
    }
    top = max(float(share.max()) for share in shares.values())
    frame = _Frame((low, high), (0.0, top * 1.05))
    parts = []
    for (name, share), ink in zip(shares.items(), INKS, strict=False):
        points = [(edges[0], 0.0)]
        for i, value in enumerate(share):
            points += [(edges[i], value), (edges[i + 1], value)]
        points.append((edges[-1], 0.0))
        path = " ".join(f"{frame.x(x):.1f},{frame.y(y):.1f}" for x, y in points)
        parts.append(
            f'<polygon points="{path}" fill="{ink}" fill-opacity="0.35" stroke="{ink}"><title>{escape(name)}'
            "</title></polygon>"
        )
    return frame.svg("".join(parts), label, f"% of {what}", list(samples))


def curves(
    series: Mapping[str, Sequence[tuple[float, float]]], label: str, side: str, logarithmic: bool = True
) -> str:
    """Return curves over a horizontal axis; upwards logarithmic, without what is not positive, or from 0.

    Parameters
    ----------
    series : dict of str to points
        (x, y) by name.
    label, side : str
        Of the horizontal and of the vertical axis.
    logarithmic : bool
        Upwards.
    """
    kept = {name: [(x, y) for x, y in points if y > 0 or not logarithmic] for name, points in series.items()}
    kept = {name: points for name, points in kept.items() if points}
    if not kept:
        return ""
    every = [point for points in kept.values() for point in points]
    height = math.log10 if logarithmic else float
    xs, ys = [x for x, _ in every], [height(y) for _, y in every]
    low, high = (min(ys), max(ys)) if logarithmic else (min(0.0, *ys), max(1.0, *ys))
    room = max(0.06 * (high - low), 0.05)
    up = (low - room if logarithmic else low, high + room)
    frame = _Frame((min(xs), max(*xs, min(xs) + 1)), up, logarithmic)
    parts = []
    for (name, points), ink in zip(kept.items(), INKS, strict=False):
        places = [(frame.x(x), frame.y(height(y))) for x, y in points]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        parts.append(f'<polyline points="{path}" fill="none" stroke="{ink}" stroke-width="1.5"/>')
        parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2" fill="{ink}"/>' for x, y in places]
        parts.append(f"<desc>{escape(name)}</desc>")
    return frame.svg("".join(parts), label, side, list(kept))


def bar(name: str, low: float, high: float, label: str) -> str:
    """Return the legend of a colour map: a bar with its ends and middle."""
    colours = (255 * table(name)).round().astype(int)
    stops = "".join(
        f'<rect x="{20 + 1.25 * i:.2f}" y="18" width="1.6" height="14" fill="rgb({r},{g},{b})"/>'
        for i, (r, g, b) in enumerate(colours.tolist())
    )
    words = "".join(  # each within the bar, however long
        f'<text x="{20 + 320 * share:.0f}" y="46" text-anchor="{anchor}">{number(value)}</text>'
        for share, anchor, value in (
            (0.0, "start", low),
            (0.5, "middle", (low + high) / 2),
            (1.0, "end", high),
        )
    )
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 440 52" width="440" height="52" '
        'font-size="11" font-family="sans-serif" shape-rendering="crispEdges">'
        f'<text x="20" y="12">{escape(label)}</text>{stops}{words}</svg>'
    )


def key(inks: Mapping[str, Sequence[float]]) -> str:
    """Return the legend of things that have a colour each: red, green and blue from 0 to 1 by their names."""
    parts = []
    for row, (name, ink) in enumerate(inks.items()):
        red, green, blue = (round(255 * share) for share in ink)
        top = 6 + 20 * row
        parts.append(f'<rect x="20" y="{top}" width="14" height="14" fill="rgb({red},{green},{blue})"/>')
        parts.append(f'<text x="42" y="{top + 11}">{escape(name)}</text>')
    height = 12 + 20 * len(inks)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 440 {height}" width="440" height="{height}" '
        f'font-size="11" font-family="sans-serif">{"".join(parts)}</svg>'
    )


def number(value: float) -> str:
    """Return a number for an axis or a table, in four significant digits at most."""
    if value == 0 or abs(value) < 1e-12:
        return "0"
    if abs(value) >= 1e5 or abs(value) < 1e-4:
        return f"{value:.3g}"
    return f"{value:.4g}"


class _Frame:
    """The axes of a plot: values to places."""

    def __init__(
        self, across: tuple[float, float], up: tuple[float, float], logarithmic: bool = False
    ) -> None:
        self._across, self._up, self._logarithmic = across, up, logarithmic

    def x(self, value: float) -> float:
        low, high = self._across
        return LEFT + (WIDTH - LEFT - RIGHT) * (value - low) / (high - low)

    def y(self, value: float) -> float:
        low, high = self._up
        return HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (value - low) / (high - low)

    def svg(self, body: str, label: str, side: str, names: list[str]) -> str:
        """Return the whole, with axes, ticks and a legend where there are several series."""
        floor, middle = HEIGHT - BOTTOM, (LEFT + WIDTH - RIGHT) / 2
        marks = []
        for value in ticks(*self._across):
            at = self.x(value)
            marks.append(f'<path d="M{at:.1f} {floor}v4" stroke="#555"/>')
            marks.append(f'<text x="{at:.1f}" y="{floor + 16}" text-anchor="middle">{number(value)}</text>')
        for value in self._side():
            at = self.y(value)
            words = number(10**value if self._logarithmic else value)
            marks.append(f'<path d="M{LEFT} {at:.1f}H{WIDTH - RIGHT}" stroke="#ddd"/>')
            marks.append(f'<text x="{LEFT - 6}" y="{at + 4:.1f}" text-anchor="end">{words}</text>')
        apart = min(130, (WIDTH - LEFT) // max(len(names), 1))
        keys = "".join(
            f'<rect x="{LEFT + apart * i}" y="8" width="10" height="10" fill="{ink}"/>'
            f'<text x="{LEFT + 14 + apart * i}" y="17">{escape(name)}</text>'
            for i, (name, ink) in enumerate(zip(names, INKS, strict=False))
            if len(names) > 1
        )
        high = (TOP + floor) / 2
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" '
            f'height="{HEIGHT}" font-size="11" font-family="sans-serif" role="img">'
            f"{''.join(marks)}{body}"
            f'<path d="M{LEFT} {TOP}V{floor}H{WIDTH - RIGHT}" fill="none" stroke="#555"/>'
            f'<text x="{middle}" y="{HEIGHT - 8}" text-anchor="middle">{escape(label)}</text>'
            f'<text x="14" y="{high}" text-anchor="middle" transform="rotate(-90 14 {high})">{escape(side)}'
            f"</text>{keys}</svg>"
        )

    def _side(self) -> list[float]:
        low, high = self._up
        if not self._logarithmic:
            return ticks(low, high)
        found = [
            math.log10(f * 10.0**e) for e in range(math.floor(low), math.ceil(high) + 1) for f in (1, 2, 5)
        ]
        inside = [value for value in found if low <= value <= high]
        decades = [value for value in inside if value == round(value)]
        return decades if len(inside) > 9 and len(decades) > 1 else inside


def ticks(low: float, high: float) -> list[float]:
    """Return four to eight round values within a range."""
    step = 10.0 ** math.floor(math.log10((high - low) / 4))
    step *= next(f for f in (1, 2, 5, 10) if (high - low) / (f * step) <= 8)
    first = math.ceil(low / step - 1e-9)
    return [i * step for i in range(first, math.floor(high / step + 1e-9) + 1)]
