# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line, for ``python -m femors_addon`` and ``blender --command femors``."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from . import cli_convert, cli_landmarks, cli_morph, cli_overclosure, cli_quality, cli_transfer
from .commandline import Console, Parser
from .limits import MB, Limits, allow
from .progress import FemorsError
from .version import version

IMPERFECT, REFUSED, DEFECT, INTERRUPTED = 1, 2, 3, 130

EXIT_CODES = """exit codes:
  0    done
  2    bad input or usage: one line on stderr, nothing is written
  3    a defect of FEMORS: a traceback to be reported; its last line says if anything is written
  130  interrupted (Ctrl-C); the last line says if anything is written
"""


class Command(NamedTuple):
    """A subcommand: its name and arguments, what it does in a line, its options, and its function."""

    name: str
    usage: str
    help: str
    options: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace, Console], int]
    exit_codes: str = EXIT_CODES


def main(argv: Sequence[str] | None = None, prog: str = "femors") -> int:
    """Run a command line and return its exit code; never raises for what a user can cause.

    Parameters
    ----------
    argv : sequence of str, optional
        The arguments behind the program's name; those of the process where left out.
    prog : str
        What the program is called in the help.
    """
    console = Console()
    try:
        parser = _parser(prog)
        try:
            args, unknown = parser.parse_known_args(argv)
        except SystemExit as stop:  # --help and --version end so
            return int(stop.code or 0)
        if unknown:  # the help of the command that was meant is the one to look at
            getattr(args, "parser", parser).error(f"unrecognized arguments: {' '.join(unknown)}")
        if args.command is None:
            parser.error(f"a command is needed: {', '.join(command.name for command in COMMANDS)}")
        console = Console(args.quiet)
        with _allowed(args.threads, args.memory):
            code = args.command.run(args, console)
        if console.lost:
            done = "; the result is written" if console.written else ""
            console.warn(f"the figures could not be written to stdout ({console.lost}){done}")
        return code or (IMPERFECT if console.lost else 0)
    except FemorsError as error:
        console.warn(str(error))
        return REFUSED
    except MemoryError:
        console.warn("not enough memory for meshes of this size; reduce them first")
        return REFUSED
    except KeyboardInterrupt:
        console.warn(f"interrupted; {_state(console)}")
        return INTERRUPTED
    except Exception:
        console.end_progress()
        console.warn_of_defect(
            f"this is a defect of FEMORS, and {_state(console)}; please report it with the lines above"
        )
        return DEFECT
    finally:
        console.close()


@contextlib.contextmanager
def _allowed(threads: int | None, memory: float | None) -> Iterator[None]:
    """Keep to these limits for a while; what is not given stays, as Blender's preferences have it."""
    if (threads or 0) < 0 or not (memory or 0.0) >= 0:
        raise FemorsError("--threads and --memory must be 0 or more")
    before = Limits.threads, Limits.memory
    allow(
        Limits.threads if threads is None else threads,
        Limits.memory / MB if memory is None else memory,
    )
    try:
        yield
    finally:
        Limits.threads, Limits.memory = before


def _state(console: Console) -> str:
    return "the result is written" if console.written else "nothing is written"


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = Parser(
        prog=prog,
        description="Morph meshes into the shape of others, carry landmarks, push overlapping bodies apart.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"FEMORS {version()}")
    parser.set_defaults(command=None)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for command in COMMANDS:
        sub = commands.add_parser(
            command.name,
            help=command.help,
            usage=f"{prog} {command.name} {command.usage}",
            description=command.help,
            epilog=command.exit_codes,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        command.options(sub)
        sub.add_argument(
            "--quiet",
            action="store_true",
            help="no progress, notes or summary; reasons for codes 1 and 2 only",
        )
        sub.add_argument(
            "--threads",
            type=int,
            metavar="N",
            help="how many processors may be used at once, 0 for all; results do not depend on it (1)",
        )
        sub.add_argument(
            "--memory",
            type=float,
            metavar="MB",
            help="refuse what is estimated to need more, before it begins; 0 for no limit (0)",
        )
        sub.set_defaults(command=command, parser=sub)
    return parser


def _with_code_1(*lines: str) -> str:
    """Return the exit codes with the one that says that something is imperfect."""
    head, zero, *rest = EXIT_CODES.splitlines()
    one = [f"  {'1' if not number else ' '}    {line}" for number, line in enumerate(lines)]
    return "\n".join((head, zero, *one, *rest)) + "\n"


COMMANDS = (
    Command(
        name="morph",
        usage="SOURCE TARGET -o OUT [options]",
        help="Morph SOURCE into the shape of TARGET.",
        options=cli_morph.options,
        run=cli_morph.run,
        exit_codes=_with_code_1(
            "the result is written, but the morph did not converge, or the result has flipped",
            "faces or self-intersections that the source had not; the reason is on stderr",
        ),
    ),
    Command(
        name="convert",
        usage="IN -o OUT [options]",
        help="Write IN in the format that OUT's name says; in its own format it stays as it is.",
        options=cli_convert.options,
        run=cli_convert.run,
    ),
    Command(
        name="quality",
        usage="MESH [OTHER] [options]",
        help="Measure MESH: shapes of its faces, faults, volume, and its distance from OTHER.",
        options=cli_quality.options,
        run=cli_quality.run,
        exit_codes=_with_code_1(
            "measured, and faces cross others, are folded over or have no area, or elements are",
            "inverted: the reason is on stderr",
        ),
    ),
    Command(
        name="transfer",
        usage="FIELD.npz INPUT... -o OUTDIR [options]",
        help="Carry meshes, decks and landmarks by the field of a morph.",
        options=cli_transfer.options,
        run=cli_transfer.run,
        exit_codes=_with_code_1(
            "the result is written, but nothing was within the field's reach, or the input lay there already",
            "or seems to be in another unit; the reason is on stderr",
        ),
    ),
    Command(
        name="landmarks",
        usage="TEMPLATE TARGET TEMPLATE.csv -o OUT.csv [options]",
        help="Find the landmarks of one mesh, or of several, on TARGET: morph, and carry them along.",
        options=cli_landmarks.options,
        run=cli_landmarks.run,
        exit_codes=_with_code_1(
            "the result is written, but a template's morph did not converge, or has faces that fold over or",
            "cross others, or its landmarks are out of its reach or seem to be in another unit, or those",
            "that are known do not fit; the reason is on stderr",
        ),
    ),
    Command(
        name="overclosure",
        usage="BODY... -o OUTDIR [options]",
        help="Push bodies that overlap apart, nodes to a least gap, or only check them.",
        options=cli_overclosure.options,
        run=lambda args, console: cli_overclosure.run(args, console, version()),
        exit_codes=cli_overclosure.EXIT_CODES,
    ),
)
"""Every subcommand; a new one is a function for its options, one that runs it, and a line here."""

if __name__ == "__main__":
    sys.exit(main())
