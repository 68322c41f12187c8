# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line, for ``python -m femors_addon`` and ``blender --command femors``."""

from __future__ import annotations

import argparse
import datetime
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from . import (
    cli_convert,
    cli_landmarks,
    cli_overclosure,
    cli_quality,
    cli_transfer,
    deckfiles,
    files,
    keptfield,
    landmarkfiles,
)
from .align import inverse, transformed
from .commandline import Console, Parser, add_settings, check_paths, settings_of
from .deck import Deck
from .deck_morph import morph_part
from .intersect import self_intersections
from .mesh import Surface, clean
from .meshfiles import MeshFile
from .morph import MorphResult, morph
from .morph_settings import PRESETS, MorphSettings
from .progress import FemorsError
from .report_figures import morph_figures
from .report_files import HELP, check_ending, report_bytes
from .report_html import Section
from .version import version
from .volume_morph import VolumeMorphResult

DONE, IMPERFECT, REFUSED, DEFECT, INTERRUPTED = 0, 1, 2, 3, 130

EXIT_CODES = """exit codes:
  0    done
  1    the result is written, but the morph did not converge, or the result has flipped
       faces or self-intersections that the source had not; or the mesh that was measured
       has faults; the reason is on stderr
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
        return args.command.run(args, console)
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


def _state(console: Console) -> str:
    return "the result is written" if console.written else "nothing is written"


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = Parser(
        prog=prog,
        description="Morph one mesh into the shape of another; push overlapping bodies apart.",
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
        sub.set_defaults(command=command, parser=sub)
    return parser


# --- morph ----------------------------------------------------------------------------------------
def _morph_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="SOURCE", help=f"what is to be morphed: {cli_convert.KINDS}")
    parser.add_argument("target", metavar="TARGET", help="what has the shape that it takes, of any such kind")
    parser.add_argument(
        *("-o", "--out"),
        metavar="OUT",
        required=True,
        help="the result, with the vertices and faces of SOURCE, or SOURCE's deck at new coordinates",
    )
    parser.add_argument(
        "--part",
        metavar="NAME",
        help="the part, element set or node set of SOURCE to be morphed, where a deck has several; or 'all'",
    )
    parser.add_argument("--target-part", metavar="NAME", help="the same of TARGET")
    parser.add_argument("--report", metavar="R", help=HELP)
    parser.add_argument(
        "--field", metavar="F.npz", help="the alignment and the displacement field, as NumPy arrays"
    )
    parser.add_argument("--source-landmarks", metavar="A.csv", help="points on SOURCE for the alignment, and")
    parser.add_argument(
        "--target-landmarks", metavar="B.csv", help="those on TARGET: x,y,z or name,x,y,z in each row"
    )
    add_settings(parser, MorphSettings, {"alignment": "--align"})


def _morph(args: argparse.Namespace, console: Console) -> int:
    """Morph SOURCE onto TARGET; all that can be refused is refused before the long computation."""
    settings = settings_of(args, PRESETS[getattr(args, "setting_preset", "standard")])
    landmarks = [path for path in (args.source_landmarks, args.target_landmarks) if path is not None]
    others = [path for path in (args.report, args.field) if path is not None]
    check_paths([args.source, args.target, *landmarks], [args.out, *others])
    deckfiles.suffix_of(args.out)
    if args.report is not None:
        check_ending(args.report)
    if args.field is not None:
        keptfield.check_ending(args.field)
    files.check_writable(args.out, *others)
    *pairs, names = _landmarks(landmarks)
    source, target = deckfiles.read(args.source), deckfiles.read(args.target)
    part = cli_convert.part_of(source, args.part, "--part")
    surface = cli_convert.surface_of(source, args.part, "--part")
    # an assembly's part is morphed where it stands: the target comes to the part's own coordinates
    home = inverse(cli_convert.placement_of(source, args.part, "--part"))
    stand = cli_convert.placement_of(target, args.target_part, "--target-part")
    aim = cli_convert.placed(home @ stand, cli_convert.surface_of(target, args.target_part, "--target-part"))
    ours, theirs = (None if points is None else transformed(home, points) for points in pairs)
    cli_convert.check_outputs(source, part, args.out, others)
    keywords: dict[str, Any] = {"source_landmarks": ours, "target_landmarks": theirs}
    if names:
        keywords["landmark_names"] = names
    thing: Deck | MeshFile
    result: MorphResult | VolumeMorphResult
    try:
        if isinstance(source, MeshFile):
            result = morph(surface, aim, settings, console.progress, **keywords)
            thing = source.with_vertices(result.vertices)
        else:
            assert part is not None
            thing, result = morph_part(source, part, aim, settings, console.progress, morph=morph, **keywords)
    except FemorsError as error:
        raise FemorsError(_with_file(str(error), args)) from None
    console.end_progress()
    figures = result.surface if isinstance(result, VolumeMorphResult) else result
    faults = _faults(figures, surface)
    written = deckfiles.written(thing, args.out)
    outputs = [*written.files, *others]
    with files.replacing(*outputs) as new:
        paths = dict(zip(outputs, new, strict=True))
        for path, data in written.files.items():
            paths[path].write_bytes(data)
        if args.report is not None:
            title = f"Morph of {Path(args.source).name} to {Path(args.target).name}"
            report = _report(args, result, faults)
            data = report_bytes(args.report, report, title, lambda: _figures(surface, aim, figures))
            paths[args.report].write_bytes(data)
        if args.field is not None:
            date = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
            names = (Path(args.source).stem, Path(args.target).stem)
            # an assembly's part was morphed in its own coordinates; other things stand in the assembly's
            figures.kept(*names, date).placed(inverse(home)).save(paths[args.field])
    console.written = True
    if not args.quiet:
        if np.linalg.det(figures.transform[:3, :3]) < 0:  # only surfaces get here: volumes refuse
            console.warn(
                "note: mirrored; faces keep their corners' order, so their inner and outer sides are swapped"
            )
        warnings = (_with_file(text, args) for text in figures.warnings)
        for warning in (*getattr(thing, "notes", ()), *warnings, *written.notes):
            if warning not in faults:
                console.warn(f"note: {warning}")
    console.say(result.summary())
    for fault in faults:
        console.warn(f"{fault}; the result is written")
    return IMPERFECT if faults else DONE


def _landmarks(paths: list[str]) -> tuple[Any, Any, Any]:
    """Return the two files' landmarks in pairs, and their names; or nothing where no file is given."""
    if not paths:
        return None, None, None
    if len(paths) == 1:
        raise FemorsError("--source-landmarks and --target-landmarks go together; only one is given")
    source, target = map(landmarkfiles.read, paths)
    return *landmarkfiles.paired(source, target), source.names


def _with_file(text: str, args: argparse.Namespace) -> str:
    """Name the file in a message of the core about the "source" or the "target"."""
    for role in ("source", "target"):
        if text.startswith(f"{role}: "):
            return getattr(args, role) + text[len(role) :]
    return text


def _faults(result: MorphResult, source: Surface) -> list[str]:
    """Return why a result is not to be trusted blindly, in words."""
    faults = [] if result.converged else [result.stop_reason]
    faults += [] if result.steering is None else result.steering.faults
    if result.after.flipped:
        faults.append(f"{result.after.flipped} faces of the result are flipped")
    after = result.after.self_intersecting
    # of the source itself: its aligned positions are rounded, and faces that touch may then cross
    before = after and len(np.unique(self_intersections(clean(source.vertices, source.faces).surface)))
    if after > before:
        faults.append(f"{after} faces of the result cross others of it, and {before} did in the source")
    return faults


def _figures(surface: Surface, aim: Surface, figures: MorphResult) -> list[Section]:
    """Return a report's pictures; all in the place of the target."""
    aligned = surface.moved(transformed(figures.transform, surface.vertices))
    values = {"displacement": figures.displacement, "surface_distance": figures.surface_distance}
    return morph_figures(aligned, surface.moved(figures.vertices), aim, values)


def _report(
    args: argparse.Namespace, result: MorphResult | VolumeMorphResult, faults: list[str]
) -> dict[str, Any]:
    names = {"source": args.source, "target": args.target, "out": args.out, "field": args.field}
    report = {"femors": version(), "files": names, "faults": faults, **result.report()}
    report["warnings"] = [_with_file(text, args) for text in report["warnings"]]
    return report


COMMANDS = (
    Command(
        name="morph",
        usage="SOURCE TARGET -o OUT [options]",
        help="Morph SOURCE into the shape of TARGET.",
        options=_morph_options,
        run=_morph,
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
    ),
    Command(
        name="transfer",
        usage="FIELD.npz INPUT... -o OUTDIR [options]",
        help="Carry meshes, decks and landmarks by the field of a morph.",
        options=cli_transfer.options,
        run=cli_transfer.run,
        exit_codes=cli_transfer.EXIT_CODES,
    ),
    Command(
        name="landmarks",
        usage="TEMPLATE TARGET TEMPLATE.csv -o OUT.csv [options]",
        help="Find the landmarks of one mesh, or of several, on TARGET: morph, and carry them along.",
        options=cli_landmarks.options,
        run=cli_landmarks.run,
        exit_codes=cli_transfer.EXIT_CODES,
    ),
    Command(
        name="overclosure",
        usage="BODY... -o OUTDIR [options]",
        help="Push bodies that overlap apart to a least gap, or only check them.",
        options=cli_overclosure.options,
        run=lambda args, console: cli_overclosure.run(args, console, version()),
        exit_codes=cli_overclosure.EXIT_CODES,
    ),
)
"""Every subcommand; a new one is a function for its options, one that runs it, and a line here."""

if __name__ == "__main__":
    sys.exit(main())
