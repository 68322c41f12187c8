# SPDX-License-Identifier: GPL-3.0-or-later
"""``femors convert``, and what the other subcommands need to read and write decks."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

import numpy as np

from . import deckfiles, files
from .commandline import Console, check_paths
from .deck import Deck, Part
from .files import Location
from .mesh import Float, Surface
from .meshfiles import MeshFile
from .progress import FemorsError
from .transforms import transformed

KINDS = (
    "STL, PLY, OBJ; Abaqus .inp, FEBio .feb, Nastran .bdf; VTK surfaces; "
    "through meshio .vtk, .vtu, .msh, .mesh"
)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``femors convert``."""
    parser.add_argument("source", metavar="IN", help=KINDS)
    parser.add_argument("place", metavar="OUT", nargs="?", help=argparse.SUPPRESS)
    parser.add_argument("-o", "--out", metavar="OUT", help="any of these; the ending says which")
    parser.add_argument(
        "--part",
        metavar="NAME",
        help="only this part, element set or node set, made into a deck from scratch",
    )


def run(args: argparse.Namespace, console: Console) -> int:
    """Convert IN to OUT and say what is lost on the way."""
    if (args.out is None) == (args.place is None):  # OUT may also stand right behind IN, without -o
        args.parser.error(
            "-o OUT is needed" if args.out is None else f"two outputs: {args.place}, {args.out}"
        )
    args.out = args.out or args.place
    deckfiles.suffix_of(args.out)
    check_paths([args.source], [args.out])
    files.check_writable(args.out)
    source = deckfiles.read(args.source)
    part = None if args.part is None else part_of(source, args.part, "--part")
    if isinstance(source, MeshFile) and deckfiles.same_format(args.source, args.out):
        written = deckfiles.Written({args.out: files.read_bytes(args.source)})
    else:
        written = deckfiles.written(source, args.out, part)
    if isinstance(source, Deck):
        check_paths(source.inputs, written.files)
    with files.replacing(*written.files) as new:
        for path, data in zip(new, written.files.values(), strict=True):
            path.write_bytes(data)
    if not args.quiet:
        for note in (*getattr(source, "notes", ()), *written.notes):
            console.warn(f"note: {note}")
    console.say(f"{args.source} -> {', '.join(str(path) for path in written.files)}")
    return 0


def part_of(source: Deck | MeshFile, name: str | None, option: str) -> Part | None:
    """Return the part of a deck that an option names; None for a surface mesh, which has none."""
    if isinstance(source, Deck):
        try:
            return source.part(name)
        except FemorsError as error:
            raise FemorsError(str(error).replace("--part", option)) from None
    if name is not None:
        raise FemorsError(f"{option} {name}: a surface mesh has no parts")
    return None


def placement_of(source: Deck | MeshFile, name: str | None, option: str) -> Float:
    """Return the matrix (4, 4) by which an assembly places what `part_of` returns."""
    part = part_of(source, name, option)
    if not isinstance(source, Deck) or part is None:
        return np.eye(4)
    try:
        return source.placement(name, part)
    except FemorsError as error:
        raise FemorsError(str(error).replace("--part", option)) from None


def placed(matrix: Float, surface: Surface) -> Surface:
    """Return a surface carried by a matrix (4, 4); the identity changes no bit."""
    if np.array_equal(matrix, np.eye(4)):
        return surface
    return surface.moved(transformed(matrix, surface.vertices))


def surface_of(source: Deck | MeshFile, name: str | None, option: str) -> Surface:
    """Return the surface of a mesh, or of the part of a deck that an option names, in its own coordinates."""
    part = part_of(source, name, option)
    if isinstance(source, MeshFile) or part is None:
        assert isinstance(source, MeshFile)
        return source.surface()
    return source.submesh(part)[0].surface()[0]


def check_outputs(
    source: Deck | MeshFile, part: Part | None, out: Location, others: Iterable[Location]
) -> None:
    """Refuse, before a long computation, what could not be written after it: includes in the way."""
    if isinstance(source, Deck) and part is not None and len(source.inputs) > 1:
        probe = np.array(source.coordinates)
        probe[part.nodes] += 1.0
        outputs = [*deckfiles.written(source.with_coordinates(probe), out).files, *others]
        check_paths(source.inputs, outputs)
        files.check_writable(*outputs)
