# SPDX-License-Identifier: GPL-3.0-or-later
"""Every message that FEMORS refuses input with, collected from the code."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from .tables import cell

ROOMS = ("femors_addon", "operators")
GAP = "…"
"""Stands for what a message fills in."""


def collected(root: Path) -> dict[str, list[str]]:
    """Return the messages of each module that raises any: what is given to `FemorsError`."""
    found: dict[str, list[str]] = {}
    for room in ROOMS:
        for path in sorted((root / room).rglob("*.py")):
            texts = list(dict.fromkeys(_of(path)))
            if texts:
                found[path.relative_to(root).as_posix()] = texts
    return found


def _of(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "FemorsError" and node.args:
            text = _text(node.args[0])
            if sum(character.isalpha() for character in text) > 4:  # not one that passes another on
                yield text


def _text(node: ast.expr) -> str:
    """Return a string as far as it can be read off, with gaps."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(part) for part in node.values)
    if isinstance(node, ast.FormattedValue):
        return _text(node.value) if isinstance(node.value, ast.Call) else GAP
    if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "counted":
        one, many = node.args[1], node.args[-1]
        return f"{GAP} {_text(many)}{'s' if one is many else ''}"
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _text(node.left) + _text(node.right)
    return GAP


def subject(root: Path, module: str) -> str:
    """Return what a module is about: the first sentence of its docstring."""
    words = ast.get_docstring(ast.parse((root / module).read_text(encoding="utf-8"))) or module
    return words.split("\n\n")[0].replace("\n", " ").rstrip(".")


def messages_page(root: Path) -> str:
    """Return the page."""
    text = (
        "Whatever a user can cause ends in one line that says what is wrong and what to do. These are all of "
        f"them, as the code has them; {GAP} stands for a name or a number. "
        "[Troubleshooting](../troubleshooting.md) says more about the common ones.\n"
    )
    for module, texts in collected(root).items():
        text += f"\n## {cell(module)}\n\n{cell(subject(root, module))}.\n\n"
        text += "\n".join(f"- {cell(line)}" for line in texts) + "\n"
    return text
