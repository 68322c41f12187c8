# SPDX-License-Identifier: GPL-3.0-or-later
"""Names beside a picture, each with a line to what it names, as SVG text around the PNG."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

SIZE, LETTER = 11, 8.5  # pixels: height of the letters, and room for one
LONGEST = 30  # letters: what is longer is cut
LINE = 13.0  # from one name to the next
APART = 6.0  # of a name from the picture


def named(png: bytes, names: Sequence[tuple[float, float, str]], words: str) -> str:
    """Return a picture with names to its left and right, whichever is nearer, none on another.

    Parameters
    ----------
    png : bytes
    names : sequence of (float, float, str)
        Where in the picture, across and down in its pixels from the upper left, and the name.
    words : str
        What the whole shows, for those who cannot see it.
    """
    wide, tall = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))
    names = [(x, y, name if len(name) <= LONGEST else name[: LONGEST - 1] + "…") for x, y, name in names]
    left = [one for one in names if one[0] < wide / 2]
    right = [one for one in names if one[0] >= wide / 2]
    before, after = (
        max([APART + LETTER * len(name) for *_, name in side] or [0.0]) for side in (left, right)
    )
    parts = []
    for side, start, anchor in ((left, before - APART, "end"), (right, before + wide + APART, "start")):
        side = sorted(side, key=lambda one: one[1])
        for (across, down, name), level in zip(side, _levels([one[1] for one in side], tall), strict=True):
            parts.append(
                f'<path d="M{start:.1f} {level:.1f}L{before + across:.1f} {down:.1f}" stroke="#999"/>'
                f'<text x="{start:.1f}" y="{level + 0.35 * SIZE:.1f}" text-anchor="{anchor}" '
                f'stroke="#fff" stroke-width="3" paint-order="stroke">{escape(name)}</text>'
            )
    data = base64.b64encode(png).decode("ascii")
    full = before + wide + after
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {full:.0f} {tall}" width="{full:.0f}" '
        f'height="{tall}" font-size="{SIZE}" font-family="sans-serif" role="img" '
        f'aria-label="{escape(words)}">'
        f'<image x="{before:.1f}" y="0" width="{wide}" height="{tall}" href="data:image/png;base64,{data}"/>'
        f"{''.join(parts)}</svg>"
    )


def _levels(wanted: Sequence[float], tall: float) -> list[float]:
    """Return heights a line apart at least, near those wanted, which ascend; on the picture if they fit."""
    levels: list[float] = []
    for down in wanted:
        levels.append(max(down, levels[-1] + LINE) if levels else max(down, LINE / 2))
    floor = tall - LINE / 2
    for at in reversed(range(len(levels))):
        levels[at] = min(levels[at], floor)
        floor = levels[at] - LINE
    return levels
