# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of the Python API: which modules there are, and where mkdocstrings reads the docstrings."""

from __future__ import annotations

import ast
from pathlib import Path

from .messages import subject
from .tables import cell, code, table

PUBLIC = (
    *("mesh", "cleaning", "morph", "morph_settings", "morph_result", "align", "transforms", "grnn"),
    *("keptfield", "carry", "transfer", "landmarks", "landmarkfiles", "regions"),
    *("overclosure", "bodies", "overclosure_settings", "overclosure_result"),
    *("overclosure_check", "findings"),
    *("deckfiles", "deck", "deck_morph", "meshfiles", "volume", "volume_morph"),
    *("quality", "examine", "volume_quality", "nearest", "intersect", "progress", "settings", "shapes"),
)
"""The modules that scripts are meant to use, in the order of the page."""


def api_page(root: Path) -> str:
    """Return the page, for mkdocstrings to fill in."""
    text = (
        "The core needs NumPy and SciPy, never Blender. Arrays are float64 and int32; lengths are in the "
        "meshes' own unit. What a user can cause raises `FemorsError`. Examples are in "
        "[Python scripts](../howto/python.md).\n\n"
    )
    modules = sorted((root / "femors_addon").glob("*.py"))
    rows = []
    for path in modules:
        name = path.stem
        if name.startswith("__"):
            continue
        link = f"[{code(name)}](#femors_addon.{name})" if name in PUBLIC else code(name)
        rows.append((link, cell(subject(root, f"femors_addon/{path.name}"))))
    text += table(("Module", "What"), rows)
    for name in PUBLIC:
        if (root / "femors_addon" / f"{name}.py").exists():
            text += f"\n::: femors_addon.{name}\n"
    return text


def public_names(path: Path) -> list[str]:
    """Return the functions and classes that a module offers."""
    kinds = (ast.FunctionDef, ast.ClassDef)
    body = ast.parse(path.read_text(encoding="utf-8")).body
    return [node.name for node in body if isinstance(node, kinds) and not node.name.startswith("_")]
