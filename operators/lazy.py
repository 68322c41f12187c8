# SPDX-License-Identifier: GPL-3.0-or-later
"""NumPy and others, imported when they are first used: Blender starts with each extension that is enabled."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import importlib.metadata as metadata
    import tempfile
    import zipfile

    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[Any]
else:
    Array = Any

    class Later:
        """Stands for a module until something of it is asked for."""

        def __init__(self, name: str) -> None:
            self._name, self._module = name, None

        def __getattr__(self, name: str) -> Any:
            """Import the module, the first time, and look there."""
            self._module = self._module or importlib.import_module(self._name)
            return getattr(self._module, name)

    metadata, np, tempfile, zipfile = map(Later, ("importlib.metadata", "numpy", "tempfile", "zipfile"))

__all__ = ["Array", "metadata", "np", "tempfile", "zipfile"]
