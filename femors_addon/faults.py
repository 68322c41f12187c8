# SPDX-License-Identifier: GPL-3.0-or-later
"""What is bad in a part of a mesh, and what becomes of it when some nodes move: looked at around these alone.

Ways to mend are many, and each moves few nodes: it costs as much as those nodes are, not as the part is.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from . import triples
from .balls import Balls, Index, size_classes
from .cached import cached_property
from .folds import Reference, folded
from .intersect import crossings_of
from .mesh import Float, Int, Surface
from .patches import Part, faces_at
from .quality import aspect_ratio, degenerate, inverted, opposed

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
        The whole mesh as it was in the source.
    reference : Reference
        The whole mesh as the displacement starts from.
    part : Part
        Of these.
    """

    def __init__(self, rest: Surface, reference: Reference, part: Part) -> None:
        self.part, self.rest = part, part.of(rest)
        self._whole, self.reference = reference, Reference(part.of(reference.surface))
        rest = self.rest
        self._slender = slender(rest)
        self._opposed, self._flat = opposed(rest), degenerate(rest)
        # components inside out are told by all of their faces: there may be some in a part of many
        self._closed = len(rest.closed) > 1 and bool(rest.closed.any())

    @property
    def aligned(self) -> Surface:
        """The part as the displacement starts from."""
        return self.reference.surface

    @cached_property
    def _crossing(self) -> Int:
        """Faces (q,) that cross others in the reference, wherever these are."""
        return np.flatnonzero(np.isin(self.part.faces, self._whole.crossing)).astype(np.int32)

    def state(self, positions: Float, known: Index) -> State:
        """Judge all faces at some positions (k, 3); crossings are looked for of the `known` (q,) alone."""
        surface = self.aligned.moved(positions)
        balls = size_classes(surface, np.arange(len(surface.faces)))
        out = self._state(surface, self._own(surface, slice(None)), crossings_of(surface, known, balls))
        out.__dict__["balls"] = balls
        return out

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
            bad[np.setdiff1d(np.unique(pairs), self._crossing)] = 1.0
        return State(surface, pairs, own, bad)

    def _own(self, moved: Surface, rows: NDArray | slice) -> Float:
        """How bad faces (r,) are but for crossings and components inside out; `rows` tells which they are."""
        out = SQUEEZED * (aspect_ratio(moved) > self._slender[rows])
        out[folded(self.reference, moved, rows)] = 1.0
        out[(opposed(moved) & ~self._opposed[rows]) | (degenerate(moved) & ~self._flat[rows])] = 1.0
        return np.asarray(out)

    def _crossed(self, state: State, surface: Surface, faces: Index) -> Int:
        """Return the pairs of faces (q, 2) that cross once some faces have moved; only those are tested."""
        moved = np.zeros(len(surface.faces), dtype=bool)
        moved[faces] = True
        kept = state.pairs[~moved[state.pairs].any(axis=1)]
        return np.concatenate((kept, crossings_of(surface, faces, state.balls)))


def slender(rest: Surface) -> Float:
    """Aspect ratio (m,) beyond which each face is far more slender than it was in the source."""
    return np.maximum(SLENDER, GROWTH * aspect_ratio(rest))
