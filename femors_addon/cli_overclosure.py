# SPDX-License-Identifier: GPL-3.0-or-later
"""``femors overclosure``: files in, bodies pushed apart, the same files out."""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from . import cli_bodies, cli_convert, deckfiles, files
from .bodies import Body
from .commandline import FOLDER, Console, add_settings, check_paths, settings_of
from .deck import Deck
from .meshfiles import MeshFile
from .overclosure import OverclosureResult, check_overclosure, remove_overclosure
from .overclosure_settings import OverclosureSettings
from .progress import FemorsError, counted
from .report_files import HELP, check_ending, report_bytes
from .report_html import Section
from .report_overclosure import overclosure_figures

DONE, IMPERFECT = 0, 1

EXIT_CODES = """exit codes:
  0    certified: nothing crosses, every node keeps the gap to the surfaces of the other bodies
       (edges may be nearer each other, and mid-side nodes of quadratic elements: a note says how
       near), no element was inverted, or there was nothing to do;
       with --check: nothing overlaps and every node keeps the gap, with the same exceptions
  1    not reached: the best state is written, the reason is on stderr; with --check: bodies
       overlap or are too near
  2    bad input or usage: one line on stderr, nothing is written
  3    a defect of FEMORS: a traceback to be reported; its last line says if anything is written
  130  interrupted (Ctrl-C); the last line says if anything is written

A deck of several parts (or solid element sets) gives one body for each, named STEM:PART, and comes
back as one deck; any other file gives one body, named as the file without its ending. In the options
STEM stands for all parts of its deck.
"""


def options(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``femors overclosure``."""
    parser.add_argument("sources", metavar="BODY", nargs="+", help=f"files of bodies: {cli_convert.KINDS}")
    parser.add_argument("-o", "--out", metavar="OUTDIR", help=FOLDER)
    parser.add_argument(
        "--rigid",
        metavar="NAME",
        action="append",
        default=[],
        help="a body that does not move; may be repeated",
    )
    parser.add_argument(
        "--share",
        metavar="NAME=S",
        action="append",
        default=[],
        help="how much a body gives way, from 0 (rigid) to 1; of a pair, each moves by its part of the sum, "
        "and the other of two bodies has 1 - S",
    )
    parser.add_argument(
        "--exclude",
        metavar="A,B",
        action="append",
        default=[],
        help="a pair that may overlap, such as a tied cartilage on its bone; may be repeated",
    )
    parser.add_argument(
        "--pair-gap",
        metavar="A,B=G",
        action="append",
        default=[],
        help="a gap of its own for one pair; may be repeated",
    )
    parser.add_argument(
        "--check",
        action="store_true",
        help="only say which bodies overlap, how deep and where (then exit code 1); move nothing",
    )
    parser.add_argument("--report", metavar="R", help="pairs, bodies, " + HELP)
    add_settings(parser, OverclosureSettings, {})


def run(args: argparse.Namespace, console: Console, version: str) -> int:
    """Check or remove the overclosure of all bodies; refuse what can be refused before the work."""
    settings = settings_of(args, OverclosureSettings())
    if args.out is None and not args.check:
        raise FemorsError("-o OUTDIR is needed, or --check (see 'femors overclosure --help')")
    if args.out is not None and args.check:
        raise FemorsError("--check moves nothing, and so writes no bodies: leave out -o, or --check")
    outputs = _output_paths(args)
    sources = [cli_bodies.read(path) for path in args.sources]
    bodies = cli_bodies.with_shares([body for source in sources for body in source.bodies], args)
    names = [body.name for body in bodies]
    exclude, gaps = cli_bodies.pairs_asked(args, names)
    if args.check:
        return _check(args, console, version, bodies, settings, exclude, gaps)
    result = remove_overclosure(bodies, settings, console.progress, exclude=exclude, gaps=gaps)
    console.end_progress()
    _write(args, console, version, sources, outputs, bodies, exclude, result)
    return DONE if result.certified else IMPERFECT


def _check(
    args: argparse.Namespace,
    console: Console,
    version: str,
    bodies: list[Body],
    settings: OverclosureSettings,
    exclude: list[tuple[str, str]],
    gaps: dict[tuple[str, str], float],
) -> int:
    """Say what overlaps; write nothing but the report."""
    notes: list[str] = []
    options: dict[str, Any] = {"exclude": exclude, "gaps": gaps, "tell": notes.append}
    found = check_overclosure(bodies, settings, console.progress, **options)
    console.end_progress()
    bad = sum(not finding.clear for finding in found)
    spared = f" ({counted(len(exclude), 'excluded pair')} not looked at)" if exclude else ""
    words = counted(bad, "pair overlaps or is too near", "pairs overlap or are too near")
    verdict = (words if bad else f"no overclosure among {len(bodies)} bodies") + spared
    if args.report is not None:
        names = {"bodies": [body.name for body in bodies], "sources": args.sources}
        pairs = [finding.as_dict() for finding in found]
        report = {"femors": version, "files": names, "clear": not bad, "verdict": verdict, "pairs": pairs}
        report["excluded"] = [{"one": one, "two": two} for one, two in exclude]
        report["warnings"] = notes
        report["settings"] = {"gap": settings.gap}
        deepest = max((finding.depth for finding in found), default=0.0)
        figures = functools.partial(overclosure_figures, bodies, None, deepest, exclude)
        files.write_bytes(args.report, _encoded(args, len(bodies), report, figures))
        console.written = True
    for finding in found:
        console.say(str(finding))
    (console.warn if bad else console.say)(verdict)
    for note in () if args.quiet else notes:  # last: one may say what the line above is worth
        console.warn(f"note: {note}")
    return IMPERFECT if bad else DONE


def _write(
    args: argparse.Namespace,
    console: Console,
    version: str,
    sources: list[cli_bodies.Source],
    outputs: list[Path],
    bodies: list[Body],
    exclude: list[tuple[str, str]],
    result: OverclosureResult,
) -> None:
    """Write every file, under its own name, and the report."""
    nodes = {body.name: body.nodes for body in result.bodies}
    moved = {body.name for body in result.bodies if body.moved}
    written: dict[Path, bytes] = {}
    notes: list[str] = []
    for source, path in zip(sources, outputs, strict=True):
        if isinstance(source.thing, MeshFile) and source.bodies[0].name not in moved:
            written[path] = files.read_bytes(source.path)
            continue
        parts = deckfiles.written(source.moved(nodes), path)
        written |= parts.files
        notes += [*getattr(source.thing, "notes", ()), *parts.notes]
    report = [] if args.report is None else [Path(args.report)]
    check_paths(_inputs(sources), [*written, *report])
    with files.folder_for(args.out), files.replacing(*written, *report) as new:
        for temporary, data in zip(
            new,
            [*written.values(), *(_report(args, version, bodies, exclude, result) for _ in report)],
            strict=True,
        ):
            temporary.write_bytes(data)
    console.written = True
    if not args.quiet:
        for note in (*notes, *result.notes):
            console.warn(f"note: {note}")
    console.say(result.summary())
    for loss in result.losses:
        console.warn(f"WARNING: {loss}")
    state = "nothing was moved" if result.untouched else "the best state is written"
    for reason in result.reasons:
        console.warn(f"not reached: {reason}; {state}")


def _report(
    args: argparse.Namespace,
    version: str,
    bodies: list[Body],
    exclude: list[tuple[str, str]],
    result: OverclosureResult,
) -> bytes:
    names = {"sources": args.sources, "out": args.out}
    deepest = max((finding.depth for finding in result.before), default=0.0)
    after = None if result.untouched else {body.name: body.nodes for body in result.bodies}
    figures = functools.partial(overclosure_figures, bodies, after, deepest, exclude)
    return _encoded(args, len(bodies), {"femors": version, "files": names, **result.report()}, figures)


def _encoded(
    args: argparse.Namespace, count: int, report: Mapping[str, Any], figures: Callable[[], list[Section]]
) -> bytes:
    return report_bytes(args.report, report, f"Overclosure of {count} bodies", figures)


# --- what is asked for --------------------------------------------------------------------------------
def _output_paths(args: argparse.Namespace) -> list[Path]:
    """Return where each file goes; refuse names that clash and folders that cannot be written to."""
    for path in args.sources:
        deckfiles.suffix_of(path)
    if args.report is not None:
        check_ending(args.report)
        check_paths(args.sources, [args.report])
        fresh = args.out is not None and not Path(args.out).exists()
        if not (fresh and Path(args.report).parent == Path(args.out)):  # that folder is made with the rest
            files.check_writable(args.report)
    if args.out is None:
        return []
    folder = Path(args.out)
    files.check_folder(folder)
    paths = [folder / Path(path).name for path in args.sources]
    check_paths(args.sources, paths)
    if folder.exists():
        files.check_writable(*paths)
    return paths


def _inputs(sources: list[cli_bodies.Source]) -> list[Path]:
    found = [
        source.thing.inputs if isinstance(source.thing, Deck) else [Path(source.path)] for source in sources
    ]
    return [path for paths in found for path in paths]
