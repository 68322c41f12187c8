# SPDX-License-Identifier: GPL-3.0-or-later
"""``femors morph``: one mesh, or a part of a deck, into the shape of another."""

from __future__ import annotations

import argparse
import datetime
from pathlib import Path
from typing import Any

import numpy as np

from . import cli_convert, deckfiles, files, keptfield, landmarkfiles
from .cleaning import clean
from .commandline import Console, add_settings, check_paths, settings_of
from .deck import Deck
from .deck_morph import morph_part
from .intersect import self_intersections
from .mesh import Float, Surface
from .meshfiles import MeshFile
from .morph import MorphResult, morph
from .morph_settings import PRESETS, MorphSettings
from .progress import FemorsError, counted
from .report_figures import morph_figures
from .report_files import HELP, check_ending, report_bytes
from .report_html import Section
from .transforms import inverse, transformed
from .version import version
from .volume_morph import VolumeMorphResult

DONE, IMPERFECT = 0, 1


def options(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``femors morph``."""
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
    parser.add_argument("--target-landmarks", metavar="B.csv", help=f"those on TARGET: {landmarkfiles.MARKS}")
    add_settings(parser, MorphSettings, {"alignment": "--align"})


def run(args: argparse.Namespace, console: Console) -> int:
    """Morph SOURCE onto TARGET; all that can be refused is refused before the long computation."""
    settings = settings_of(args, PRESETS[getattr(args, "setting_preset", "standard")])
    landmarks = [path for path in (args.source_landmarks, args.target_landmarks) if path is not None]
    others = [path for path in (args.report, args.field) if path is not None]
    _check_outputs(args, landmarks, others)
    pairs = _landmarks(landmarks)
    source, target = deckfiles.read(args.source), deckfiles.read(args.target)
    part = cli_convert.part_of(source, args.part, "--part")
    surface = cli_convert.surface_of(source, args.part, "--part")
    # an assembly's part is morphed where it stands: the target comes to the part's own coordinates
    home = inverse(cli_convert.placement_of(source, args.part, "--part"))
    stand = cli_convert.placement_of(target, args.target_part, "--target-part")
    aim = cli_convert.placed(home @ stand, cli_convert.surface_of(target, args.target_part, "--target-part"))
    cli_convert.check_outputs(source, part, args.out, others)
    keywords: dict[str, Any] = {}
    if pairs is not None:
        keywords["source_landmarks"] = transformed(home, pairs.source)
        keywords["target_landmarks"] = transformed(home, pairs.target)
        keywords["landmark_names"] = pairs.names or None
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
    alone = [] if pairs is None else pairs.notes
    notes = [*alone, *_write(args, thing, result, faults, alone, (surface, aim), inverse(home))]
    console.written = True
    if not args.quiet:
        for note in notes:
            if note not in faults:
                console.warn(f"note: {note}")
    console.say(result.summary())
    for fault in faults:
        console.warn(f"{fault}; the result is written")
    return IMPERFECT if faults else DONE


def _check_outputs(args: argparse.Namespace, landmarks: list[str], others: list[str]) -> None:
    """Refuse names that could not be written to."""
    check_paths([args.source, args.target, *landmarks], [args.out, *others])
    deckfiles.suffix_of(args.out)
    if args.report is not None:
        check_ending(args.report)
    if args.field is not None:
        keptfield.check_ending(args.field)
    files.check_writable(args.out, *others)


def _write(
    args: argparse.Namespace,
    thing: Deck | MeshFile,
    result: MorphResult | VolumeMorphResult,
    faults: list[str],
    alone: list[str],
    meshes: tuple[Surface, Surface],
    stand: Float,
) -> list[str]:
    """Write all files, whole or not at all, and return what the user should know.

    Parameters
    ----------
    alone : list of str
        What there is to say of landmarks, for the report.
    meshes : (Surface, Surface)
        Source, and target in the source's frame.
    stand : (4, 4) array
        From the source's own coordinates to the assembly's, in which the field is kept: other things
        stand in the assembly's.
    """
    figures = result.surface if isinstance(result, VolumeMorphResult) else result
    written = deckfiles.written(thing, args.out)
    outputs = [*written.files, *(path for path in (args.report, args.field) if path is not None)]
    with files.replacing(*outputs) as new:
        paths = dict(zip(outputs, new, strict=True))
        for path, data in written.files.items():
            paths[path].write_bytes(data)
        if args.report is not None:
            title = f"Morph of {Path(args.source).name} to {Path(args.target).name}"
            report = _report(args, result, faults, alone)
            data = report_bytes(args.report, report, title, lambda: _figures(*meshes, figures))
            paths[args.report].write_bytes(data)
        if args.field is not None:
            date = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
            names = (Path(args.source).stem, Path(args.target).stem)
            paths[args.field].write_bytes(figures.kept(*names, date).placed(stand).encoded())
    mirrored = (
        "mirrored; faces keep their corners' order, and so point the other way: turn them if it matters"
    )
    return [
        # only surfaces get here mirrored: volumes refuse
        *([mirrored] if np.linalg.det(figures.transform[:3, :3]) < 0 else []),
        *getattr(thing, "notes", ()),
        *(_with_file(text, args) for text in figures.warnings),
        *written.notes,
    ]


def _landmarks(paths: list[str]) -> landmarkfiles.Paired | None:
    """Return the two files' landmarks in pairs; None where no file is given."""
    if not paths:
        return None
    if len(paths) == 1:
        raise FemorsError("--source-landmarks and --target-landmarks go together; only one is given")
    source, target = map(landmarkfiles.read, paths)
    return landmarkfiles.paired(source, target)


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
    if result.faults:  # faces that fold over or cross, counted together: not once more by kind
        return [*faults, *result.faults]
    if result.after.flipped:
        faults.append(
            counted(result.after.flipped, "face of the result is flipped", "faces of the result are flipped")
        )
    after = result.after.self_intersecting
    # of the source itself: its aligned positions are rounded, and faces that touch may then cross
    before = after and len(np.unique(self_intersections(clean(source.vertices, source.faces).surface)))
    if after > before:
        faults.append(
            f"{counted(after, 'face of the result crosses', 'faces of the result cross')} others "
            f"of it, and {before} did in the source"
        )
    return faults


def _figures(surface: Surface, aim: Surface, figures: MorphResult) -> list[Section]:
    """Return a report's pictures; all in the place of the target."""
    aligned = surface.moved(transformed(figures.transform, surface.vertices))
    values = {"displacement": figures.displacement, "surface_distance": figures.surface_distance}
    return morph_figures(aligned, surface.moved(figures.vertices), aim, values)


def _report(
    args: argparse.Namespace, result: MorphResult | VolumeMorphResult, faults: list[str], alone: list[str]
) -> dict[str, Any]:
    names = {"source": args.source, "target": args.target, "out": args.out, "field": args.field}
    report = {"femors": version(), "files": names, "faults": faults, **result.report()}
    report["warnings"] = [*alone, *(_with_file(text, args) for text in report["warnings"])]
    return report
