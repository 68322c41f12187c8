# SPDX-License-Identifier: GPL-3.0-or-later
"""What every subcommand shares: a parser that raises, options made from settings, and the console."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import difflib
import io
import os
import shutil
import sys
import time
import traceback
import typing
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, NoReturn, TextIO, TypeVar

from .files import Location
from .progress import FemorsError, Progress, silent
from .settings import Spec, check, specs

Settings = TypeVar("Settings")
FOLDER = "a folder, made where it is missing; outputs keep the inputs' names"
"""What is said of ``-o OUTDIR``."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose usage errors are `FemorsError`: one line, and no exit of the process.

    An option or a command that is not there is answered with the one that was probably meant.
    """

    _given: Sequence[str] = ()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, and remember what was given, for what is said of it."""
        self._given = list(sys.argv[1:] if args is None else args)
        return super().parse_known_args(self._given, namespace)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            names = list(action.choices)
            meant = like(str(value), names) or f"choose from {', '.join(names)}"
            raise argparse.ArgumentError(action, f"invalid choice: '{value}'; {meant}")

    def error(self, message: str) -> NoReturn:
        """Raise the usage error; a misspelt option comes first, for others may follow from it."""
        known = [name for name in self._option_string_actions if name.startswith("--")]
        for name in self._unknown():
            if meant := like(name, known):
                message = f"unrecognized arguments: {name}; {meant}"
                break
        raise FemorsError(f"{message} (see '{self.prog} --help')")

    def _unknown(self) -> list[str]:
        """Return what was given as a long option, with one dash or two, and is none of this parser."""
        found = []
        for text in self._given:
            name = text.partition("=")[0]
            if self._subparsers is not None and not name.startswith("-"):
                break  # what follows is the command's
            known = self._option_string_actions
            short = f"-{name}" in known  # -out for --out
            if len(name) > 2 and (short or (name.startswith("--") and name not in known)):
                found.append(name)
        return found


def like(name: str, known: Iterable[str]) -> str:
    """Return the question "did you mean ...?" with what is most like a name, or ""."""
    near = difflib.get_close_matches(name.lower(), list(known), n=1)
    return f"did you mean {near[0]}?" if near else ""


def add_settings(parser: argparse.ArgumentParser, cls: type, aliases: Mapping[str, str]) -> None:
    """Add an option for every setting of a dataclass, named like it (``--spread-start``).

    Options that are not given leave no trace, so that a preset's value can stand. `aliases` gives
    settings a second, shorter option.
    """
    kinds = typing.get_type_hints(cls)
    for name, (field, spec) in specs(cls).items():
        flags = [_flag(name)]
        if name in aliases:
            flags.insert(0, aliases[name])
        group = _group(parser, spec.advanced)
        options: dict[str, Any] = {"help": _help(spec, field.default)}
        if spec.choices:
            options |= {"choices": [choice[0] for choice in spec.choices], "metavar": "KIND"}
        elif kinds[name] is bool:
            options["action"] = argparse.BooleanOptionalAction
        else:
            options |= {"type": kinds[name], "metavar": kinds[name].__name__.upper()}
        group.add_argument(*flags, dest=_destination(name), default=argparse.SUPPRESS, **options)


def _group(parser: argparse.ArgumentParser, advanced: bool) -> argparse._ArgumentGroup:
    """Return the group of options that a setting belongs to; made for the first one that does."""
    title = "advanced" if advanced else "settings"
    words = "for special cases; the defaults need no tuning" if advanced else None
    made = next((group for group in parser._action_groups if group.title == title), None)
    return made or parser.add_argument_group(title, words)


def settings_of(args: argparse.Namespace, base: Settings) -> Settings:
    """Return the settings with what the command line says instead of the base's values; checked."""
    given = {
        name: getattr(args, _destination(name))
        for name in specs(type(base))
        if hasattr(args, _destination(name))
    }
    settings = dataclasses.replace(base, **given)  # type: ignore[type-var]
    check(settings, _flag)
    return settings


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _destination(name: str) -> str:
    return f"setting_{name}"


def _help(spec: Spec, default: Any) -> str:
    notes = [
        f"default {default}" if not isinstance(default, bool) else f"default {'on' if default else 'off'}"
    ]
    if spec.minimum is not None or spec.maximum is not None:
        low = "" if spec.minimum is None else f"from {spec.minimum:g} "
        high = "" if spec.maximum is None else f"to {spec.maximum:g}"
        notes.insert(0, (low + high).strip())
    if spec.unit == "length":
        notes.insert(0, "a length in the files' unit")
    kinds = "".join(f"; {value} = {help}" for value, _, help in spec.choices)
    text = f"{spec.help}{kinds} ({', '.join(notes)})"
    return text.replace("%", "%%")


def check_paths(inputs: Iterable[Location], outputs: Collection[Location]) -> None:
    """Raise `FemorsError` where an output is one of the inputs, or two outputs are the same file."""
    read = {os.path.realpath(path) for path in inputs}
    seen: set[str] = set()
    for path in outputs:
        real = os.path.realpath(path)
        if real in read or any(_same(real, other) for other in read):
            raise FemorsError(f"{path}: is also an input; choose another name for the output")
        if real in seen:
            raise FemorsError(f"{path}: is named for two outputs")
        seen.add(real)


def _same(one: str, two: str) -> bool:
    try:
        return os.path.samefile(one, two)
    except OSError:  # one of them is not there, so they are not the same file
        return False


TICKS = {
    "tick Convert units": "pass --fix-units",
    "set Overlap to Source is part": "pass --partial source",
    "set Overlap to Target is part": "pass --partial target",
    "set Overlap": "pass --partial source (or target)",
    "tick Mirror if better": "pass --fix-mirror",
    "or give landmarks": "or pass --source-landmarks and --target-landmarks",
    "the limit in the preferences": "the limit of --memory",
    "or set the axes of the meshes": "or set the axes of the meshes (--space)",
    "go the other way (inverse)": "go the other way (pass --inverse)",
    "go the other way (without inverse)": "go the other way (leave out --inverse)",
}


def for_command(text: str) -> str:
    """Return a sentence of the core with options of the command line for the panel's ticks."""
    for tick, option in TICKS.items():
        text = text.replace(tick, option)
    return text


class Console:
    """Progress and complaints on stderr, results on stdout.

    A reader that goes away (``femors ... | head -1``) ends what is said, not what is done.

    Attributes
    ----------
    written : bool
        Whether the results are in their files.
    lost : str
        Why some of what belongs on stdout is not there, such as a disk that is full; "" where it is. A reader
        that has gone away has read enough.
    """

    def __init__(self, quiet: bool = False, out: TextIO | None = None, err: TextIO | None = None) -> None:
        self.quiet = quiet
        self.written = False
        self.out = out or sys.stdout or io.StringIO()  # None where the process was started without
        self.err = err or sys.stderr or io.StringIO()
        self.lost = ""
        self._line = ""  # what stands on the terminal's last line
        self._shown = (0, time.monotonic())  # the tenth of the work, and when it was written

    @property
    def progress(self) -> Progress:
        """Where a computation reports to."""
        return silent if self.quiet else self._progress

    def _progress(self, fraction: float, text: str) -> None:
        """Rewrite one line of a terminal; elsewhere write a line per tenth, at most one a second.

        Nothing is written for the start: input that is refused at once gives one line, the refusal.
        """
        tenth, now = int(10 * fraction), time.monotonic()
        line = f"{100 * fraction:3.0f} %  {text}"
        if self.err.isatty():
            line = line[: shutil.get_terminal_size().columns - 1]  # a line that wraps cannot be rewritten
            if line != self._line:
                self._put(self.err, "\r" + line.ljust(len(self._line)))
                self._line = line
        elif tenth > self._shown[0] and now - self._shown[1] >= 1.0:
            self._put(self.err, line + "\n")
            self._shown = (tenth, now)

    def end_progress(self) -> None:
        """Leave the terminal's line of progress, so that what follows starts on its own."""
        if self._line:
            self._put(self.err, "\r" + " " * len(self._line) + "\r")
            self._line = ""

    def say(self, text: str) -> None:
        """Write a result, unless told to be quiet."""
        if not self.quiet:
            self._put(self.out, text + "\n")

    def warn(self, text: str) -> None:
        """Write one line of warning or complaint, quiet or not."""
        self.end_progress()
        self._put(self.err, f"femors: {for_command(' '.join(text.split()))}\n")

    def warn_of_defect(self, text: str) -> None:
        """Write the traceback of the exception that is being handled, and one line below it."""
        self.end_progress()
        self._put(self.err, traceback.format_exc())
        self.warn(text)

    def close(self) -> None:
        """End the line of progress, and hand over what others have printed (argparse, traceback)."""
        self.end_progress()
        for stream in (self.out, self.err):
            self._put(stream, "")

    def _put(self, stream: TextIO, text: str) -> None:
        """Write and flush; where that cannot be, lead what follows into nothing: the work goes on."""
        try:
            stream.write(text)
            stream.flush()
        except OSError as error:
            if stream is self.out and not isinstance(error, BrokenPipeError):
                self.lost = (error.strerror or str(error)).lower()
            # Python flushes once more when it ends, and would complain and change the exit code
            with contextlib.suppress(OSError, ValueError):  # a stream without a file behind it
                descriptor = stream.fileno()
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, descriptor)
                os.close(null)
