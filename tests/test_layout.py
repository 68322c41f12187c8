# SPDX-License-Identifier: GPL-3.0-or-later
"""The house rules that a machine can keep: who may import whom, and that settings make sense."""

from __future__ import annotations

import ast
import dataclasses
import graphlib
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from femors_addon import settings
from femors_addon.morph_settings import PRESETS, MorphSettings
from femors_addon.progress import FemorsError

ROOT = Path(__file__).resolve().parent.parent
CORE, OPERATORS, UI = ROOT / "femors_addon", ROOT / "operators", ROOT / "ui"
BLENDER = {"bpy", "bmesh", "mathutils", "gpu", "bl_math", "addon_utils", "bpy_extras"}
ALL = sorted(path for folder in (CORE, OPERATORS, UI) for path in folder.rglob("*.py"))
WRITTEN = [ROOT / "__init__.py", *ALL, *sorted((ROOT / "tests").rglob("*.py"))]


def name_of(path: Path) -> str:
    """Return a module's dotted name from the root of the extension."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in ALL}


def imports(path: Path) -> set[str]:
    """Return what a file imports, anywhere in it, as dotted names from the root of the extension."""
    package = path.relative_to(ROOT).parent.parts
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = [*package[: len(package) - node.level + 1]] if node.level else []
            base += (node.module or "").split(".") if node.module else []
            for alias in node.names:
                whole = ".".join([*base, alias.name])
                found.add(whole if whole in MODULES else ".".join(base))
    return found


GRAPH = {name: imports(path) & set(MODULES) - {name} for name, path in MODULES.items()}


def test_the_core_knows_nothing_of_blender():
    for path in CORE.rglob("*.py"):
        blender = {name for name in imports(path) if name.split(".")[0] in BLENDER}
        assert not blender, f"{path}: {blender}"


def test_the_core_keeps_no_lock_for_properties():
    """All are of `cached.py`: Python 3.11's own let threads wait for each other."""
    for path in set(CORE.rglob("*.py")) - {CORE / "cached.py"}:
        assert "functools import cached_property" not in path.read_text(encoding="utf-8"), path


def test_the_command_line_starts_without_blender_and_without_a_word():
    code = (
        "import sys; import femors_addon.cli; sys.exit(any(m in sys.modules for m in ('bpy', 'mathutils')))"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_inside_the_core_imports_are_relative():
    for path in CORE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            if path.name != "__init__.py":
                assert not any(name.split(".")[0] == "femors_addon" for name in names), path


def test_imports_run_one_way():
    for name, used in GRAPH.items():
        layer = name.split(".")[0]
        below = {"femors_addon": {"femors_addon"}, "operators": {"femors_addon", "operators"}}.get(layer)
        if below is not None:
            assert {other.split(".")[0] for other in used} <= below, name
    list(graphlib.TopologicalSorter(GRAPH).static_order())  # raises CycleError


def test_only_the_programs_import_the_command_line():
    front = {"femors_addon.cli", "femors_addon.commandline"}
    allowed = front | {"femors_addon.__main__", "operators.command"}
    for name, used in GRAPH.items():
        assert not used & front or name in allowed or name.startswith("femors_addon.cli_"), name


@pytest.mark.parametrize("path", WRITTEN, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_file_names_its_licence_and_says_what_it_is(path):
    text = path.read_text(encoding="utf-8")
    first = next(line for line in text.splitlines()[:2] if not line.startswith("#!"))
    assert first == "# SPDX-License-Identifier: GPL-3.0-or-later"
    assert ast.get_docstring(ast.parse(text))


def test_the_version_stands_in_the_manifest_only():
    manifest = ROOT / "blender_manifest.toml"
    version = tomllib.loads(manifest.read_text(encoding="utf-8"))["version"]
    assert "project" not in tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    for path in ALL:
        assert f'"{version}"' not in path.read_text(encoding="utf-8"), path
    assert f"## {version}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_licence_is_the_gpl():
    text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert "GNU GENERAL PUBLIC LICENSE" in text
    assert "Version 3, 29 June 2007" in text
    assert len(text.splitlines()) > 600


# --- settings -------------------------------------------------------------------------------------
def test_every_field_is_a_setting_with_words():
    specs = settings.specs(MorphSettings)
    assert list(specs) == [field.name for field in dataclasses.fields(MorphSettings)]
    for name, (field, spec) in specs.items():
        assert spec.label, name
        assert spec.help, name
        assert not spec.help.endswith("."), name
        assert type(field.default) in (bool, int, float, str), name
        assert isinstance(field.default, str) == bool(spec.choices), name
    assert len({spec.label for _, spec in specs.values()}) == len(specs)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_within_the_limits(name):
    settings.check(PRESETS[name])
    assert PRESETS[name].preset == name


def test_presets_are_the_choices():
    choices = settings.specs(MorphSettings)["preset"][1].choices
    assert [choice[0] for choice in choices] == list(PRESETS)


@pytest.mark.parametrize("name", settings.specs(MorphSettings))
def test_what_is_outside_the_limits_is_refused(name):
    field, spec = settings.specs(MorphSettings)[name]
    wrong: list[object] = ["nonsense"] if spec.choices else []
    if type(field.default) is float:
        wrong.append(float("nan"))
    wrong += [limit + step for limit, step in ((spec.minimum, -1), (spec.maximum, 1)) if limit is not None]
    for value in wrong:
        with pytest.raises(FemorsError, match=spec.label):
            settings.check(dataclasses.replace(MorphSettings(), **{name: value}))
