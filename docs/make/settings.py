# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of settings and the page of the command line, from the dataclasses and the parsers."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import pkgutil
from typing import Any

import femors_addon
from femors_addon import cli
from femors_addon.morph_settings import PRESETS, MorphSettings
from femors_addon.settings import Spec, specs

from .tables import cell, code, limits, number, table

UNITS = {"length": "a length, in the unit of the meshes", "factor": "", "angle": "an angle", "": ""}


def settings_classes() -> list[type]:
    """Return every dataclass of the core with settings of its own, by name of its module."""
    found = []
    for module in sorted(info.name for info in pkgutil.iter_modules(femors_addon.__path__)):
        if "settings" not in module:
            continue
        loaded = importlib.import_module(f"femors_addon.{module}")
        for value in vars(loaded).values():
            mine = getattr(value, "__module__", "") == loaded.__name__
            if mine and isinstance(value, type) and dataclasses.is_dataclass(value) and specs(value):
                found.append(value)
    return found


def settings_page() -> str:
    """Return the page of all settings, and of what the presets set."""
    text = (
        "Every setting stands once in the code; Blender's properties and the options of the command line "
        "are made from it, and so is this page. The option of `spread_start` is `--spread-start`; in "
        "Blender, operators take it as `spread_start=`.\n"
    )
    for cls in settings_classes():
        summary = (cls.__doc__ or "").strip().splitlines()[0]
        text += f"\n## {cls.__name__}\n\n{cell(summary)}\n\n"
        text += table(("Setting", "Name", "Default", "Limits", "What it does"), map(_row, specs(cls).items()))
        if cls is MorphSettings:
            text += (
                f"\n### Presets\n\nWhat each preset sets where it differs from *Standard*.\n\n{_presets()}"
            )
    return text


def _row(item: tuple[str, tuple[dataclasses.Field[Any], Spec]]) -> tuple[str, ...]:
    name, (field, spec) = item
    words = cell(spec.help)
    if spec.unit and UNITS[spec.unit]:
        words += f" ({UNITS[spec.unit]})"
    words += "".join(
        f"<br>{code(value)} **{cell(label)}**: {cell(help)}" for value, label, help in spec.choices
    )
    label = cell(spec.label) + (" *" if spec.advanced else "")
    return (
        label.replace(" *", " <small>(advanced)</small>"),
        code(name),
        code(number(field.default)),
        limits(spec.minimum, spec.maximum),
        words,
    )


def _presets() -> str:
    plain = PRESETS["standard"]
    names = [name for name in PRESETS if name != "standard"]
    rows = []
    for name in specs(MorphSettings):
        values = [getattr(PRESETS[preset], name) for preset in names]
        usual = getattr(plain, name)
        if name != "preset" and any(value != usual for value in values):
            shown = [code(number(value)) if value != usual else "" for value in values]
            rows.append((code(name), code(number(usual)), *shown))
    return table(("Setting", *(code(name) for name in ("standard", *names))), rows)


# --- the command line ---------------------------------------------------------------------------------
def command_page() -> str:
    """Return the page of all subcommands and their options."""
    text = (
        "`femors` stands for `python -m femors_addon`, or for `blender --command femors`. "
        "`femors --version` prints the version, `femors COMMAND --help` what is below.\n\n"
        "`-o OUTDIR` names a folder, which is made where it is missing, with those that it is in. Whatever "
        "else is written is a file in a folder that is there (or in that OUTDIR): a missing one is refused "
        "before the work begins, with exit code 2.\n"
    )
    parser = cli._parser("femors")
    for command in cli.COMMANDS:
        sub = subparser(parser, command.name)
        text += f"\n## femors {command.name}\n\n{cell(command.help)}\n\n"
        text += f"```text\nfemors {command.name} {command.usage}\n```\n"
        for group in sub._action_groups:
            actions = [action for action in group._group_actions if action.help != argparse.SUPPRESS]
            if not actions:
                continue
            title = {"positional arguments": "Arguments", "options": "Options"}.get(
                group.title or "", (group.title or "").capitalize()
            )
            text += f"\n### {title} of {command.name}\n\n"
            text += table(
                ("", "What"), [(code(_flags(action)), cell(_help(sub, action))) for action in actions]
            )
        text += f"\n### Exit codes of {command.name}\n\n"
        text += "\n".join(_codes(command.exit_codes)) + "\n"
    return text


def subparser(parser: argparse.ArgumentParser, name: str) -> argparse.ArgumentParser:
    """Return the parser of a subcommand."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            found: argparse.ArgumentParser = action.choices[name]
            return found
    raise KeyError(name)


def _flags(action: argparse.Action) -> str:
    if not action.option_strings:
        return str(action.metavar or action.dest)
    shown = ", ".join(action.option_strings)
    if action.nargs == 0:
        return shown
    metavar = action.metavar or action.dest.upper()
    return f"{shown} {' '.join(metavar) if isinstance(metavar, tuple) else metavar}"


def _help(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    return parser._get_formatter()._expand_help(action) if action.help else ""


def _codes(text: str) -> list[str]:
    """Return a list of the codes; the text has a number, then words, maybe over several lines."""
    rows: list[list[str]] = []
    rest: list[str] = []
    for line in text.splitlines()[1:]:
        first, _, words = line.strip().partition(" ")
        if first.isdigit():
            rows.append([first, words.strip()])
        elif line.startswith("  ") and rows and not rest:
            rows[-1][1] += " " + line.strip()
        elif line.strip():
            rest.append(line.strip())
    listed = [table(("Code", "Meaning"), [(code(number), cell(words)) for number, words in rows])]
    return [*listed, cell(" ".join(rest))]
