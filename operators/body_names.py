# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies, pairs and numbers in one string each, as scripts give them to operators. Without bpy."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping

from ..femors_addon.progress import FemorsError

Pair = tuple[str, str]


def split(text: str) -> list[str]:
    """Return names that semicolons part; commas do, where there is no semicolon."""
    return [name.strip() for name in text.split(";" if ";" in text else ",") if name.strip()]


def joined(names: Iterable[str]) -> str:
    """Return names as one string that `split` reads; a name may hold commas."""
    return "".join(f"{name};" for name in names)


def pairs(text: str, names: Collection[str], what: str) -> list[Pair]:
    """Return pairs from "A,B;C,D".

    Raises
    ------
    FemorsError
        Not two names of bodies with a comma between.
    """
    return [_pair(item.strip(), names, what) for item in text.split(";") if item.strip()]


def _pair(text: str, names: Collection[str], what: str) -> Pair:
    parts = text.split(",")
    for cut in range(1, len(parts)):  # names may hold commas
        one, two = ",".join(parts[:cut]).strip(), ",".join(parts[cut:]).strip()
        if one in names and two in names:
            return one, two
    raise FemorsError(f"{what}: '{text}' is not a pair of the bodies ({_listed(names)}); write \"A,B;C,D\"")


def pair_numbers(text: str, names: Collection[str], what: str) -> dict[Pair, float]:
    """Return numbers by pair from "A,B=0.02;C,D=0"."""
    return {_pair(key, names, what): value for key, value in _assigned(text, what)}


def numbers(text: str, names: Collection[str], what: str) -> dict[str, float]:
    """Return numbers by name from "A=0.3;B=1".

    Raises
    ------
    FemorsError
        No such body, or no number.
    """
    out = dict(_assigned(text, what))
    for name in out:
        known(name, names, what)
    return out


def known(name: str, names: Collection[str], what: str) -> None:
    """Raise `FemorsError` where no body has this name."""
    if name not in names:
        raise FemorsError(f"{what}: there is no body '{name}' among {_listed(names)}")


def _assigned(text: str, what: str) -> list[tuple[str, float]]:
    out = []
    for item in text.split(";"):
        if not item.strip():
            continue
        key, _, value = item.rpartition("=")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not key.strip() or math.isnan(number):
            raise FemorsError(f"{what}: '{item.strip()}' is not a name, '=' and a number")
        out.append((key.strip(), number))
    return out


def _listed(names: Collection[str], most: int = 6) -> str:
    shown = [f"'{name}'" for name in list(names)[:most]]
    return ", ".join(shown) + (f" and {len(names) - most} more" if len(names) > most else "")


def text_of_pairs(chosen: Iterable[Pair]) -> str:
    """Return pairs as `pairs` reads them."""
    return ";".join(f"{one},{two}" for one, two in chosen)


def text_of_gaps(gaps: Mapping[Pair, float]) -> str:
    """Return gaps as `pair_numbers` reads them."""
    return ";".join(f"{one},{two}={gap!r}" for (one, two), gap in gaps.items())
