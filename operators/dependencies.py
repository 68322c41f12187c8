# SPDX-License-Identifier: GPL-3.0-or-later
"""The packages that the core needs: judged without being imported, so that enabling stays fast."""

from __future__ import annotations

import functools
import importlib
import importlib.util
import re
import sys
from pathlib import Path
from typing import ClassVar

from ..femors_addon.progress import FemorsError
from .lazy import metadata, np

NEEDED = {"numpy": "NumPy", "scipy": "SciPy", "fast_simplification": "fast-simplification"}
SHOWN = {
    "scipy": "SciPy",
    "fast-simplification": "fast-simplification",
    "meshio": "meshio",
}
"""Packages whose versions are shown, by their names in the index."""
PACKAGED = (Path(__file__).parents[1] / "wheels").is_dir()
"""Whether this is an installed package, which brings what it needs, and not a checkout."""


class Tried:
    """What was found when a package was loaded, for that is not tried for a look at the panel."""

    sentence: ClassVar[str] = ""


def forget() -> None:
    """Look everything up again, as after a restart."""
    Tried.sentence = ""
    missing.cache_clear()


@functools.cache
def missing() -> str:
    """Return one sentence about what is missing or cannot work, or "". Looked up once in a session."""
    if Tried.sentence:
        return Tried.sentence
    names = [label for name, label in NEEDED.items() if importlib.util.find_spec(name) is None]
    if names:
        python = f"{sys.version_info.major}.{sys.version_info.minor}"
        return f"{' and '.join(names)} not found in Blender's Python {python}: {remedy()}"
    wanted = clash()
    return f"{wanted}: {remedy()}" if wanted else ""


def remedy() -> str:
    """Return what to do about a package that is missing or does not fit, the rest of a sentence."""
    if PACKAGED:
        return (
            "install the FEMORS zip made for this system and this Blender over this one (see README.md, "
            "'Install in Blender'), then restart Blender"
        )
    return "install with pip as README.md says under 'Install in Blender', then restart Blender"


def clash() -> str:
    """Return which package wants another NumPy than Blender's, or ""; as the package itself says."""
    for name, label in SHOWN.items():
        for line in _requires(name):
            if re.match(r"numpy(?![\w.-])", line, re.IGNORECASE) and not allows(line, np.__version__):
                wanted = line.partition(";")[0][len("numpy") :].strip(" ()")
                return (
                    f"{label} {metadata.version(name)} wants NumPy {wanted}, and this Blender "
                    f"has {np.__version__}"
                )
    return ""


def allows(requirement: str, version: str) -> bool:
    """Say whether a version is within the bounds of a requirement, such as ``numpy<2.5,>=1.23.5``.

    Bounds of other kinds than these, and whatever has an environment marker, are let pass.
    """
    bounds, _, marker = requirement.partition(";")
    if marker:
        return True
    compare = {
        "<": lambda a, b: a < b,
        "<=": lambda a, b: a <= b,
        ">": lambda a, b: a > b,
        ">=": lambda a, b: a >= b,
    }
    have = _numbers(version)
    found = re.findall(r"(<=|>=|<|>)\s*([\d.]+)", bounds)
    return all(compare[sign](have, _numbers(bound)) for sign, bound in found)


def found() -> str:
    """Return the versions of what is there, as one line."""
    names = [f"NumPy {np.__version__}"]
    for name, label in SHOWN.items():
        try:
            names.append(f"{label} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            names.append(f"no {label}")
    return ", ".join(names)


def require() -> None:
    """Raise `FemorsError` where a package is missing, or there but unusable."""
    sentence = missing()
    if sentence:
        raise FemorsError(sentence)
    for name, label in NEEDED.items():
        try:
            importlib.import_module(name)
        except Exception as error:  # a wheel for another NumPy or Python fails in many ways
            reason = " ".join(str(error).split())[:150]
            forget()
            Tried.sentence = f"{label} is there but cannot be used by this Blender ({reason}): {remedy()}"
            raise FemorsError(Tried.sentence) from error


def _requires(name: str) -> list[str]:
    try:
        return metadata.requires(name) or []
    except metadata.PackageNotFoundError:
        return []  # found as a module all the same: built by hand, perhaps


def _numbers(version: str) -> tuple[int, ...]:
    """Return the leading numbers of a version, without zeros at their end: 2.0 is 2."""
    numbers = [int(part) for part in re.match(r"[\d.]*", version)[0].strip(".").split(".") if part]
    while numbers and numbers[-1] == 0:
        numbers.pop()
    return tuple(numbers)
