# SPDX-License-Identifier: GPL-3.0-or-later
"""A finite-element deck: its mesh, its parts, and the file that it came from and goes back to."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .cached import cached_property
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
            placed = self._placed_by(instance) if instance.name.upper() == name.upper() else None
            if placed is not None:
                return placed
        return self._known(name) or self._set(name)

    def placement(self, name: str | None, part: Part) -> Float:
        """Return the matrix (4, 4) by which the assembly places a part, chosen by `name` as in `part`.

        What a set or "all" names stands where the parts stand that its elements are in.

        Raises
        ------
        FemorsError
            It stands in several places and the name is not that of one of its part's instances, or it is
            of several parts that stand in different places.
        """
        holders = self.holders(part) if self.instances else []
        mine = [instance for instance in self.instances if self._placed_by(instance) in holders]
        named = [instance for instance in mine if name is not None and instance.name.upper() == name.upper()]
        chosen = named or mine
        places = [instance.matrix for instance in chosen]
        if not {self._placed_by(instance) for instance in chosen}.issuperset(holders):
            places.append(np.eye(4))  # a part without an instance
        if all(np.array_equal(place, places[0]) for place in places):
            return places[0] if places else np.eye(4)
        if len(holders) > 1:
            raise FemorsError(
                f"{self.path}: '{part.name}' is of parts that stand in different places "
                f"({quoted(holder.name for holder in holders)}); name one of these parts with --part"
            )
        names = quoted(dict.fromkeys(instance.name for instance in chosen))
        raise FemorsError(
            f"{self.path}: '{part.name}' stands in {len(chosen)} places ({names}); "
            "choose one of these instances with --part"
        )

    def holders(self, part: Part) -> list[Part]:
        """Return the deck's parts that the elements of a part, or of what a set names, are in."""
        if part in self.parts.values():
            return [part]
        inside = np.zeros(self.mesh.element_count, dtype=bool)
        inside[part.elements] = True
        return [known for known in self.parts.values() if inside[known.elements].any()]

    @cached_property
    def _by_name(self) -> dict[str, Part]:
        """By upper-case name, the first that has it."""
        return {known.name.upper(): known for known in reversed(list(self.parts.values()))}

    def _known(self, name: str) -> Part | None:
        return self._by_name.get(name.upper())

    def _placed_by(self, instance: Instance) -> Part | None:
        """Return the part that an instance places: the one it names or, where that is empty, its own mesh."""
        return self._known(instance.part) or self._known(instance.name)

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
