# SPDX-License-Identifier: GPL-3.0-or-later
"""The figures of a body after a removal: how far it moved, what it lost, how its elements are."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from . import booleans, triples
from .bodies import Solid
from .crew import together
from .cutouts import Region, normals_at
from .distances import Target
from .findings import Finding
from .intersect import crossings
from .mesh import Float, Surface
from .quality import Stat, aspect_ratio, dihedral_angles
from .rays import first_hits
from .separation import thickness
from .volume import Ids, VolumeMesh
from .volume_quality import VolumeQuality

if TYPE_CHECKING:
    from .effort import Effort

LOST = 0.1  # of its volume: a body that lost more is told, with a certificate too
SAMPLE = 100  # nodes of a body at which its thickness is measured
RAY = 2.5  # mean thicknesses: how far the other side is looked for


@dataclasses.dataclass(frozen=True, eq=False)
class BodyResult:
    """A body after a removal.

    Attributes
    ----------
    name, share : str, float
    mesh : Surface or VolumeMesh
        At its new positions; the very object that was given where nothing moved.
    nodes : (n, 3) float64
        Positions, in the body's own order; what did not move has the very bits that were given.
    count, moved : int
        Nodes, and those that moved; at one place counted once where triangles are not merged (STL).
    movement : Stat
        Distances that those moved, in the unit of the coordinates.
    aspect, dihedral : (Stat, Stat)
        Aspect ratio and dihedral face angle (degrees) of the surface, before and after.
    volume : (float, float)
        Enclosed by the surface, before and after.
    xor : float or None
        Volume that is in one of the old and the new shape only, as a share of the old volume; None
        where it could not be computed.
    thickness : (Stat, Stat) or None
        Through the body, from nodes that were in contact along their normals, before and after.
    thinned : float
        Largest share of its thickness that such a node has lost.
    settled : Stat or None
        Distance from the nodes that were too near to the body that they were too near to, afterwards.
    elements : (VolumeQuality, VolumeQuality) or None
        Of the solid elements that were valid on input, before and after.
    inverted_input, inverted_new : (k,) int64
        Ids of elements inverted from the start, and by the removal.
    inverted : int
        How many elements are inverted in the result; one that was on input may have become valid.
    held : int
        Nodes that were held back on their way, so that no element is inverted.
    folded : int
        Faces that cross others of the same body now, and did not before.
    """

    name: str
    share: float
    mesh: Surface | VolumeMesh
    nodes: Float
    count: int
    moved: int
    movement: Stat
    aspect: tuple[Stat, Stat]
    dihedral: tuple[Stat, Stat]
    volume: tuple[float, float]
    xor: float | None
    thickness: tuple[Stat, Stat] | None
    thinned: float
    settled: Stat | None
    elements: tuple[VolumeQuality, VolumeQuality] | None
    inverted_input: Ids
    inverted_new: Ids
    inverted: int
    held: int
    folded: int

    def report(self) -> dict[str, Any]:
        """Return everything but meshes and arrays, for JSON."""
        pairs = {
            name: None if pair is None else {"before": pair[0].as_dict(), "after": pair[1].as_dict()}
            for name, pair in (
                ("aspect", self.aspect),
                ("dihedral", self.dihedral),
                ("thickness", self.thickness),
                ("scaled_jacobian", self.elements),
            )
        }
        elements = pairs["scaled_jacobian"]
        if elements is not None:  # these figures leave out what was inverted on input
            elements["before"]["inverted"] = len(self.inverted_input)
            elements["after"]["inverted"] = self.inverted
        return {
            "name": self.name,
            "share": self.share,
            "rigid": self.share == 0.0,
            "nodes": self.count,
            "nodes_moved": self.moved,
            "movement": self.movement.as_dict(),
            **pairs,
            "volume": {"before": self.volume[0], "after": self.volume[1]},
            "xor": self.xor,
            "thickness_lost": self.thinned,
            "settled": None if self.settled is None else self.settled.as_dict(),
            "inverted_on_input": self.inverted_input.tolist(),
            "newly_inverted": self.inverted_new.tolist(),
            "nodes_held_back": self.held,
            "newly_self_crossing": self.folded,
        }

    def __str__(self) -> str:
        if not self.moved:
            return f"{self.name}: {'rigid' if self.share == 0 else 'not moved'}"
        words = [f"{self.moved} of {self.count} nodes moved by up to {self.movement.maximum:.4g}"]
        if self.xor is not None:
            words.append(f"XOR {100 * self.xor:.3g} %")
        if self.settled is not None:
            low, high = self.settled.p01, self.settled.p99
            words.append(f"contact at {self.settled.median:.3g} [{low:.3g}, {high:.3g}]")
        if self.thickness is not None:
            words.append(f"thinned by up to {100 * self.thinned:.0f} %")
        if self.elements is not None:
            before, after = self.elements
            words.append(f"scaled Jacobian min {before.minimum:.3f} -> {after.minimum:.3f}")
        if len(self.inverted_input):
            words.append(f"inverted before, not in these: {len(self.inverted_input)}")
        return f"{self.name}: {', '.join(words)}"


# --- made from the bodies at work -----------------------------------------------------------------------
def figures_of(solid: Solid, efforts: Sequence[Effort]) -> BodyResult:
    """Return the figures of a body, from where it began to where it is."""
    old, nodes, once = solid.begun_surface.bare(), solid.nodes, solid.once
    distance = np.linalg.norm((nodes - solid.body.nodes)[once], axis=1)
    moved = distance > 0
    same = not moved.any()
    _ = old.edge_faces  # known to both
    new = old if same else old.moved(solid.surface.vertices)
    jobs: list[Callable[[], Any]] = [partial(_shape, old)]
    if not same:
        jobs += [
            partial(_shape, new),
            partial(booleans.xor_volume, old, new),
            partial(_touched, solid, efforts, old, new),
            partial(_folded, old, new),
        ]
    shape, shape_now, xor, contact, folded = (
        together(jobs) if not same else (*together(jobs), None, 0.0, (None, 0.0, None), 0)
    )
    (aspect, dihedral, volume), (aspect_now, dihedral_now, volume_now) = shape, shape_now or shape
    thickness, thinned, settled = contact
    ids = np.zeros(0, np.int64) if solid.mesh is None else solid.mesh.element_ids
    inverted = solid.inverted()
    return BodyResult(
        name=solid.name,
        share=solid.share,
        mesh=solid.result,
        nodes=nodes,
        count=len(once),
        moved=int(moved.sum()),
        movement=Stat.of(distance[moved]),
        aspect=(aspect, aspect_now),
        dihedral=(dihedral, dihedral_now),
        volume=(volume, volume_now),
        xor=None if xor is None or not volume > 0 else xor / volume,
        thickness=thickness,
        thinned=thinned,
        settled=settled,
        elements=_elements(solid, nodes),
        inverted_input=np.asarray(ids[solid.inverted_input]),
        inverted_new=np.asarray(ids[np.setdiff1d(inverted, solid.inverted_input)]),
        inverted=len(inverted),
        held=len(solid.held),
        folded=folded,
    )


def losses_of(bodies: Sequence[BodyResult], solids: Sequence[Solid]) -> list[str]:
    """Tell which bodies have lost much of their volume, and how much: no certificate speaks of that."""
    told = []
    for body, solid in zip(bodies, solids, strict=True):
        before, after = body.volume
        if before > 0 and not solid.open_edges and before - after > LOST * before:  # a sheet has no volume
            share = 100.0 * (before - after) / before
            told.append(
                f"'{body.name}' has lost {share:.1f} % of its volume ({before:.4g} to {after:.4g}): "
                "does the right body give way?"
            )
    return told


def mid_sides_of(solids: Sequence[Solid], findings: Sequence[Finding]) -> list[str]:
    """Tell where mid-side nodes of quadratic elements are nearer than the gap, of the pairs that are clear.

    Gaps are asked for, and certified, at the corner nodes alone.
    """
    of = {solid.name: solid for solid in solids}
    told = []
    for finding in findings:
        for name, other in (finding.names, finding.names[::-1]) if finding.clear else ():
            least = _nearest_mid_side(of[name], of[other], finding.least)
            if least is not None and least < finding.gap:
                place = f"{least:.4g} away from" if least > 0 else f"{-least:.4g} deep in"
                told.append(
                    f"gaps are those of corner nodes: a mid-side node of '{name}' is {place} '{other}', "
                    f"where {finding.gap:g} is asked for"
                )
    return told


def _nearest_mid_side(solid: Solid, other: Solid, least: float) -> float | None:
    """Signed distance to another body of the mid-side node on the surface that is nearest to it.

    None where there are none beside it; `least` is the distance of the nearest corner.
    """
    if solid.mesh is None or not len(solid.mesh.mid_nodes):
        return None
    shell, on = solid.mesh.surface()
    mid, *ends = solid.mesh.mid_nodes.T
    count = len(solid.mesh.nodes)
    outer = np.sort(on[shell.edges].astype(np.int64), axis=1) @ (count, 1)
    points = solid.nodes[mid[np.isin(np.column_stack(ends).astype(np.int64) @ (count, 1), outer)]]
    low, high = other.surface.bounds
    away = triples.length(np.maximum(np.maximum(low - points, points - high), 0.0))  # from its box
    points = points[away <= max(least, 0.0) + solid.longest_now]
    return float(Target(other).near(points).min()) if len(points) else None


def _shape(surface: Surface) -> tuple[Stat, Stat, float]:
    """Aspect ratio, dihedral angle and volume of a surface."""
    return Stat.of(aspect_ratio(surface)), Stat.of(dihedral_angles(surface)), surface.volume


def _elements(solid: Solid, nodes: Float) -> tuple[VolumeQuality, VolumeQuality] | None:
    """Quality of the solid elements that were valid on input, before and after."""
    mesh = solid.mesh
    if mesh is None or not mesh.solid:
        return None
    valid = np.ones(mesh.element_count, dtype=bool)
    valid[solid.inverted_input] = False
    before, after = together([partial(VolumeQuality.of, m, valid) for m in (mesh, mesh.moved(nodes))])
    return before, after


def _touched(
    solid: Solid, efforts: Sequence[Effort], old: Surface, new: Surface
) -> tuple[tuple[Stat, Stat] | None, float, Stat | None]:
    """Return (thickness, share lost, distance from the other body) where a body was too near another."""
    rows, settled = _contact(solid, efforts)
    return *_thickness(old, new, rows), Stat.of(settled) if len(settled) else None


def _contact(solid: Solid, efforts: Sequence[Effort]) -> tuple[np.ndarray, Float]:
    """Return the vertices of a body that were too near another, and how far from it they are now."""
    rows, gaps = [np.zeros(0, np.int64)], [np.zeros(0)]
    for effort in efforts:
        for side in effort.pair.sides:
            mine = np.flatnonzero(side.ever) if side.body is solid else rows[0]
            if len(mine):
                rows.append(mine)
                gaps.append(Target(side.other).near(solid.vertices[mine]))
    return np.unique(np.concatenate(rows)), np.concatenate(gaps)


def _folded(old: Surface, new: Surface) -> int:
    """Return how many faces, of those that moved, cross others that moved and did not before."""
    moved = (old.vertices != new.vertices).any(axis=1)[new.faces].any(axis=1)
    one, two = (Surface(s.vertices, s.faces[moved]) for s in (old, new))
    after = crossings(two, two)
    if not len(after):
        return 0
    return len(np.setdiff1d(np.unique(after), np.unique(crossings(one, one))))


def _thickness(old: Surface, new: Surface, rows: np.ndarray) -> tuple[tuple[Stat, Stat] | None, float]:
    """Thickness of a body inward from vertices (k,), before and after, and the largest share lost."""
    rows = rows[:: max(1, -(-len(rows) // SAMPLE))]
    if not len(rows):
        return None, 0.0
    before, after = (_through(surface, rows) for surface in (old, new))
    both = np.isfinite(before) & np.isfinite(after)
    if not both.any():
        return None, 0.0
    before, after = before[both], after[both]
    return (Stat.of(before), Stat.of(after)), float(max(0.0, (1.0 - after / before).max()))


def _through(surface: Surface, rows: np.ndarray) -> Float:
    """Distance (k,) from vertices straight inward to the other side; infinite where there is none."""
    start, inward = surface.vertices[rows], -normals_at(surface, rows)
    length = RAY * thickness(surface)
    off = 1e-6 * length
    start = start + off * inward
    low, high = triples.box(np.concatenate((start, start + length * inward)))
    return off + first_hits(start, inward, length, Region.of(surface, low, high).surface)
