# SPDX-License-Identifier: GPL-3.0-or-later
"""All figures of one mesh, and of one mesh beside another; what the Quality panel shows."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .cleaning import Cleaned, clean, distinct_nodes
from .intersect import piercings, self_intersections
from .limits import require_nodes
from .mesh import Int, Surface
from .nearest import SurfaceIndex
from .overlap import Overlap, overlap
from .progress import FemorsError, Progress, part, silent
from .quality import (
    Stat,
    aspect_ratio,
    degenerate,
    dihedral_angles,
    edge_faults,
    flipped_faces,
    folded_faces,
    nearest_vertex_distance,
    skewness,
)
from .quantities import triangle_jacobians
from .units import BEYOND
from .volume_quality import VolumeQuality

WORST_ASPECT = 10.0
"""A longer face is bad, unless asked otherwise."""
MEMORY_LEAST, MEMORY_NODE = 10e6, 2.5e3  # bytes: what this was measured to take, and per node of both


@dataclasses.dataclass(frozen=True)
class Against:
    """A mesh beside another.

    Attributes
    ----------
    mesh_to_other, other_to_mesh : Stat
        Exact distance from the vertices of the one to the surface of the other.
    hausdorff : Stat
        From each vertex to the nearest vertex of the other (what the paper calls so).
    crossing : int
        Faces of the mesh that cross the other's.
    overlap : Overlap or None
        Volumes; None where one of the two is open, see `no_overlap`.
    no_overlap : str
        Why there are no volumes.
    movement : Stat or None
        Between vertices of the same number, where both have the same faces.
    flipped : int or None
        Faces folded over from the other to the mesh, where both have the same faces.
    """

    mesh_to_other: Stat
    other_to_mesh: Stat
    hausdorff: Stat
    crossing: int
    overlap: Overlap | None
    no_overlap: str
    movement: Stat | None
    flipped: int | None


@dataclasses.dataclass(frozen=True, eq=False)
class Examination:
    """The figures of a mesh.

    Attributes
    ----------
    vertices, faces, pieces : int
        Vertices are merged where they stand twice; faces are triangles; pieces are connected by edges.
    open_edges, nonmanifold_edges : int
        With one face only; with three or more.
    given_vertices : int
        As they stand in the file: every triangle of an STL brings three.
    size : float
        Diagonal of the bounding box.
    area : float
    volume : float or None
        Enclosed by it; None where it is open.
    edge, aspect, skewness, dihedral, scaled_jacobian : Stat
        Of edge lengths, of faces, of angles between faces (degrees).
    self_intersecting, folded, degenerate, slender : (k,) int32
        Faces, by number in the mesh as given: crossing others, turned against their surroundings,
        without area, and with an aspect ratio above the limit.
    elements : VolumeQuality or None
        Of the solid elements inside, where there are some.
    against : Against or None
    notes : tuple of str
    """

    vertices: int
    given_vertices: int
    faces: int
    pieces: int
    open_edges: int
    nonmanifold_edges: int
    size: float
    area: float
    volume: float | None
    edge: Stat
    aspect: Stat
    skewness: Stat
    dihedral: Stat
    scaled_jacobian: Stat
    self_intersecting: Int
    folded: Int
    degenerate: Int
    slender: Int
    elements: VolumeQuality | None
    against: Against | None
    notes: tuple[str, ...]

    @property
    def bad(self) -> Int:
        """(k,) the faces with any fault."""
        parts = (self.self_intersecting, self.folded, self.degenerate, self.slender)
        return np.unique(np.concatenate(parts)).astype(np.int32)

    def as_dict(self) -> dict[str, Any]:
        """Return everything but the face numbers, for JSON."""
        faults = {
            "self_intersecting": len(self.self_intersecting),
            "folded": len(self.folded),
            "degenerate": len(self.degenerate),
            "slender": len(self.slender),
        }
        stats = ("edge", "aspect", "skewness", "dihedral", "scaled_jacobian")
        out: dict[str, Any] = {
            "mesh": {
                "vertices": self.vertices,
                "given_vertices": self.given_vertices,
                "faces": self.faces,
                "pieces": self.pieces,
                "open_edges": self.open_edges,
                "nonmanifold_edges": self.nonmanifold_edges,
                "size": self.size,
                "area": self.area,
                "volume": self.volume,
            },
            "shape": {name: getattr(self, name).as_dict() for name in stats},
            "faults": faults,
        }
        if self.elements is not None:
            out["elements"] = self.elements.as_dict()
        if self.against is not None:
            out["against"] = dataclasses.asdict(self.against)
            if self.against.overlap is not None:
                out["against"]["overlap"]["dice"] = self.against.overlap.dice
        out["notes"] = list(self.notes)
        return out

    def summary(self) -> str:
        """Return the figures for a person: median [1st, 99th percentile] and maximum."""
        volume = "open" if self.volume is None else f"{self.volume:.6g}"
        merged = self.given_vertices > self.vertices
        rows = [
            ("vertices, faces, pieces", f"{self.vertices}, {self.faces}, {self.pieces}"),
            *([("vertices before merging", str(self.given_vertices))] if merged else []),
            ("open, non-manifold edges", f"{self.open_edges}, {self.nonmanifold_edges}"),
            ("area, volume", f"{self.area:.6g}, {volume}"),
            *((name.replace("_", " "), str(getattr(self, name))) for name in ("edge", "aspect", "skewness")),
            ("dihedral angle, degrees", str(self.dihedral)),
            ("scaled Jacobian", str(self.scaled_jacobian)),
            ("self-intersecting faces", str(len(self.self_intersecting))),
            ("folded, without area", f"{len(self.folded)}, {len(self.degenerate)}"),
            ("slender faces", str(len(self.slender))),
        ]
        if self.elements is not None:
            rows.append(("elements: scaled Jacobian", str(self.elements)))
            rows.append(("elements: inverted", str(self.elements.inverted)))
        if self.against is not None:
            rows += _rows(self.against)
        return "\n".join(f"{name:28}{value}" for name, value in rows)


def _rows(against: Against) -> list[tuple[str, str]]:
    rows = [
        ("mesh to other", str(against.mesh_to_other)),
        ("other to mesh", str(against.other_to_mesh)),
        ("nearest vertex", str(against.hausdorff)),
        ("faces crossing the other", str(against.crossing)),
    ]
    if against.overlap is None:
        rows.append(("XOR volume", against.no_overlap))
    else:
        both = against.overlap
        rows.append(("XOR volume", f"{both.xor:.6g} +- {both.xor_uncertainty:.2g}"))
        rows.append(("common volume, Dice", f"{both.common:.6g}, {both.dice:.4f}"))
    if against.movement is not None:
        rows.append(("movement", str(against.movement)))
        rows.append(("flipped faces", str(against.flipped)))
    return rows


def examine(
    surface: Surface,
    other: Surface | None = None,
    elements: VolumeQuality | None = None,
    worst_aspect: float = WORST_ASPECT,
    progress: Progress = silent,
) -> Examination:
    """Measure a mesh, and compare it with another.

    Parameters
    ----------
    surface, other : Surface
        As they are: unmerged, inverted or open.
    elements : VolumeQuality, optional
        Of the solid elements whose outer surface it is.
    worst_aspect : float
        Faces above count as slender.

    Raises
    ------
    FemorsError
        Not a surface: no faces, no extent; more memory needed than is allowed.
    Cancelled
        From `progress`.
    """
    nodes = distinct_nodes(surface) + (0 if other is None else distinct_nodes(other))
    require_nodes(nodes, "measuring a mesh", MEMORY_LEAST, MEMORY_NODE)
    progress(0.0, "cleaning")
    ours = clean(surface.vertices, surface.faces, "mesh")
    mesh = ours.surface
    progress(0.15, "faces that cross others")
    crossing = np.unique(self_intersections(mesh))
    progress(0.35, "shapes of faces")
    aspect = aspect_ratio(mesh)
    a, b = (mesh.vertices[mesh.edges[:, k]] for k in (0, 1))
    border, crowded = edge_faults(mesh)
    against = None
    if other is not None:
        against = _against(surface, ours, other, part(progress, 0.4, 1.0))
    progress(1.0, "done")
    return Examination(
        vertices=len(mesh.vertices),
        given_vertices=len(surface.vertices),
        faces=len(surface.faces),
        pieces=int(mesh.components.max()) + 1,
        open_edges=border,
        nonmanifold_edges=crowded,
        size=mesh.diagonal,
        area=float(mesh.face_areas.sum()),
        volume=None if mesh.border.any() else float(mesh.volume),
        edge=Stat.of(np.linalg.norm(a - b, axis=1)),
        aspect=Stat.of(aspect),
        skewness=Stat.of(skewness(mesh)),
        dihedral=Stat.of(dihedral_angles(mesh)),
        scaled_jacobian=Stat.of(triangle_jacobians(mesh)),
        self_intersecting=np.sort(ours.face_map[crossing]),
        folded=np.sort(ours.face_map[folded_faces(mesh)]),
        degenerate=np.flatnonzero(degenerate(surface)).astype(np.int32),
        slender=np.sort(ours.face_map[aspect > worst_aspect]),
        elements=elements,
        against=against,
        notes=(*ours.notes, *([] if other is None else _unlike(mesh, other))),
    )


def _unlike(mesh: Surface, other: Surface) -> list[str]:
    """Say where the sizes of two meshes differ beyond what anatomy has."""
    ratio = other.diagonal / mesh.diagonal
    if 1.0 / BEYOND <= ratio <= BEYOND:
        return []
    words = f"{max(ratio, 1.0 / ratio):.4g} times {'larger' if ratio > 1.0 else 'smaller'}"
    return [f"other mesh: is {words} than the mesh: are both in one unit of length?"]


def _against(surface: Surface, ours: Cleaned, other: Surface, progress: Progress) -> Against:
    theirs = clean(other.vertices, other.faces, "other mesh").surface
    mesh = ours.surface
    progress(0.1, "distances")
    there = SurfaceIndex(theirs).closest(mesh.vertices, part(progress, 0.1, 0.35)).distance
    back = SurfaceIndex(mesh).closest(theirs.vertices, part(progress, 0.35, 0.6)).distance
    nearest = nearest_vertex_distance(mesh.vertices, theirs.vertices)
    progress(0.6, "faces that cross the other mesh")
    through = np.concatenate((piercings(theirs, mesh).face, _with_edges(mesh, piercings(mesh, theirs).edge)))
    progress(0.75, "volumes")
    volumes, reason = None, ""
    try:
        volumes = overlap(mesh, theirs)
    except FemorsError as error:
        reason = str(error)
    movement = flipped = None
    if surface.faces.shape == other.faces.shape and np.array_equal(surface.faces, other.faces):
        movement = Stat.of(np.linalg.norm(surface.vertices - other.vertices, axis=1))
        flipped = len(flipped_faces(other, surface))
    return Against(
        mesh_to_other=Stat.of(there),
        other_to_mesh=Stat.of(back),
        hausdorff=Stat.of(nearest),
        crossing=len(np.unique(through)),
        overlap=volumes,
        no_overlap=reason,
        movement=movement,
        flipped=flipped,
    )


def _with_edges(mesh: Surface, edges: Int) -> Int:
    """Return the faces (k,) of a mesh that have one of the edges."""
    if not len(edges):
        return np.zeros(0, dtype=np.int32)
    count = len(mesh.vertices)
    chosen = mesh.edges[edges].astype(np.int64)
    half = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
    keys = np.sort(chosen, axis=1) @ [count, 1]
    return (np.flatnonzero(np.isin(half @ [count, 1], keys)) // 3).astype(np.int32)
