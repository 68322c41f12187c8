# SPDX-License-Identifier: GPL-3.0-or-later
"""Every file that FEMORS reads and writes, by its ending: surface meshes, decks, and one as the other."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from . import feb, inp, inp_write, meshfiles, meshio_files, nastran, vtk_poly
from .deck import Deck, Load, Part
from .files import Location, check_no_folder, read_bytes
from .mesh import Int
from .meshfiles import MeshFile
from .progress import FemorsError, counted
from .volume import Block, VolumeMesh


def _read_vtk(path: Path, load: Load = read_bytes) -> Deck:
    """Read a legacy VTK file: a surface, or an unstructured grid."""
    data = load(path)
    reader = vtk_poly.read if vtk_poly.is_polydata(data) else meshio_files.read
    return reader(path, lambda _: data)


READERS: dict[str, Any] = {
    ".inp": inp.read,
    ".feb": feb.read,
    ".bdf": nastran.read,
    ".nas": nastran.read,
    ".fem": nastran.read,
    **dict.fromkeys(meshio_files.FORMATS, meshio_files.read),
    ".vtk": _read_vtk,
}
"""``read(path, load) -> Deck`` for each ending."""
WRITERS: dict[str, Any] = {
    ".inp": inp_write.fresh,
    ".feb": feb.fresh,
    **dict.fromkeys((".bdf", ".nas", ".fem"), nastran.fresh),
    **dict.fromkeys(meshio_files.FORMATS, meshio_files.fresh),
}
"""``fresh(mesh, parts, suffix) -> bytes`` for each ending."""
ENDINGS = (*meshfiles.FORMATS, *READERS)
_SETS = (".inp", ".feb")  # formats that hold sets
_IDS = (".inp", ".feb", ".bdf", ".nas", ".fem", ".vtk", ".vtu")  # and numbers of nodes and elements


def suffix_of(path: Location, others: Iterable[str] = ()) -> str:
    """Return a path's ending in lower case; raise `FemorsError` where it is no known format.

    `others` are endings that are known where the path was given, for the message.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in ENDINGS:
        check_no_folder(path)
        known = ", ".join((*ENDINGS, *others))
        if not suffix:
            raise FemorsError(f"{path}: the name has no ending, which says the kind of file; use {known}")
        raise FemorsError(f"{path}: '{suffix}' is not a known kind of file; use {known}")
    return suffix


def same_format(one: Location, two: Location) -> bool:
    """Whether two paths' endings stand for one format."""
    kinds = [READERS.get(suffix_of(path)) for path in (one, two)]
    alike = kinds[0] is not None and kinds[0] is kinds[1] and kinds[0] is not meshio_files.read
    return alike or suffix_of(one) == suffix_of(two)


def read(path: Location) -> Deck | MeshFile:
    """Read a surface mesh or a deck, by the path's ending.

    Raises
    ------
    FemorsError
        One line that names the file and says what is wrong with it.
    """
    if suffix_of(path) in READERS:
        return read_deck(path)
    return meshfiles.read(path)


def read_deck(path: Location, load: Load = read_bytes) -> Deck:
    """Read a deck: Abaqus, FEBio, Nastran, or through meshio VTK, VTU, Gmsh and others.

    Parameters
    ----------
    path : path
        Its ending says the format.
    load : callable, optional
        Gives the bytes at a path, where they are not to be read from the disk.

    Raises
    ------
    FemorsError
        One line that names the file, where possible the line, and what was expected.
    """
    suffix = suffix_of(path)
    if suffix not in READERS:
        raise FemorsError(f"{path}: is a surface mesh, not a deck ({', '.join(READERS)})")
    deck: Deck = READERS[suffix](Path(path), load)
    return deck


# --- one format as another ------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True, eq=False)
class Written:
    """Files to be written, by path, that which was asked for first; and what is lost, in words."""

    files: dict[Path, bytes]
    lost: tuple[str, ...] = ()

    @property
    def notes(self) -> list[str]:
        """What is lost, as sentences."""
        return [f"not written: {what}" for what in self.lost]


def written(thing: Deck | MeshFile, path: Location, part: Part | None = None) -> Written:
    """Return a deck or mesh as the files that its writing to `path` gives.

    A deck in its own format keeps everything; in another, nodes, elements and sets as far as the format
    has them; as STL, PLY or OBJ, its surface. A surface mesh becomes a deck of shells. With a
    `part` only that is written, as a deck made from scratch where it is one.

    Raises
    ------
    FemorsError
        What the format cannot hold.
    """
    path, suffix = Path(path), suffix_of(path)
    if isinstance(thing, MeshFile):
        if suffix in meshfiles.FORMATS:
            return Written({path: meshfiles.encoded(path, thing)})
        mesh, merged = shells(thing)
        return Written({path: _fresh(mesh, {}, path)}, merged)
    if part is None and same_format(thing.path, path):
        return Written(thing.outputs(path))
    template, vtk = thing.template, {thing.suffix, suffix} == {".vtk", ".vtu"}
    if part is None and vtk and isinstance(template, meshio_files.Template):
        return Written({path: template.converted(thing.coordinates, suffix)})
    mesh = thing.mesh if part is None else thing.submesh(part)[0]
    names = {part.name: np.arange(mesh.element_count)} if part is not None else _part_sets(thing)
    lost = [
        "node and cell data"
        if thing.suffix in meshio_files.FORMATS
        else "materials, steps and whatever is neither node, element nor set"
    ]
    if thing.instances:
        lost.append("the placing of parts by the assembly (every part is in its own coordinates)")
    if suffix in meshfiles.FORMATS:
        return Written({path: meshfiles.encoded(path, _polygons(mesh))}, (*lost, *_beyond_surface(mesh)))
    sets = {*mesh.node_sets, *mesh.element_sets, *mesh.surfaces} - set(names)
    if suffix not in _SETS and sets:
        lost.append("sets, but for the parts")
    elif mesh.surfaces:
        lost.append("surfaces")
    mesh, renumbered = unique_ids(mesh)
    if renumbered or suffix not in _IDS:
        lost.append("the numbers of nodes and elements")
    return Written({path: _fresh(mesh, names, path)}, tuple(lost))


def _fresh(mesh: VolumeMesh, parts: dict[str, Int], path: Path) -> bytes:
    suffix = path.suffix.lower()
    try:
        data: bytes = WRITERS[suffix](mesh, parts, suffix)
    except FemorsError as error:
        raise FemorsError(f"{path}: {error}") from None
    return data


def _part_sets(deck: Deck) -> dict[str, Int]:
    return {name: part.elements for name, part in deck.parts.items()}


def _polygons(mesh: VolumeMesh) -> MeshFile:
    """Return the boundary of a mesh as polygons over its own vertices."""
    polygons = mesh.boundary
    index = np.searchsorted(polygons.nodes, polygons.corners)
    return MeshFile(mesh.nodes[polygons.nodes], polygons.sizes, index)


def _beyond_surface(mesh: VolumeMesh) -> list[str]:
    inner = len(mesh.nodes) - len(mesh.boundary.nodes)
    words = "node that is no corner of the surface", "nodes that are no corners of the surface"
    lost = [counted(inner, *words)] if inner else []
    return [
        *lost,
        "the numbers of nodes and elements",
        *(["sets"] if mesh.node_sets or mesh.element_sets else []),
    ]


def shells(mesh: MeshFile) -> tuple[VolumeMesh, tuple[str, ...]]:
    """Return a surface mesh as shell elements; vertices at one place, as STL has them, become one node."""
    lost: list[str] = []
    vertices, corners = mesh.vertices, mesh.corners
    if mesh.suffix == ".stl":
        vertices, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
        corners = index.ravel()[mesh.corners].astype(np.int32)
        if len(vertices) < len(mesh.vertices):
            lost.append(
                f"{counted(len(mesh.vertices) - len(vertices), 'vertex', 'vertices')} that stood where "
                "another stands"
            )
    elif mesh.suffix:
        lost.append("normals, colours, texture coordinates and groups, where there are any")
    ends = np.cumsum(mesh.sizes)
    blocks: list[Block] = []
    count = 0
    for size, kind in ((3, "tri3"), (4, "quad4")):
        mine = corners[ends[mesh.sizes == size, None] - size + np.arange(size)]
        if len(mine):
            blocks.append(Block(kind, mine, np.arange(count + 1, count + len(mine) + 1)))
            count += len(mine)
    other = int(((mesh.sizes < 3) | (mesh.sizes > 4)).sum())
    if other:
        raise FemorsError(
            f"{counted(other, 'polygon has', 'polygons have')} neither three nor four corners; "
            "triangulate first"
        )
    return VolumeMesh(vertices, tuple(blocks), np.arange(1, len(vertices) + 1)), tuple(lost)


def unique_ids(mesh: VolumeMesh) -> tuple[VolumeMesh, bool]:
    """Return the mesh with ids that stand once each, and whether they had to be made anew.

    Parts of a deck count for themselves; a file made from scratch has one count for all.
    """
    if all(len(np.unique(ids)) == len(ids) for ids in (mesh.node_ids, mesh.element_ids)):
        return mesh, False
    blocks = [
        dataclasses.replace(block, ids=np.arange(start + 1, start + len(block) + 1))
        for block, start in mesh.with_starts()
    ]
    return dataclasses.replace(mesh, blocks=tuple(blocks), node_ids=np.arange(1, len(mesh.nodes) + 1)), True
