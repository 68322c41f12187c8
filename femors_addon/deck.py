# SPDX-License-Identifier: GPL-3.0-or-later
"""A finite-element deck: its mesh, its parts, and the file that it came from and goes back to."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .files import Location, replacing
from .mesh import Float, Int
from .progress import FemorsError, listed
from .volume import Block, VolumeMesh

Load = Callable[[Path], bytes]
"""What gives the bytes at a path; raises `FemorsError` where there are none."""
ALL = "all"


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """A part of a deck: nodes (p,) and elements (q,) by index into the deck's mesh, ascending."""

    name: str
    nodes: Int
    elements: Int


@dataclasses.dataclass(frozen=True, eq=False)
class Instance:
    """Where an assembly places a part: ``matrix`` (4, 4) takes part coordinates to the assembly's."""

    name: str
    part: str
    matrix: Float


class Template(Protocol):
    """What a format keeps of a file, to write it again at other coordinates."""

    def encoded(self, nodes: Float) -> bytes:
        """Return the bytes of the deck's own file for nodes (n, 3)."""
        ...

    def outputs(self, nodes: Float, path: Path) -> dict[Path, bytes]:
        """Return all files to be written, by path; `path` is the deck's own."""
        ...

    def inputs(self) -> list[Path]:
        """Return the files that were read, the deck itself first."""
        ...


class OneFile:
    """What the templates of formats without includes have in common: a single file, `path`."""

    path: Path

    def encoded(self, nodes: Float) -> bytes:
        """Return the file's bytes for nodes (n, 3)."""
        raise NotImplementedError

    def inputs(self) -> list[Path]:
        """Return the file that was read."""
        return [self.path]

    def outputs(self, nodes: Float, path: Path) -> dict[Path, bytes]:
        """Return the file by its path."""
        return {path: self.encoded(nodes)}


@dataclasses.dataclass(frozen=True, eq=False)
class Deck:
    """A finite-element model in a file, of which only the coordinates can be changed.

    Attributes
    ----------
    path : Path
        Where it was read from.
    suffix : str
        Its format: ".inp", ".feb", ".vtu" ...
    mesh : VolumeMesh
        All nodes and elements; each part in its own coordinates.
    parts : mapping of str to Part
        The parts; in a deck without any, the element sets that its elements are defined in.
    instances : tuple of Instance
        How an assembly places the parts; empty where it does not.
    notes : tuple of str
        What the user should know, in words.
    template : Template
        The rest of the file.
    """

    path: Path
    suffix: str
    mesh: VolumeMesh
    parts: Mapping[str, Part]
    template: Template
    instances: tuple[Instance, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def coordinates(self) -> Float:
        """(n, 3) float64, in the order of the file."""
        return self.mesh.nodes

    @property
    def inputs(self) -> list[Path]:
        """The files that it was read from, its own first."""
        return self.template.inputs()

    def with_coordinates(self, coordinates: ArrayLike) -> Deck:
        """Return the same deck at other coordinates (n, 3), which must be finite."""
        return dataclasses.replace(self, mesh=self.mesh.moved(coordinates))

    def outputs(self, path: Location) -> dict[Path, bytes]:
        """Return what `write` would write: bytes by path, the deck itself first.

        Raises
        ------
        FemorsError
            A file that cannot be kept apart from what it was read from.
        """
        return self.template.outputs(self.mesh.nodes, Path(path))

    def encoded(self) -> bytes:
        """Return the bytes of the deck's own file (of its includes, `outputs` tells)."""
        return self.template.encoded(self.mesh.nodes)

    def write(self, path: Location) -> None:
        """Write the deck and, if it has some, its includes beside it; whole or not at all."""
        write_all(self.outputs(path))

    def part(self, name: str | None) -> Part:
        """Return a part, or what an element or node set names; the only part where no name is given.

        Names are compared without regard to case; "all" is the whole deck.

        Raises
        ------
        FemorsError
            No such part or set, or no name and several parts.
        """
        if name is None:
            if len(self.parts) == 1:
                return next(iter(self.parts.values()))
            if not self.parts:
                raise FemorsError(f"{self.path}: has no elements with a surface (solids or shells)")
            raise FemorsError(
                f"{self.path}: has {len(self.parts)} parts ({quoted(self.parts)}); "
                f"choose one with --part, or '{ALL}'"
            )
        for instance in self.instances:
            if instance.name.upper() == name.upper():
                name = instance.part
        for known in self.parts.values():
            if known.name.upper() == name.upper():
                return known
        return self._set(name)

    def placement(self, name: str | None, part: Part) -> Float:
        """Return the matrix (4, 4) by which the assembly places a part, chosen by `name` as in `part`.

        Raises
        ------
        FemorsError
            The part stands in several places, and the name is not that of one of its instances.
        """
        mine = [instance for instance in self.instances if instance.part.upper() == part.name.upper()]
        named = [instance for instance in mine if name is not None and instance.name.upper() == name.upper()]
        chosen = named or mine
        if len(chosen) > 1 and any(not np.array_equal(one.matrix, chosen[0].matrix) for one in chosen):
            places = quoted(dict.fromkeys(instance.name for instance in chosen))
            raise FemorsError(
                f"{self.path}: '{part.name}' stands in {len(chosen)} places ({places}); "
                "choose one of these instances with --part"
            )
        return chosen[0].matrix if chosen else np.eye(4)

    def _set(self, name: str) -> Part:
        mesh = self.mesh
        for known, members in mesh.element_sets.items():
            if known.upper() == name.upper():
                return self._elements(known, members)
        for known, members in mesh.node_sets.items():
            if known.upper() == name.upper():
                inside = np.zeros(len(mesh.nodes), dtype=bool)
                inside[members] = True
                whole = [inside[block.nodes].all(axis=1) for block in mesh.blocks]
                elements = np.flatnonzero(np.concatenate([np.zeros(0, bool), *whole]))
                if len(elements):
                    return self._elements(known, elements)
                raise FemorsError(f"{self.path}: no element has all its nodes in the node set '{known}'")
        if name.lower() == ALL and self.parts:
            return self._elements(ALL, np.arange(mesh.element_count))
        raise FemorsError(
            f"{self.path}: has no part or set '{name}'; it has the parts {quoted(self.parts)}"
            + (f" and the element sets {quoted(mesh.element_sets)}" if mesh.element_sets else "")
        )

    def _elements(self, name: str, elements: Int) -> Part:
        return Part(name, self.mesh.restricted(elements)[1], np.sort(elements).astype(np.int32))

    def submesh(self, part: Part) -> tuple[VolumeMesh, Int]:
        """Return the elements of a part as a mesh of their own, and the deck's index of each of its nodes."""
        return self.mesh.restricted(part.elements)


def by_part(mesh: VolumeMesh, parts: Mapping[str, Int]) -> Iterator[tuple[str, Block, NDArray[np.bool_]]]:
    """Yield (part, block, which of its elements) so that every element comes once, those of no part last.

    The name of what belongs to no part is "".
    """
    left = np.ones(mesh.element_count, dtype=bool)
    for name, elements in [*parts.items(), ("", np.arange(mesh.element_count))]:
        mine = np.zeros(mesh.element_count, dtype=bool)
        mine[elements] = True
        mine &= left
        left &= ~mine
        for block, start in mesh.with_starts():
            chosen = mine[start : start + len(block)]
            if chosen.any():
                yield name, block, chosen


def quoted(names: Iterable[str]) -> str:
    """Return names in quotation marks, for a message."""
    return listed(f"'{name}'" for name in names)


def write_all(outputs: Mapping[Path, bytes]) -> None:
    """Write files by path, all of them or none."""
    with replacing(*outputs) as temporary:
        for new, data in zip(temporary, outputs.values(), strict=True):
            new.write_bytes(data)
