# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies for ``femors overclosure``: read from files, named, given shares and put in pairs."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from . import deckfiles
from .bodies import Body
from .deck import Deck, Part
from .mesh import Float, Int, Surface
from .meshfiles import MeshFile
from .progress import FemorsError
from .transforms import inverse, transformed
from .volume import VolumeMesh


@dataclasses.dataclass(frozen=True, eq=False)
class Source:
    """A file, and the bodies in it.

    Attributes
    ----------
    path : str
    thing : Deck or MeshFile
    bodies : tuple of Body
        Where an assembly places parts, they are in its frame.
    nodes : tuple of (k,) int32 or None
        For each body the deck's nodes that are its own; None for a surface mesh.
    frames : tuple of (4, 4) float64
        From the part's own coordinates to the frame of all bodies.
    """

    path: str
    thing: Deck | MeshFile
    bodies: tuple[Body, ...]
    nodes: tuple[Int | None, ...]
    frames: tuple[Float, ...]

    def moved(self, nodes: Mapping[str, Float]) -> Deck | MeshFile:
        """Return the file's content with the bodies' nodes (by name) where they are now."""
        if isinstance(self.thing, MeshFile):
            return self.thing.with_vertices(nodes[self.bodies[0].name])
        coordinates = np.array(self.thing.coordinates)
        for body, mine, frame in zip(self.bodies, self.nodes, self.frames, strict=True):
            assert mine is not None
            after = nodes[body.name]
            moved = (after != body.nodes).any(axis=1)
            home = after if np.array_equal(frame, np.eye(4)) else transformed(inverse(frame), after)
            coordinates[mine[moved]] = home[moved]
        return self.thing.with_coordinates(coordinates)


def read(path: str) -> Source:
    """Read a file and take it apart into bodies."""
    thing, stem = deckfiles.read(path), Path(path).stem
    if isinstance(thing, MeshFile):
        return Source(path, thing, (_body(path, stem, thing.surface()),), (None,), (np.eye(4),))
    parts = _separate(thing)
    if not parts:
        raise FemorsError(f"{path}: has no elements with a surface (solids or shells)")
    bodies, nodes, frames = [], [], []
    for part in parts:
        mesh, mine = thing.submesh(part)
        frame = _placed(thing, part)
        if not np.array_equal(frame, np.eye(4)):
            mesh = mesh.moved(transformed(frame, mesh.nodes))
        bodies.append(_body(path, stem if len(parts) == 1 else f"{stem}:{part.name}", mesh))
        nodes.append(mine)
        frames.append(frame)
    return Source(path, thing, tuple(bodies), tuple(nodes), tuple(frames))


def _placed(deck: Deck, part: Part) -> Float:
    """Return where an assembly has a part; refuse one that it has in several places."""
    try:
        return deck.placement(None, part)
    except FemorsError:
        raise FemorsError(
            f"{deck.path}: the assembly has '{part.name}' in several places; a body needs a part of its own"
        ) from None


def _separate(deck: Deck) -> list[Part]:
    """Return the parts of a deck that have a surface; those that share nodes are one body."""
    found: list[Part] = []
    for part in deck.parts.values():
        mesh, mine = deck.submesh(part)
        if not len(mesh.boundary.sizes):
            continue
        touching = [other for other in found if np.intersect1d(other.nodes, mine).size]
        joined = Part(part.name, mine, part.elements)
        for other in touching:
            found.remove(other)
            elements = np.union1d(other.elements, joined.elements).astype(np.int32)
            both = np.union1d(other.nodes, joined.nodes).astype(np.int32)
            joined = Part(f"{other.name}+{joined.name}", both, elements)
        found.append(joined)
    return found


def _body(path: str, name: str, mesh: Surface | VolumeMesh) -> Body:
    try:
        return Body(name, mesh)
    except FemorsError as error:
        raise FemorsError(f"{path}: {error}") from None


def with_shares(bodies: list[Body], args: argparse.Namespace) -> list[Body]:
    """Return the bodies with the shares that the command line gives them."""
    names = [body.name for body in bodies]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise FemorsError(f"two bodies are named '{twice}'; give the files different names")
    given: dict[str, float] = {}
    for name in args.rigid:
        given |= dict.fromkeys(_known(name, names, "--rigid"), 0.0)
    for text in args.share:
        name, value = _split(text, "--share", "NAME=S")
        for one in _known(name, names, "--share"):
            if one in given:
                raise FemorsError(f"--share {text}: '{one}' has a share or is rigid already")
            given[one] = _number(value, "--share", text)
    return [dataclasses.replace(body, share=given.get(body.name)) for body in bodies]


def pairs_asked(
    args: argparse.Namespace, names: list[str]
) -> tuple[list[tuple[str, str]], dict[tuple[str, str], float]]:
    """Return the pairs that may overlap, and the gaps of single pairs, that the command line names."""
    named = [pair for text in args.exclude for pair in _pairs(text, "--exclude", names)]
    exclude = list({frozenset(pair): pair for pair in named}.values())  # in either order it is one
    gaps = {}
    for text in args.pair_gap:
        both, value = _split(text, "--pair-gap", "A,B=G")
        for one, two in _pairs(both, "--pair-gap", names):
            if (one, two) in exclude or (two, one) in exclude:
                raise FemorsError(f"--pair-gap {text}: the pair is excluded; give it one or the other")
            gaps[one, two] = _number(value, "--pair-gap", text)
    return exclude, gaps


def _named(name: str, names: list[str]) -> list[str]:
    """Return the bodies that a name means: its own, or all parts of the deck of that name."""
    return [name] if name in names else [one for one in names if one.startswith(f"{name}:")]


def _known(name: str, names: list[str], option: str) -> list[str]:
    found = _named(name, names)
    if not found:
        raise FemorsError(f"{option} {name}: there is no such body; there are {', '.join(names)}")
    return found


def _split(text: str, option: str, form: str) -> tuple[str, str]:
    name, equals, value = text.rpartition("=")
    if not equals or not name:
        raise FemorsError(f"{option} {text}: {form} is needed")
    return name, value


def _pairs(text: str, option: str, names: list[str]) -> list[tuple[str, str]]:
    """Split a pair at the comma that leaves two known names, for names may have commas too.

    Decks stand for all of their parts.
    """
    cuts = [number for number, letter in enumerate(text) if letter == ","]
    for cut in cuts:
        ours, theirs = _named(text[:cut], names), _named(text[cut + 1 :], names)
        if ours and theirs:
            alone = ours == theirs and len(ours) == 1  # no pair, which is told where the bodies are known
            return [(one, two) for one in ours for two in theirs if one != two or alone]
    if len(cuts) == 1 and all(text.split(",")):
        unknown = next(name for name in text.split(",") if not _named(name, names))
        raise FemorsError(f"{option} {text}: there is no body '{unknown}'; there are {', '.join(names)}")
    raise FemorsError(f"{option} {text}: two names with a comma between them are needed")


def _number(value: str, option: str, text: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise FemorsError(f"{option} {text}: '{value}' is not a number") from None
