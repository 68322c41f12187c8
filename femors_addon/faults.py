# SPDX-License-Identifier: GPL-3.0-or-later
"""What is bad in a part of a mesh, and what becomes of it when some nodes move: looked at around these alone.

Ways to mend are many, and each moves few nodes: it costs as much as those nodes are, not as the part is.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from . import triples
from .balls import Balls, size_classes, touching
from .cached import cached_property
from .folds import Reference, folded
from .intersect import self_intersections
from .mesh import Float, Int, Surface
from .patches import Part, faces_at
from .quality import aspect_ratio, closed_components, degenerate, inverted, opposed

SLENDER, GROWTH = 10.0, 3.0  # aspect ratio, and times that of the source, beyond which a face is squeezed
SQUEEZED = 0.1  # what a squeezed face counts beside one that is folded or crosses others


@dataclasses.dataclass(frozen=True, eq=False)
class State:
    """A part at some positions, and what is bad there.

    Attributes
    ----------
    surface : Surface
        The part (k nodes, j faces).
    pairs : (q, 2) int32
        Faces that cross.
    own : (j,) float64
        How bad each face is but for what it crosses.
    bad : (j,) float64
        1 for the faces folded over or crossing others, `SQUEEZED` for those squeezed, 0 for the others.
    """

    surface: Surface
    pairs: Int
    own: Float
    bad: Float

    @property
    def positions(self) -> Float:
        """Where the nodes (k, 3) are."""
        return self.surface.vertices

    @property
    def worst(self) -> Int:
        """Faces folded over or crossing others, ascending."""
        return np.flatnonzero(self.bad >= 1.0).astype(np.int32)

    @property
    def tally(self) -> tuple[int, float]:
        """How many faces are folded over or cross others, and how bad all faces are; the less the better."""
        return int((self.bad >= 1.0).sum()), float(self.bad.sum())

    @cached_property
    def balls(self) -> list[Balls]:
        """Balls around all faces."""
        return size_classes(self.surface, np.arange(len(self.surface.faces)))


class Judge:
    """Tells what is bad in a part of a mesh; what was so in the source, or in the reference, is not.

    Parameters
    ----------
    rest : Surface
        The part as it was in the source.
    reference : Reference
        The part as the displacement starts from.
    part : Part
    """

    def __init__(self, rest: Surface, reference: Reference, part: Part) -> None:
        self.rest, self.reference, self.part = rest, reference, part
        self._slender = slender(rest)
        self._opposed, self._flat = opposed(rest), degenerate(rest)
        # components inside out are told by all of their faces: there may be some in a part of many
        closed = closed_components(rest)
        self._closed = len(closed) > 1 and bool(closed.any())

    @property
    def aligned(self) -> Surface:
        """The part as the displacement starts from."""
        return self.reference.surface

    def state(self, positions: Float, pairs: Int | None = None) -> State:
        """Judge all faces at some positions (k, 3); `pairs` (q, 2) cross, if that is known."""
        surface = self.aligned.moved(positions)
        found = self_intersections(surface) if pairs is None else pairs
        return self._state(surface, self._own(surface, slice(None)), found)

    def after(self, state: State, positions: Float) -> State:
        """Judge anew where nodes are not where they are in `state`: their faces, and those around."""
        moved = np.flatnonzero(triples.some(positions != state.positions))
        if not len(moved):
            return state
        aligned = self.aligned
        surface = aligned.moved(positions)
        faces = faces_at(aligned, moved)
        # the normals at their corners tell of all faces there
        around = faces_at(aligned, aligned.faces[faces])
        known = faces_at(aligned, aligned.faces[around])
        nodes, corners = triples.renumbered(aligned.faces[known], len(positions))
        own = state.own.copy()
        some = self._own(Surface(positions[nodes], corners), known)
        own[around] = some[np.searchsorted(known, around)]
        return self._state(surface, own, self._crossed(state, surface, faces))

    def _state(self, surface: Surface, own: Float, pairs: Int) -> State:
        bad = own.copy()
        if self._closed:
            bad[inverted(self.rest, surface)] = 1.0
        bad[~self.part.whole] = 0.0
        if len(pairs):
            bad[np.setdiff1d(np.unique(pairs), self.reference.crossing)] = 1.0
        return State(surface, pairs, own, bad)

    def _own(self, moved: Surface, rows: Int | slice) -> Float:
        """How bad faces (r,) are but for crossings and components inside out; `rows` tells which they are."""
        out = SQUEEZED * (aspect_ratio(moved) > self._slender[rows])
        out[folded(self.reference, moved, rows)] = 1.0
        out[(opposed(moved) & ~self._opposed[rows]) | (degenerate(moved) & ~self._flat[rows])] = 1.0
        return np.asarray(out)

    def _crossed(self, state: State, surface: Surface, faces: Int) -> Int:
        """Return the pairs of faces (q, 2) that cross once some faces have moved; only those are tested."""
        moved = np.zeros(len(surface.faces), dtype=bool)
        moved[faces] = True
        near = moved.copy()
        # those that moved as well are in the state's balls where they were
        near[touching(state.balls, size_classes(surface, faces.astype(np.int64)))] = True
        some = np.flatnonzero(near)
        found = some[self_intersections(Surface(surface.vertices, surface.faces[some]))]
        found = found.astype(np.int32).reshape(-1, 2)
        kept = state.pairs[~moved[state.pairs].any(axis=1)]
        return np.concatenate((kept, found[moved[found].any(axis=1)]))


def slender(rest: Surface) -> Float:
    """Aspect ratio (m,) beyond which each face is far more slender than it was in the source."""
    return np.maximum(SLENDER, GROWTH * aspect_ratio(rest))
