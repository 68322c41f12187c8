# SPDX-License-Identifier: GPL-3.0-or-later
"""``femors transfer``: a field applied to meshes, decks and landmark files."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from . import cli_convert, deckfiles, files, keptfield, landmarkfiles, landmarks
from .carry import Carrier
from .commandline import FOLDER, Console, add_settings, check_paths, settings_of
from .deck import Deck
from .landmarkfiles import Landmarks
from .mesh import Float, Int, Surface
from .meshfiles import MeshFile
from .progress import FemorsError, Progress, part
from .report_files import HELP, check_ending, report_bytes
from .report_html import Section
from .report_transfer import Carried, transfer_figures, transfer_report
from .transfer import Transfer, Transferred
from .transfer_settings import TransferSettings
from .version import version

TABLE = "the landmarks with distance, residual, stretch, projection and spread, as CSV"
REPORT = "each landmark and file before and after, and " + HELP


def options(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``femors transfer``."""
    parser.add_argument("field", metavar="FIELD.npz", help="what 'femors morph --field' has written")
    parser.add_argument(
        "inputs",
        metavar="INPUT",
        nargs="+",
        help=f"meshes and decks ({cli_convert.KINDS}); landmarks: {landmarkfiles.MARKS}",
    )
    parser.add_argument("-o", "--out", metavar="OUTDIR", required=True, help=FOLDER)
    parser.add_argument(
        "--project", metavar="TARGET", help="lay what is carried onto the surface of this mesh"
    )
    parser.add_argument(
        "--project-part", metavar="NAME", help="the part or set of TARGET, where it is a deck"
    )
    parser.add_argument("--table", metavar="T.csv", help=TABLE)
    parser.add_argument("--report", metavar="R", help=REPORT)
    add_settings(parser, TransferSettings, {})


class _Output(NamedTuple):
    """What comes of an input."""

    path: str
    files: Mapping[Path, bytes]
    moved: Transferred
    prediction: landmarks.Prediction | None
    carried: Callable[[], Carried]


def run(args: argparse.Namespace, console: Console) -> int:
    """Carry every input by the field; all outputs are written, or none."""
    settings = settings_of(args, TransferSettings())
    outputs = [os.path.join(args.out, os.path.basename(path)) for path in args.inputs]
    others = [path for path in (args.table, args.report) if path is not None]
    inputs = [args.field, *args.inputs, *([args.project] if args.project is not None else [])]
    check_paths(inputs, [*outputs, *others])
    for path in args.inputs:
        if not landmarkfiles.is_landmarks(path):
            deckfiles.suffix_of(path, landmarkfiles.FORMATS)
    if args.report is not None:
        check_ending(args.report)
    files.check_folder(args.out)
    fresh = not os.path.exists(args.out)  # it is made with the rest
    files.check_writable(*(path for path in others if not (fresh and Path(path).parent == Path(args.out))))
    carrier = Carrier(keptfield.load(args.field))
    transfer = Transfer(carrier, settings, _surface(args.project, args.project_part))
    done = []
    for number, (path, out) in enumerate(zip(args.inputs, outputs, strict=True)):
        step = part(console.progress, number / len(outputs), (number + 1) / len(outputs))
        try:
            done.append(_transferred(transfer, path, out, step))
        except FemorsError as error:
            text = str(error)
            raise FemorsError(text if text.startswith(path) else f"{path}: {text}") from None
    console.end_progress()
    tables = [one.prediction for one in done if one.prediction is not None]
    data = {path: content for one in done for path, content in one.files.items()}
    if args.table is not None:
        if not tables:
            raise FemorsError("--table lists landmarks, and no input is a landmark file")
        data[Path(args.table)] = table_of(tables)
    if args.report is not None:
        data[Path(args.report)] = _report(args, transfer, done)
    check_paths(inputs, data)
    write_all(data, args.out)
    console.written = True
    for one in done:
        console.say(f"{one.path}: {one.moved.summary(one.path.lower().endswith('.stl'))}")
        if one.prediction is not None:
            console.say(one.prediction.table())
    return _told(console, done, args.quiet)


def _told(console: Console, done: Sequence[_Output], quiet: bool) -> int:
    for one in done:
        for note in one.moved.notes if not quiet else ():
            console.warn(f"note: {one.path}: {note}")
        for fault in one.moved.faults:
            console.warn(f"{one.path}: {fault}; the result is written")
    return 1 if any(one.moved.faults for one in done) else 0


def _report(args: argparse.Namespace, transfer: Transfer, done: Sequence[_Output]) -> bytes:
    """Return the report, in the format that its name asks for."""
    carried = [one.carried() for one in done]
    known = {os.path.basename(one.path): one.prediction for one in done if one.prediction is not None}
    onto = "" if args.project is None else os.path.basename(args.project)
    names = {"field": args.field, "inputs": args.inputs, "out": args.out, "project": args.project}
    report = {"femors": version(), **transfer_report(transfer, carried, known, onto), "files": names}

    def figures() -> list[Section]:
        before, after = transfer.surfaces()
        return transfer_figures(before, after, carried)

    return report_bytes(args.report, report, f"Transfer by {transfer.carrier.field.name}", figures)


def _transferred(transfer: Transfer, path: str, out: str, progress: Progress) -> _Output:
    name = os.path.basename(path)

    def carried(before: Float, moved: Transferred, names: tuple[str, ...], faces: Int | None) -> Carried:
        return Carried(name, before, moved, transfer.distance_after(moved.points), names, faces)

    if landmarkfiles.is_landmarks(path):
        marks = landmarkfiles.read(path, transfer.settings.space)
        moved = transfer.points(marks.points, progress)
        prediction = None
        if not transfer.settings.inverse:
            prediction = landmarks.predicted(
                transfer.carrier, marks.labels, marks.points, moved.points, moved.projected
            )
        moved = transfer.of_landmarks(moved, marks.points, marks.labels)
        if prediction is not None and not moved.faults and transfer.settings.strength > 0:
            unseen = prediction.unseen(transfer.carrier.size)
            moved = dataclasses.replace(moved, faults=(*moved.faults, *unseen))
        content = {Path(out): landmarkfiles.encoded(out, marks.with_points(moved.points))}
        return _Output(
            path, content, moved, prediction, lambda: carried(marks.points, moved, marks.labels, None)
        )
    thing = deckfiles.read(path)
    if isinstance(thing, MeshFile):
        before, world = thing.vertices, transfer.points(thing.vertices, progress)
        moved = world
        written = deckfiles.written(thing.with_vertices(moved.points), Path(out))
    else:
        before, world, moved = _deck(transfer, thing, progress)
        written = deckfiles.written(thing.with_coordinates(moved.points), Path(out))
    sizes, units = transfer.unit.unlike(before)
    notes = [note for note in moved.notes if not (sizes or units) or note not in transfer.unit.small(before)]
    notes += [*sizes, *([] if units or moved.faults else transfer.unseen(before)), *written.notes]
    moved = dataclasses.replace(moved, notes=tuple(notes), faults=tuple(units) or moved.faults)
    return _Output(path, written.files, moved, None, lambda: carried(before, world, (), _faces(thing)))


def _faces(thing: Deck | MeshFile) -> Int:
    if isinstance(thing, MeshFile):
        return thing.surface().faces
    if not len(thing.mesh.boundary.sizes):  # nodes alone, or beams
        return np.empty((0, 3), np.int32)
    surface, nodes = thing.mesh.surface()
    return nodes[surface.faces]


def _deck(transfer: Transfer, deck: Deck, progress: Progress) -> tuple[Float, Transferred, Transferred]:
    """Carry all nodes of a deck, each part where the assembly has it.

    Returns
    -------
    tuple
        Where the assembly has the nodes, where it has them afterwards, and these in the parts' coordinates.
    """
    places = np.tile(np.eye(4), (len(deck.coordinates), 1, 1))
    for known in deck.parts.values():
        try:
            places[known.nodes] = deck.placement(None, known)
        except FemorsError:
            raise FemorsError(
                f"'{known.name}' stands in several places of the assembly; give each place its own part"
            ) from None
    world = np.einsum("nij,nj->ni", places[:, :3, :3], deck.coordinates) + places[:, :3, 3]
    moved = transfer.mesh(deck.mesh.moved(world), progress)
    back = np.linalg.inv(places)
    own = np.einsum("nij,nj->ni", back[:, :3, :3], moved.points) + back[:, :3, 3]
    still = (moved.points == world).all(axis=1)
    own[still] = deck.coordinates[still]  # to the very bit
    return world, moved, dataclasses.replace(moved, points=own)


def _surface(path: str | None, name: str | None) -> Surface | None:
    if path is None:
        return None
    thing = deckfiles.read(path)
    matrix = cli_convert.placement_of(thing, name, "--project-part")
    return cli_convert.placed(matrix, cli_convert.surface_of(thing, name, "--project-part"))


def write_all(data: Mapping[Path, bytes], folder: str | None = None) -> None:
    """Write all files or none; a folder that was made for them goes again where they cannot be."""
    place = contextlib.nullcontext() if folder is None else files.folder_for(folder)
    with place, files.replacing(*data) as new:
        for path, content in zip(new, data.values(), strict=True):
            path.write_bytes(content)


def table_of(tables: Sequence[landmarks.Prediction]) -> bytes:
    """Return landmarks with all that is known of them, as a CSV file."""
    points = np.concatenate([table.points for table in tables])
    names = tuple(name for table in tables for name in table.names)
    columns = [table.columns() for table in tables]
    beside = {key: [value for one in columns for value in one[key]] for key in columns[0]}
    return landmarkfiles.encoded("table.csv", Landmarks(points, names), beside)
