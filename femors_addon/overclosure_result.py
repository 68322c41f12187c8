# SPDX-License-Identifier: GPL-3.0-or-later
"""What comes back from a removal: the bodies, the certificate or the reasons, and the figures."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from . import booleans
from .bodies import Solid
from .contact import Region
from .intersect import crossings, piercings
from .mesh import Float, Surface
from .nearest import SurfaceIndex
from .overclosure_check import CONTAINED, NEAR, Finding
from .overclosure_settings import OverclosureSettings
from .quality import Stat, aspect_ratio, dihedral_angles
from .separation import thickness
from .volume import Ids, VolumeMesh
from .volume_quality import VolumeQuality

if TYPE_CHECKING:
    from .effort import Effort

SAMPLE = 100  # nodes of a body at which its thickness is measured
ALIKE = 0.9  # of the smaller body's volume: bodies that share more look like one
WIDE = 0.1  # of the smaller body's size: a gap above it looks like one in another unit
UNLIKE = 200.0  # times the size of another body: more looks like another unit of length
RAY = 2.5  # mean thicknesses: how far the other side is looked for
METHODS = {"grnn": "smooth field", "nodal": "nodal method", "published": "loop as published"}


@dataclasses.dataclass(frozen=True)
class Step:
    """One iteration: the largest depth still missing, edges that pierced, and the largest spread."""

    number: int
    missing: float
    pierced: int
    spread: float


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
    moved : int
        Nodes that moved.
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
    held : int
        Nodes that were held back on their way, so that no element is inverted.
    folded : int
        Faces that cross others of the same body now, and did not before.
    """

    name: str
    share: float
    mesh: Surface | VolumeMesh
    nodes: Float
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
        return {
            "name": self.name,
            "share": self.share,
            "rigid": self.share == 0.0,
            "nodes": len(self.nodes),
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


@dataclasses.dataclass(frozen=True, eq=False)
class OverclosureResult:
    """What a removal has done.

    Attributes
    ----------
    bodies : tuple of BodyResult
        In the order given.
    before, after : tuple of Finding
        Pairs that overlapped or were close; the second is the certificate's own measure.
    certified : bool
        Whether every pair is clear and no element was inverted.
    reasons : tuple of str
        Why it is not certified, pair by pair; empty where it is.
    history : tuple of Step
    spread : float
        Largest spread of a field: farther than three of it from contact nothing moved.
    notes : tuple of str
        What was mended for the maths, and what else the user should know.
    seconds : float
        CPU time, figures included.
    solve_seconds : float
        CPU time from the input to the certificate.
    """

    bodies: tuple[BodyResult, ...]
    before: tuple[Finding, ...]
    after: tuple[Finding, ...]
    certified: bool
    reasons: tuple[str, ...]
    settings: OverclosureSettings
    history: tuple[Step, ...]
    spread: float
    notes: tuple[str, ...]
    seconds: float = 0.0
    solve_seconds: float = 0.0

    @property
    def untouched(self) -> bool:
        """Whether nothing had to be moved."""
        return not any(body.moved for body in self.bodies)

    @property
    def certificate(self) -> str:
        """The verdict in words."""
        if not self.certified:
            return "NOT CERTIFIED: " + "; ".join(self.reasons)
        least = min((finding.least for finding in self.after), default=None)
        gap = "no two bodies are near each other"
        if least is not None:
            gap = f"the smallest gap is {least if least > 1e-12 else 0.0:.5g}"
        words = f"CERTIFIED: nothing crosses, nothing is contained, no element was inverted; {gap}"
        return words if not self.untouched else f"{words}; nothing had to be moved"

    def report(self) -> dict[str, Any]:
        """Return everything but meshes and arrays, for JSON."""
        return {
            "certified": self.certified,
            "certificate": self.certificate,
            "reasons": list(self.reasons),
            "pairs": {
                "before": [finding.as_dict() for finding in self.before],
                "after": [finding.as_dict() for finding in self.after],
            },
            "bodies": [body.report() for body in self.bodies],
            "settings": dataclasses.asdict(self.settings),
            "history": [dataclasses.asdict(step) for step in self.history],
            "iterations": len(self.history),
            "spread": self.spread,
            "warnings": list(self.notes),
            "cpu_seconds": round(self.seconds, 3),
            "solve_cpu_seconds": round(self.solve_seconds, 3),
        }

    def summary(self) -> str:
        """Return the pairs, the bodies and the verdict, for a person."""
        lines = ["before:", *(f"  {finding}" for finding in self.before or ("no two bodies are near",))]
        if not self.untouched:
            lines += ["after:", *(f"  {finding}" for finding in self.after)]
            lines += ["bodies:", *(f"  {_line(body)}" for body in self.bodies)]
        method = METHODS[self.settings.method]
        return "\n".join(
            [
                *lines,
                f"{self.certificate} ({method}, {len(self.history)} iterations, "
                f"{self.solve_seconds:.1f} s of CPU time, {self.seconds:.1f} s with all figures)",
            ]
        )


def _line(body: BodyResult) -> str:
    if not body.moved:
        return f"{body.name}: {'rigid' if body.share == 0 else 'not moved'}"
    words = [f"{body.moved} of {len(body.nodes)} nodes moved by up to {body.movement.maximum:.4g}"]
    if body.xor is not None:
        words.append(f"XOR {100 * body.xor:.3g} %")
    if body.settled is not None:
        words.append(f"contact at {body.settled.median:.3g} [{body.settled.p01:.3g}, {body.settled.p99:.3g}]")
    if body.thickness is not None:
        words.append(f"thinned by up to {100 * body.thinned:.0f} %")
    if body.elements is not None:
        before, after = body.elements
        words.append(f"scaled Jacobian min {before.minimum:.3f} -> {after.minimum:.3f}")
    if len(body.inverted_input):
        words.append(f"{len(body.inverted_input)} elements inverted before are left alone")
    return f"{body.name}: {', '.join(words)}"


# --- made from the bodies at work ---------------------------------------------------------------------
def result_of(
    solids: Sequence[Solid],
    before: Sequence[Finding],
    after: Sequence[Finding],
    efforts: Sequence[Effort],
    settings: OverclosureSettings,
    history: tuple[Step, ...],
    stop: str,
) -> OverclosureResult:
    """Put the result together; `stop` says why the loop ended early, or is ""."""
    bodies = tuple(_body(solid, efforts) for solid in solids)
    reasons = [_reason(finding, solids, after, stop) for finding in after if not finding.clear]
    reasons += [
        f"'{body.name}': {len(body.inverted_new)} elements inverted (first: {int(body.inverted_new[0])})"
        for body in bodies
        if len(body.inverted_new)
    ]
    return OverclosureResult(
        bodies=bodies,
        before=tuple(before),
        after=tuple(after),
        certified=not reasons,
        reasons=tuple(reasons),
        settings=settings,
        history=history,
        spread=max((effort.widest for effort in efforts), default=0.0),
        notes=(*notes_of(solids, before), *_folds(bodies)),
    )


def _body(solid: Solid, efforts: Sequence[Effort]) -> BodyResult:
    old, new, nodes = solid.begun_surface, solid.surface, solid.nodes
    distance = np.linalg.norm(nodes - solid.body.nodes, axis=1)
    moved = distance > 0
    touched, settled = _contact(solid, efforts)
    thickness, thinned = _thickness(old, new, touched) if moved.any() else (None, 0.0)
    elements = None
    if solid.mesh is not None and solid.mesh.solid:
        valid = np.ones(solid.mesh.element_count, dtype=bool)
        valid[solid.inverted_input] = False
        elements = (
            VolumeQuality.of(solid.mesh, valid),
            VolumeQuality.of(solid.mesh.moved(nodes), valid),
        )
    ids = np.zeros(0, np.int64) if solid.mesh is None else solid.mesh.element_ids
    xor = booleans.xor_volume(old, new) if moved.any() else 0.0
    same = not moved.any()
    aspect, dihedral = Stat.of(aspect_ratio(old)), Stat.of(dihedral_angles(old))
    return BodyResult(
        name=solid.name,
        share=solid.share,
        mesh=solid.result,
        nodes=nodes,
        moved=int(moved.sum()),
        movement=Stat.of(distance[moved]),
        aspect=(aspect, aspect if same else Stat.of(aspect_ratio(new))),
        dihedral=(dihedral, dihedral if same else Stat.of(dihedral_angles(new))),
        volume=(old.volume, new.volume),
        xor=None if xor is None or not old.volume > 0 else xor / old.volume,
        thickness=thickness,
        thinned=thinned,
        settled=None if same or not len(settled) else Stat.of(settled),
        elements=elements,
        inverted_input=np.asarray(ids[solid.inverted_input]),
        inverted_new=np.asarray(ids[solid.inverted_new()]),
        held=len(solid.held),
        folded=0 if same else _folded(old, new),
    )


def _contact(solid: Solid, efforts: Sequence[Effort]) -> tuple[np.ndarray, Float]:
    """Return the vertices of a body that were too near another, and how far from it they are now."""
    rows, gaps = [np.zeros(0, np.int64)], [np.zeros(0)]
    for effort in efforts:
        for side in effort.pair.sides:
            mine = np.flatnonzero(side.ever) if side.body is solid else rows[0]
            if len(mine):
                rows.append(mine)
                gaps.append(SurfaceIndex(side.other.surface).signed(solid.vertices[mine]))
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
    """Distance (k,) from vertices straight inward to the other side; infinite where there is none.

    Each ray is an edge of a thin triangle, so that `piercings` finds what it meets.
    """
    start, inward = surface.vertices[rows], -surface.vertex_normals[rows]
    length = RAY * thickness(surface)
    across = np.cross(inward, np.roll(inward, 1, axis=1) + [0.3, 0.5, 0.7])
    near = start + 1e-6 * length * inward
    tips = np.concatenate((near, start + length * inward, near + 1e-9 * length * across))
    count = len(rows)
    needles = Surface(tips, np.arange(3 * count).reshape(3, count).T)
    box = tips.min(axis=0), tips.max(axis=0)
    found = piercings(needles, Region.of(surface, *box).surface)
    ends = needles.edges[found.edge]
    ray = (ends[:, 0] < count) & (ends[:, 1] == ends[:, 0] + count)  # from the near end to the far one
    out = np.full(count, np.inf)
    np.minimum.at(out, ends[ray, 0], found.t[ray] * length)
    return out


def _reason(finding: Finding, solids: Sequence[Solid], after: Sequence[Finding], stop: str) -> str:
    """Say why a pair is not clear."""
    of = {solid.name: solid for solid in solids}
    one, two = of[finding.one], of[finding.two]
    place = ", ".join(f"{x:.4g}" for x in finding.where)
    where = f"'{one.name}' and '{two.name}' at ({place})"
    if finding.state == CONTAINED:
        inner = f"a piece of '{finding.contained}' lies inside the other"
        return f"{where}: {inner}; move it out or exclude the pair"
    if one.share == two.share == 0:
        return f"{where}: both are rigid and {finding.depth:.4g} deep; let one deform or exclude the pair"
    left = f"{finding.depth:.4g} deep, {finding.crossings} pairs of triangles cross"
    if finding.state == NEAR:
        left = f"{finding.least:.4g} apart where {finding.gap:g} is asked for"
    for body, other in ((one, two), (two, one)):
        rivals = [
            name
            for f in after
            if not f.clear and body.name in f.names
            for name in f.names
            if name not in (body.name, other.name) and of[name].share == 0
        ]
        if rivals and other.share == 0:
            return f"{where}: {left}; '{body.name}' is pinched between rigid '{other.name}' and '{rivals[0]}'"
    if finding.state == NEAR:
        return f"{where}: {left}; the gap may be larger than the room there ({stop or 'stopped'})"
    held = [solid.name for solid in (one, two) if solid.held]
    if held:
        return f"{where}: {left}; elements of '{held[0]}' would be inverted ({stop or 'stopped'})"
    return f"{where}: {left} ({stop or 'stopped'})"


def _folds(bodies: Sequence[BodyResult]) -> list[str]:
    return [
        f"{body.name}: {body.folded} faces cross others of the same body since"
        for body in bodies
        if body.folded
    ]


def notes_of(solids: Sequence[Solid], before: Sequence[Finding]) -> list[str]:
    """Return what the user should know of bodies and of what was found among them, in words."""
    notes = [note for solid in solids for note in solid.notes]
    for solid in solids:
        if solid.open_edges:
            notes.append(
                f"{solid.name}: the surface is open ({solid.open_edges} border edges); its normals tell "
                "which side is inside, and bodies wholly inside it are not found"
            )
        if len(solid.inverted_input):
            notes.append(
                f"{solid.name}: {len(solid.inverted_input)} elements were inverted before; left alone"
            )
        crossed = _crossed(solid, solids, before)
        if crossed:
            notes.append(
                f"{solid.name}: {crossed} faces near the overclosure crossed others of the same body before; "
                "which side is inside is uncertain there"
            )
    sizes = sorted((solid.begun_surface.diagonal, solid.name) for solid in solids)
    if sizes[0][0] * UNLIKE < sizes[-1][0]:
        notes.append(
            f"'{sizes[-1][1]}' is {sizes[-1][0] / sizes[0][0]:.0f} times as large as '{sizes[0][1]}': "
            "are all bodies in one unit of length?"
        )
    of = {solid.name: solid.begun_surface for solid in solids}
    for finding in before:
        smaller = min((of[name] for name in finding.names), key=lambda s: abs(s.volume))
        if finding.shared is not None and finding.shared > ALIKE * abs(smaller.volume) > 0:
            notes.append(f"{finding.one} and {finding.two}: take up nearly the same room; are they one body?")
        size = min(of[name].diagonal for name in finding.names)
        if finding.gap > WIDE * size:
            notes.append(
                f"{finding.one} and {finding.two}: the gap of {finding.gap:g} is {finding.gap / size:.0%} of "
                "the smaller body's size; is it in the bodies' unit?"
            )
    if not booleans.available() and before:
        notes.append(booleans.MISSING)
    return notes


def _crossed(solid: Solid, solids: Sequence[Solid], before: Sequence[Finding]) -> int:
    """Return how many faces of a body cross others of it where its box meets that of one it overlaps."""
    crossed = 0
    surface = solid.begun_surface
    for finding in before:
        if solid.name in finding.names and not finding.clear:
            other = next(s for s in solids if s.name in finding.names and s is not solid).begun_surface
            low = np.maximum(surface.bounds[0], other.bounds[0])
            high = np.minimum(surface.bounds[1], other.bounds[1])
            near = Region.of(surface, low, high).surface
            crossed = max(crossed, len(np.unique(crossings(near, near))))
    return crossed
