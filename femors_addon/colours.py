# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour maps for figures: equal steps of the value are equal steps to the eye.

Each map is a path through CIELAB whose lightness never turns back (in a map with two arms, on each arm),
with as much chroma as sRGB can show up to a limit, walked at constant speed. The tables are computed,
not copied: see `table`.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike

from .mesh import Float

SIZE = 256
FINE = 1024  # points of a path before it is walked evenly
WHITE = np.array([0.95047, 1.0, 1.08883])  # D65
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)

SEQUENTIAL = (
    ("lagoon", "Lagoon", "Dark violet over blue and green to light yellow"),
    ("ember", "Ember", "Dark red over orange to light yellow"),
    ("grey", "Grey", "Dark to light grey, for print"),
)
"""Maps for values from small to large: (key, name, description)."""
DIVERGING = "balance"
"""The map for values with a sign: red below zero, light grey at zero, blue above."""

PATHS: dict[str, tuple[tuple[float, float], tuple[float, float], float]] = {
    "lagoon": ((30.0, 94.0), (305.0, 100.0), 62.0),
    "ember": ((22.0, 94.0), (12.0, 98.0), 82.0),
    "grey": ((20.0, 96.0), (0.0, 0.0), 0.0),
}
"""From dark to light: lightness, hue in degrees, and the most chroma."""
ARMS = ((32.0, 90.0), (30.0, 262.0), 68.0)
"""Lightness at the ends and in the middle, hue of the two arms, most chroma."""


@functools.lru_cache(maxsize=8)
def table(name: str) -> Float:
    """Return the (256, 3) sRGB colours of a map, in [0, 1], for values from low to high."""
    if name == DIVERGING:
        (dark, light), hues, most = ARMS
        below, above = (_walked(_path((dark, light), (hue, hue), most, hues), SIZE // 2) for hue in hues)
        out = np.concatenate((below, above[::-1]))
    else:
        out = _walked(_path(*PATHS[name]), SIZE)
    out = np.clip(srgb(out), 0.0, 1.0)
    out.setflags(write=False)
    return out


def painted(values: ArrayLike, low: float, high: float, name: str) -> Float:
    """Return the (n, 3) sRGB colours of values (n,); those outside the range have its end's colour."""
    values = np.asarray(values, dtype=np.float64).ravel()
    share = (values - low) / (high - low) if high > low else np.zeros(len(values))
    index = np.clip(np.nan_to_num(share) * SIZE, 0, SIZE - 1).astype(np.int64)
    return np.asarray(table(name)[index])


def span(values: ArrayLike, signed: bool, least: float = 0.0) -> tuple[float, float]:
    """Return a range that shows most of the values: 1st to 99th percentile.

    Of a signed quantity the negative side is what is looked for (overlap, inversion): as far as it goes,
    and as far on the other side of zero; where nothing is negative, up to the median. What is smaller
    than `least` is rounding, which no colours should spread out.
    """
    known: Float = np.asarray(values, dtype=np.float64).ravel()
    known = known[np.isfinite(known)]
    if not len(known):
        return 0.0, 1.0
    low, high = (float(x) for x in np.percentile(known, (1, 99)))
    if signed:
        reach = -float(known.min()) if known.min() < -least else float(np.median(known))
        reach = max(reach, least)
        low, high = -reach, reach
    if not high - low > least:
        high = low + max(least, abs(low) * 1e-6, 1e-12)
    return low, high


def linear(colours: ArrayLike) -> Float:
    """Return linear values of sRGB ones, both in [0, 1]."""
    colours = np.asarray(colours, dtype=np.float64)
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def from_linear(values: Float) -> Float:
    """Return sRGB values of linear ones (IEC 61966-2-1): the way back from `linear`."""
    curved = 1.055 * np.maximum(values, 0.0031308) ** (1 / 2.4) - 0.055
    return np.asarray(np.where(values <= 0.0031308, 12.92 * values, curved))


def lab(colours: ArrayLike) -> Float:
    """Return CIELAB coordinates (n, 3) of sRGB colours (n, 3)."""
    xyz = linear(colours) @ TO_XYZ.T / WHITE
    root = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    x, y, z = root.T
    return np.column_stack((116 * y - 16, 500 * (x - y), 200 * (y - z)))


def srgb(coordinates: Float) -> Float:
    """Return sRGB colours (n, 3) of CIELAB coordinates; outside [0, 1] where no screen can show them."""
    light, a, b = coordinates.T
    y = (light + 16) / 116
    root = np.column_stack((y + a / 500, y, y - b / 200))
    xyz = np.where(root > 6 / 29, root**3, 3 * (6 / 29) ** 2 * (root - 4 / 29)) * WHITE
    return from_linear(xyz @ np.linalg.inv(TO_XYZ).T)


def _path(
    lightness: tuple[float, float],
    hue: tuple[float, float],
    most: float,
    arms: tuple[float, ...] = (),
) -> Float:
    """Return CIELAB points (k, 3) with the chroma that sRGB allows.

    An arm of a map ends in grey, and has no more chroma than its counterpart at any of the hues `arms`.
    """
    at = np.linspace(0.0, 1.0, FINE)
    light = lightness[0] + (lightness[1] - lightness[0]) * at
    turn = np.radians(hue[0] + (hue[1] - hue[0]) * at)
    reach = _reach(light, turn)
    for other in arms:
        reach = np.minimum(reach, _reach(light, np.full(FINE, np.radians(other))))
    chroma = np.minimum(most, 0.96 * reach)
    chroma = np.convolve(np.pad(chroma, 40, mode="edge"), np.ones(81) / 81, mode="valid")  # no kinks
    chroma = np.minimum(chroma, 0.99 * reach)
    if arms:
        chroma = chroma * np.minimum(1.0, 1.6 * (1.0 - at))
    return np.column_stack((light, chroma * np.cos(turn), chroma * np.sin(turn)))


def _reach(light: Float, turn: Float) -> Float:
    """Return (k,) the largest chroma that sRGB shows at each lightness and hue, by bisection."""
    low, high = np.zeros(len(light)), np.full(len(light), 180.0)
    for _ in range(24):
        middle = 0.5 * (low + high)
        colour = srgb(np.column_stack((light, middle * np.cos(turn), middle * np.sin(turn))))
        shown = ((colour >= 0.0) & (colour <= 1.0)).all(axis=1)
        low, high = np.where(shown, middle, low), np.where(shown, high, middle)
    return low


def _walked(path: Float, count: int) -> Float:
    """Return `count` points at equal distances along a path (k, 3)."""
    gone = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))))
    at = np.linspace(0.0, gone[-1], count)
    return np.column_stack([np.interp(at, gone, axis) for axis in path.T])
