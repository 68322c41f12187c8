# SPDX-License-Identifier: GPL-3.0-or-later
"""The packages that the core needs: found without being imported, so that enabling stays fast."""

from __future__ import annotations

import functools
import importlib
import importlib.util

from ..femors_addon.progress import FemorsError

NEEDED = {"numpy": "NumPy", "scipy": "SciPy", "fast_simplification": "fast-simplification"}


@functools.cache
def missing() -> str:
    """Return one sentence about what is missing, or "". Looked up once in a Blender session."""
    names = [label for name, label in NEEDED.items() if importlib.util.find_spec(name) is None]
    if not names:
        return ""
    return (
        f"{' and '.join(names)} not found in Blender's Python: install with pip as README.md says under "
        "'Install in Blender', then restart Blender"
    )


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
            raise FemorsError(f"{label} is there but cannot be used by this Blender ({reason})") from error
