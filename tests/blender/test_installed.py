# SPDX-License-Identifier: GPL-3.0-or-later
"""The installed package: that it brings all it needs, and that nothing else is used in its place."""

from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
import importlib.util
import os
import subprocess
import sys
import tomllib
from importlib.machinery import PathFinder
from pathlib import Path

import bpy
import pytest
from checkout import PACKAGE

ROOT = Path(__file__).resolve().parents[2]
EXTENSIONS = Path(os.environ["BLENDER_USER_RESOURCES"]) / "extensions"
HERE = EXTENSIONS / "user_default" / "femors"
PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"
BROUGHT = ("scipy", "fast_simplification", "meshio", "rich", "markdown_it", "mdurl", "pygments")
LOCK = tomllib.loads((ROOT / "requirements" / "wheels.lock.toml").read_text())["wheel"]


def inside(path: str | None, folder: Path) -> bool:
    """Say whether a file is below a folder, links followed."""
    return path is not None and Path(path).resolve().is_relative_to(folder.resolve())


@pytest.mark.parametrize("name", BROUGHT)
def test_packages_come_from_the_wheels(extension, name):
    site = EXTENSIONS / ".local" / "lib" / f"python{PYTHON}" / "site-packages"
    assert inside(PathFinder.find_spec(name, sys.path).origin, site)


def test_numpy_is_blenders_own(extension):
    assert not inside(importlib.util.find_spec("numpy").origin, EXTENSIONS)
    assert not list(HERE.glob("wheels/numpy*")) and not list(EXTENSIONS.glob(".local/**/numpy-*"))


def test_all_of_femors_comes_from_the_package(extension):
    importlib.import_module(f"{PACKAGE}.femors_addon.cli")
    ours = {name: module for name, module in sys.modules.items() if name.startswith(PACKAGE)}
    assert len(ours) > 30
    for name, module in ours.items():
        assert inside(module.__file__, HERE), name
    assert PathFinder.find_spec("femors_addon", sys.path) is None, "the checkout is on the path"


def test_versions_are_those_of_the_lock(extension):
    manifest = tomllib.loads((HERE / "blender_manifest.toml").read_text())
    named = {Path(path).name for path in manifest["wheels"]}
    assert named == {path.name for path in (HERE / "wheels").iterdir()}
    locked = {item["file"]: item for item in LOCK}
    for name in named:
        item = locked[name]
        assert hashlib.sha256((HERE / "wheels" / name).read_bytes()).hexdigest() == item["sha256"]
        if item["python"] in (PYTHON, "any"):
            assert importlib.metadata.version(item["name"]) == item["version"], name


def test_the_extensions_folder_is_written_by_blender_only(extension):
    """Nothing but modules, what Python makes of them, and what the zip held."""
    held = {".py", ".md", ".toml", ".whl", ".cff"}
    for path in HERE.rglob("*"):
        kept = path.suffix in held or path.name == "LICENSE" or "__pycache__" in path.parts
        assert path.is_dir() or kept, path


def test_blender_starts_with_it_and_without_anything_heavy():
    if not bpy.app.binary_path:
        pytest.skip("the bpy wheel does not enable what the preferences name; see the next test there")
    code = (
        "import sys; heavy = ('numpy', 'scipy', 'fast_simplification', 'meshio'); "
        "print('imported', [m for m in heavy if m in sys.modules]); "
        "import bpy; print('enabled', 'femors' in dir(bpy.ops) and bpy.ops.femors.morph.poll())"
    )
    done = subprocess.run(
        [bpy.app.binary_path, "-b", "--python-exit-code", "1", "--python-expr", code],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    said = done.stdout + done.stderr
    assert done.returncode == 0 and "enabled True" in said and "imported []" in said, said
    assert "Traceback" not in said


def test_a_morph_is_saved_and_read_again(pair, tmp_path, tools):
    import numpy as np

    assert bpy.ops.femors.morph(source="Femur", target="Scan") == {"FINISHED"}
    made = bpy.context.object
    name, before, report = made.name, tools.world(made), made.femors.report
    bpy.context.scene.femors.spread_end = 3.25
    path = tmp_path / "morph.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
    assert name not in bpy.data.objects
    bpy.ops.wm.open_mainfile(filepath=str(path))
    again = bpy.data.objects[name]
    assert np.array_equal(tools.world(again), before)
    assert again.femors.report == report and "femors_displacement" in again.data.attributes
    assert bpy.context.scene.femors.spread_end == 3.25
    assert bpy.ops.femors.morph(source=name, target="Scan") == {"FINISHED"}
