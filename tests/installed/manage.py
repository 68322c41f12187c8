# SPDX-License-Identifier: GPL-3.0-or-later
"""Install, break, and remove a package, in a Blender binary or in the Python of a bpy wheel.

    blender -b --python-exit-code 1 --python tests/installed/manage.py -- STEP [ARGUMENT]
    PYTHON tests/installed/manage.py STEP [ARGUMENT]

``BLENDER_USER_RESOURCES`` names the folder in which all of it happens. The steps:

    install ZIP      install and enable, and keep the preferences
    save FILE        a morph, saved to a .blend, with FEMORS
    broken           SciPy has been taken away or spoilt: told in a sentence wherever a user may ask
    uninstall        remove, and keep the preferences
    gone FILE        in a new process: nothing is left, and the .blend opens without FEMORS
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import bpy

PACKAGE = "bl_ext.user_default.femors"
EXTENSIONS = Path(os.environ["BLENDER_USER_RESOURCES"]) / "extensions"


def enable() -> None:
    """Enable the package, unless Blender did as it started."""
    import addon_utils

    if not addon_utils.check(PACKAGE)[1]:
        assert addon_utils.enable(PACKAGE, default_set=True) is not None, "it could not be enabled"


def disable() -> None:
    """Unregister it where it would keep the bpy module from ending; the preferences stay as they are."""
    import addon_utils

    if not bpy.app.binary_path and PACKAGE in bpy.context.preferences.addons:
        addon_utils.disable(PACKAGE)


def install(path: str) -> None:
    """Install a zip as *Install from Disk* does."""
    done = bpy.ops.extensions.package_install_files(
        repo="user_default", filepath=path, enable_on_install=True
    )
    assert done == {"FINISHED"}, done
    assert (EXTENSIONS / "user_default" / "femors" / "__init__.py").is_file()
    assert PACKAGE in bpy.context.preferences.addons
    bpy.ops.wm.save_userpref()


def save(path: str) -> None:
    """Morph a cube onto a sphere and save the file."""
    enable()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=1.3)
    bpy.context.object.name = "Target"
    bpy.ops.mesh.primitive_uv_sphere_add(segments=24, ring_count=16)
    bpy.context.object.name = "Source"
    assert bpy.ops.femors.morph(source="Source", target="Target") == {"FINISHED"}
    bpy.context.object.name = "Result"
    assert bpy.context.object.femors.report
    bpy.ops.wm.save_as_mainfile(filepath=path)


def broken() -> None:
    """Ask in every way; each time one sentence comes back."""
    enable()
    dependencies = sys.modules[f"{PACKAGE}.operators.dependencies"]
    command = sys.modules[f"{PACKAGE}.operators.command"]
    bpy.ops.mesh.primitive_uv_sphere_add(segments=16, ring_count=8)
    bpy.context.object.name = "Source"
    bpy.ops.mesh.primitive_uv_sphere_add(segments=12, ring_count=8, radius=1.5)
    bpy.context.object.name = "Target"
    try:
        bpy.ops.femors.morph(source="Source", target="Target")
    except RuntimeError as error:
        told = str(error)
    else:
        raise AssertionError("the morph ran without SciPy")
    assert "SciPy" in told and "zip" in told and told.strip().count("\n") == 0, told
    assert command.run(["morph", "a.stl", "b.stl", "-o", "c.stl"]) == 2
    assert dependencies.missing() in told, "the preferences say something else"
    print("told:", dependencies.missing())


def uninstall() -> None:
    """Remove it as *Uninstall* does."""
    enable()
    repositories = bpy.context.preferences.extensions.repos
    index = next(i for i, repo in enumerate(repositories) if repo.module == "user_default")
    done = bpy.ops.extensions.package_uninstall(repo_index=index, pkg_id="femors")
    assert done == {"FINISHED"}, done
    bpy.ops.wm.save_userpref()


def gone(path: str) -> None:
    """Look for what should not be there any more, then open a file that was made with FEMORS."""
    assert PACKAGE not in bpy.context.preferences.addons
    left: list[Any] = [p for p in EXTENSIONS.rglob("*") if "femors" in p.name.lower()]
    left += [p for p in EXTENSIONS.glob(".local/lib/*/site-packages/*") if p.name != "__pycache__"]
    assert not left, left
    assert not dir(bpy.ops.femors), dir(bpy.ops.femors)
    assert not any(name.startswith(PACKAGE) for name in sys.modules)
    bpy.ops.wm.open_mainfile(filepath=path)
    result = bpy.data.objects["Result"]
    assert "femors_displacement" in result.data.attributes and len(result.data.vertices) == 362


def main() -> None:
    """Run the step that the command line names."""
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    steps = {"install": install, "save": save, "broken": broken, "uninstall": uninstall, "gone": gone}
    try:
        steps[words[0]](*words[1:])
    finally:
        disable()
    print(f"femors-step {words[0]}: held")


if __name__ == "__main__":
    main()
