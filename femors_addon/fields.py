# SPDX-License-Identifier: GPL-3.0-or-later
"""Fields of text in decks: numbers in the few characters that programs read, and how they are replaced."""

from __future__ import annotations

import math
from collections.abc import Iterable

ABAQUS = 20  # characters of a number that Abaqus and CalculiX read
NASTRAN = 16  # characters of a large field


def number(value: float, width: int = ABAQUS) -> str:
    """Return the shortest text that reads as this very number, or the nearest one that fits in `width`.

    For Abaqus only values below 0.1 that need 17 digits have no text of their own; the error is then
    below 1e-18. Nastran's 16 characters leave 13 digits or so. There is always a decimal point.
    """
    text = repr(float(value))
    if "." not in text:
        mantissa, _, exponent = text.partition("e")
        text = f"{mantissa}.e{exponent}"
    if len(text) <= width:
        return text
    sign = int(text[0] == "-")
    size = abs(value)
    whole = len(str(int(size))) if size >= 1 else 0
    power = math.floor(math.log10(size))
    tries = [_bare(text)]
    for digits in (width - sign - 1 - whole, width - sign - 2 - whole):
        tries += [_bare(f"{value:.{digits}f}")] if digits > 0 else []
    for digits in (width - sign - 2 - len(f"e{power}"), width - sign - 3 - len(f"e{power}")):
        mantissa, _, exponent = f"{value:.{digits}e}".partition("e")
        tries.append(f"{mantissa}e{int(exponent)}")
    fitting = [text for text in tries if len(text) <= width and "." in text]
    # the nearest, and of equals the shortest
    return min(fitting, key=lambda text: (abs(float(text) - value), len(text)))


def spliced(data: bytes, pieces: Iterable[tuple[int, int, bytes]]) -> bytes:
    """Return bytes with other ones from each start to its stop; pieces ascend and do not overlap."""
    out, done = bytearray(), 0
    for start, stop, new in pieces:
        out += data[done:start]
        out += new
        done = stop
    if not done:
        return data
    out += data[done:]
    return bytes(out)


def _bare(text: str) -> str:
    """Leave out the zero before the point."""
    return text.replace("0.", ".", 1) if text.startswith(("0.", "-0.")) else text
