# SPDX-License-Identifier: GPL-3.0-or-later
"""What is found of two bodies that overlap, or are near each other."""

from __future__ import annotations

import dataclasses
from typing import Any

from .progress import counted

CLEAR, NEAR, OVERLAP, CONTAINED = "clear", "too near", "overlap", "contained"


@dataclasses.dataclass(frozen=True)
class Finding:
    """Two bodies that overlap, or are closer than the band.

    Attributes
    ----------
    one, two : str
        Names of the bodies.
    gap : float
        Least distance asked for, in the unit of the coordinates.
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

    @property
    def names(self) -> tuple[str, str]:
        """Both names."""
        return self.one, self.two

    @property
    def depth(self) -> float:
        """How deep the deepest node is inside the other body; 0 where none is."""
        return max(0.0, -self.least)

    @property
    def clear(self) -> bool:
        """Whether nothing crosses, nothing is contained, and the gap holds."""
        return self.state == CLEAR

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {**dataclasses.asdict(self), "depth": self.depth}

    def __str__(self) -> str:
        if self.state == CLEAR:
            return f"{self.one} - {self.two}: clear, {self.least:.4g} apart"
        words = [f"{counted(self.over[0] + self.over[1], 'node')} closer than {self.gap:g}"]
        if self.depth > 0:
            words.insert(0, f"{self.depth:.4g} deep")
        if self.crossings:
            words.append(counted(self.crossings, "crossing pair of triangles", "crossing pairs of triangles"))
        if self.shared:
            words.append(f"shared volume {self.shared:.4g}")
        if self.contained:
            words.append(f"a piece of '{self.contained}' lies wholly inside the other")
        place = ", ".join(f"{x:.4g}" for x in self.where)
        return f"{self.one} - {self.two}: {self.state}, {', '.join(words)}, at ({place})"
