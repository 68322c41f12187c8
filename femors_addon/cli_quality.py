# SPDX-License-Identifier: GPL-3.0-or-later
"""``femors quality``: the figures of a mesh, and of a mesh beside another."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from . import cli_convert, deckfiles, files
from .commandline import Console, check_paths
from .deck import Deck
from .examine import WORST_ASPECT, Examination, examine
from .mesh import Surface
from .meshfiles import MeshFile
from .progress import FemorsError, counted
from .report_figures import mesh_figures
from .report_files import FORMATS, check_ending, report_bytes
from .version import version
from .volume_quality import VolumeQuality


def options(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``femors quality``."""
    parser.add_argument("source", metavar="MESH", help=f"what is to be measured: {cli_convert.KINDS}")
    parser.add_argument(
        "other", metavar="OTHER", nargs="?", help="a mesh to compare it with, of any such kind"
    )
    parser.add_argument("--part", metavar="NAME", help="the part of MESH, where it is a deck with several")
    parser.add_argument("--other-part", metavar="NAME", help="the same of OTHER")
    parser.add_argument(
        "--worst-aspect",
        type=float,
        default=WORST_ASPECT,
        metavar="FLOAT",
        help=f"faces with a larger aspect ratio count as slender (default {WORST_ASPECT:g})",
    )
    parser.add_argument("--report", metavar="R", help=f"every figure: {FORMATS}")


def run(args: argparse.Namespace, console: Console) -> int:
    """Measure, print and report; 1 where the mesh has faults."""
    outputs = [path for path in (args.report,) if path is not None]
    inputs = [path for path in (args.source, args.other) if path is not None]
    check_paths(inputs, outputs)
    if args.report is not None:
        check_ending(args.report)
    files.check_writable(*outputs)
    if not args.worst_aspect >= 1:
        raise FemorsError("--worst-aspect: the aspect ratio is 1 or more")
    source = deckfiles.read(args.source)
    surface = _in_place(source, args.part, "--part", alone=args.other is None)
    elements = None
    if isinstance(source, Deck):
        part = cli_convert.part_of(source, args.part, "--part")
        assert part is not None
        mesh, _ = source.submesh(part)
        elements = VolumeQuality.of(mesh) if mesh.solid else None
    other = None
    if args.other is not None:
        other = _in_place(deckfiles.read(args.other), args.other_part, "--other-part")
    try:
        found = examine(surface, other, elements, args.worst_aspect, console.progress)
    except FemorsError as error:
        raise FemorsError(_with_file(str(error), args)) from None
    console.end_progress()
    found = dataclasses.replace(found, notes=tuple(_with_file(note, args) for note in found.notes))
    faults = faults_of(found, surface)
    report = {"femors": version(), "files": {"mesh": args.source, "other": args.other}, "faults": faults}
    report |= {f"{k}_counted" if k == "faults" else k: v for k, v in found.as_dict().items()}
    if args.report is not None:
        title = f"Quality of {Path(args.source).name}"
        data = report_bytes(args.report, report, title, lambda: mesh_figures(surface, other, {}))
        with files.replacing(args.report) as (new,):
            new.write_bytes(data)
        console.written = True
    for note in found.notes if not args.quiet else ():
        console.warn(f"note: {note}")
    console.say(found.summary())
    for fault in faults:
        console.warn(fault)
    return 1 if faults else 0


def _in_place(source: Deck | MeshFile, name: str | None, option: str, alone: bool = False) -> Surface:
    """Return the surface that an option names where an assembly has it.

    What stands in several places may be measured `alone`, without another mesh: in the parts' own
    coordinates, for figures of shape are the same at each place.
    """
    surface = cli_convert.surface_of(source, name, option)
    try:
        return cli_convert.placed(cli_convert.placement_of(source, name, option), surface)
    except FemorsError:
        if not alone:
            raise
    return surface


def _with_file(text: str, args: argparse.Namespace) -> str:
    """Name the file in a message of the core about the "mesh" or the "other mesh"."""
    for role, path in (("mesh: ", args.source), ("other mesh: ", args.other)):
        if text.startswith(role):
            return f"{path}: {text.removeprefix(role)}"
    return text


def faults_of(found: Examination, surface: Surface) -> list[str]:
    """Return what is wrong with a mesh, in words, and where the first of each is."""
    faces = {
        ("face crosses others", "faces cross others"): found.self_intersecting,
        ("face is folded over", "faces are folded over"): found.folded,
        ("face has no area", "faces have no area"): found.degenerate,
    }
    out = []
    for words, rows in faces.items():
        if len(rows):
            place = ", ".join(f"{x:.4g}" for x in surface.corners[rows[0]].mean(axis=0))
            out.append(f"{counted(len(rows), *words)} (first: at ({place}))")
    if found.elements is not None and found.elements.inverted:
        inverted = counted(found.elements.inverted, "element is inverted", "elements are inverted")
        out.append(f"{inverted} (most of all: element {found.elements.worst})")
    return out
