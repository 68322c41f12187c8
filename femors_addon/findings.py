# SPDX-License-Identifier: GPL-3.0-or-later
"""What is found of two bodies that overlap, or are near each other."""

from __future__ import annotations

import dataclasses
from typing import Any

from .progress import counted

ROUNDING = 1e-2  # of a distance: a smaller difference is not worth a word
CLEAR, NEAR, OVERLAP, CONTAINED = "clear", "too near", "overlap", "contained"


@dataclasses.dataclass(frozen=True)
class Finding:
    """Two bodies that overlap, or are closer than the band.

    Attributes
    ----------
    one, two : str
        Names of the bodies.
    gap : float
        Least distance asked for of the nodes of one to the surface of the other, in the unit of the
        coordinates.
    least : float
        Smallest signed distance of a node of one to the surface of the other; negative inside.
    over : tuple of int
        Nodes of each body that are closer than the gap.
    crossings : int
        Pairs of triangles that cross.
    contained : str
        Name of the body of which a whole piece lies inside the other, "" where there is none.
    where : tuple of float
        Place of the smallest distance.
    shared : float or None
        Volume that both take up; None where it could not be computed.
    state : str
        "clear", "too near", "overlap" or "contained".
    surfaces_apart : float or None
        Least distance of the two surfaces, also between edges: `least`, or less; None unless clear.
    edge_depth : float
        How deep edges are inside the other body that go in and out again, at the middle of what is inside;
        measured where the state is "overlap". A coarse body may be deep in another with no node inside.
    """

    one: str
    two: str
    gap: float
    least: float
    over: tuple[int, int]
    crossings: int
    contained: str
    where: tuple[float, float, float]
    shared: float | None
    state: str
    surfaces_apart: float | None = None
    edge_depth: float = 0.0

    @property
    def names(self) -> tuple[str, str]:
        """Both names."""
        return self.one, self.two

    @property
    def depth(self) -> float:
        """How deep the deepest node is inside the other body; 0 where none is."""
        return max(0.0, -self.least)

    @property
    def edges_nearer(self) -> bool:
        """Whether edges are known to be nearer each other than any node is to the other surface."""
        return self.surfaces_apart is not None and self.surfaces_apart < (1.0 - ROUNDING) * self.least

    @property
    def deep(self) -> str:
        """The depth in words; of edges too where they are deeper than any node."""
        if self.edge_depth <= (1.0 + ROUNDING) * self.depth:
            return f"{self.depth:.4g} deep"
        nodes = f"{self.depth:.4g} deep at nodes, " if self.depth > 0 else ""
        return f"{nodes}{self.edge_depth:.4g} {'' if nodes else 'deep '}on edges"

    @property
    def clear(self) -> bool:
        """Whether nothing crosses, nothing is contained, and every node keeps the gap."""
        return self.state == CLEAR

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {**dataclasses.asdict(self), "depth": self.depth}

    def __str__(self) -> str:
        if self.state == CLEAR:
            edges = f" at nodes, {self.surfaces_apart:.4g} between edges" if self.edges_nearer else ""
            return f"{self.one} - {self.two}: clear, {self.least:.4g} apart{edges}"
        words = [f"{counted(self.over[0] + self.over[1], 'node')} closer than {self.gap:g}"]
        if self.depth > 0 or self.edge_depth > 0:
            words.insert(0, self.deep)
        if self.crossings:
            words.append(counted(self.crossings, "crossing pair of triangles", "crossing pairs of triangles"))
        if self.shared:
            words.append(f"shared volume {self.shared:.4g}")
        if self.contained:
            words.append(f"a piece of '{self.contained}' lies wholly inside the other")
        place = ", ".join(f"{x:.4g}" for x in self.where)
        return f"{self.one} - {self.two}: {self.state}, {', '.join(words)}, at ({place})"


@dataclasses.dataclass(frozen=True)
class Excluded:
    """A pair that may overlap, and how deep it does (0 where it does not), before and after."""

    one: str
    two: str
    depth_before: float
    depth_after: float
