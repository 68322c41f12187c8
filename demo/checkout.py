# SPDX-License-Identifier: GPL-3.0-or-later
"""This checkout as an enabled Blender extension, without building a zip.

Blender sees a folder of links as an extensions repository: the link's name is the manifest's id.
Used by the demonstration and by the tests that need Blender. Where ``FEMORS_INSTALLED`` is set, a
package is installed in ``BLENDER_USER_RESOURCES``, and that is enabled instead of the checkout.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[1]
INSTALLED = bool(os.environ.get("FEMORS_INSTALLED"))
PACKAGE = "bl_ext.user_default.femors" if INSTALLED else "bl_ext.dev.femors"


class Checkout:
    """The extension in a Blender of its own: preferences and extensions of the user stay out.

    Must be made before the ``bpy`` wheel is imported; a blender binary has read
    ``BLENDER_USER_RESOURCES`` by then, so whoever starts one sets it.
    """

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="femors_blender_")
        os.environ.setdefault("BLENDER_USER_RESOURCES", self._folder.name)

    def enable(self) -> ModuleType:
        """Register the extension and return its root module."""
        import addon_utils
        import bpy

        if addon_utils.check(PACKAGE)[1]:  # by Blender itself, as it started
            return sys.modules[PACKAGE]
        repository = Path(self._folder.name) / "extensions_dev"
        if not INSTALLED and not repository.exists():
            repository.mkdir()
            (repository / "femors").symlink_to(ROOT)
            repositories = bpy.context.preferences.extensions.repos
            repositories.new(name="dev", module="dev", custom_directory=str(repository))
        module = addon_utils.enable(PACKAGE, default_set=True)
        if module is None:
            raise RuntimeError("the extension could not be enabled; its traceback is above")
        return module

    def disable(self) -> None:
        """Unregister it; a class still registered at exit makes bpy 4.2 crash and 4.5 hang."""
        import addon_utils
        import bpy

        if PACKAGE in bpy.context.preferences.addons:
            # for good, wheels and all, unless it is the tests that have to go on with it
            addon_utils.disable(PACKAGE, default_set=not INSTALLED)
