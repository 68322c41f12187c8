# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies that touch: what a user gives, and the same as points that an algorithm may move."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from . import triples
from .cleaning import clean, distinct_nodes
from .cutouts import normals_at
from .mesh import Float, Int, Surface
from .nearest import Closest
from .progress import FemorsError, Progress, silent
from .quality import edge_faults
from .volume import VolumeMesh, carry_mid_nodes
from .volume_quality import scaled_jacobians
from .volume_shapes import reshaped

BACK = 0.6  # share of its step that a node of an inverted element keeps, per attempt
ATTEMPTS = 6  # attempts before such a node stays where it was
LEAST = 0.02  # scaled Jacobian that a valid element keeps, at least, or half of its own where that is less


@dataclasses.dataclass(frozen=True, eq=False)
class Body:
    """A body that may overlap others.

    Parameters
    ----------
    name : str
        Unique among the bodies of a call.
    mesh : Surface or VolumeMesh
        A closed surface, or finite elements that have one.
    share : float, optional
        In [0, 1]: 0 is rigid; of a pair, each body moves by its share of their sum (alpha and 1 - alpha).
        Where it is not given: what the other of two bodies leaves of 1, else 0.5.
    """

    name: str
    mesh: Surface | VolumeMesh
    share: float | None = None

    def __post_init__(self) -> None:
        if self.share is not None and not 0.0 <= self.share <= 1.0:
            raise FemorsError(f"{self.name}: its share is {self.share:g}; it must be from 0 (rigid) to 1")

    @property
    def nodes(self) -> Float:
        """(n, 3) float64 positions of its nodes or vertices."""
        return self.mesh.vertices if isinstance(self.mesh, Surface) else self.mesh.nodes


def shares(bodies: list[Body]) -> list[float]:
    """Return the share of each body, with those that were not given."""
    given = [body.share for body in bodies]
    if len(bodies) == 2 and None in given:
        other = next((share for share in given if share is not None), 0.5)
        return [1.0 - other if share is None else share for share in given]
    return [0.5 if share is None else share for share in given]


class Solid:
    """A body at work: its moving points, its cleaned outward surface, and its elements.

    Attributes
    ----------
    points : (p, 3) float64
        Current positions: of the nodes, those at one place being one point.
    rest : (p, 3) float64
        Where they began.
    corner : (k,) int32
        The point of each vertex of the cleaned surface.
    faces : (m, 3) int32
        Its triangles, by vertex of the cleaned surface.
    notes : tuple of str
        What was mended for the maths, in words.
    edge, longest : float
        Mean and greatest length of the surface's edges at the start.
    held : set of int
        Points that were stopped on their way to keep elements valid.
    version : int
        Grows with every movement.
    """

    def __init__(self, body: Body, share: float) -> None:
        self.body, self.name, self.share = body, body.name, share
        self.mesh: VolumeMesh | None = None
        if isinstance(body.mesh, VolumeMesh):  # sets have no part in this, and cost time
            self.mesh = dataclasses.replace(body.mesh, node_sets={}, element_sets={}, surfaces={})
        try:
            shell, on = (body.mesh, None) if isinstance(body.mesh, Surface) else body.mesh.surface()
        except FemorsError as error:
            raise FemorsError(f"{body.name}: {error}") from None
        cleaned = clean(shell.vertices, shell.faces, body.name)
        self.notes = cleaned.notes
        self.faces = cleaned.surface.faces
        self.open_edges = int(cleaned.surface.border.any()) and edge_faults(cleaned.surface)[0]
        used = cleaned.vertex_map >= 0
        _, first = np.unique(cleaned.vertex_map[used], return_index=True)
        first = np.flatnonzero(used)[first]  # of each vertex of the cleaned surface
        if on is None:
            loose = np.flatnonzero(~used)
            self._owner = cleaned.vertex_map.copy()
            self._owner[loose] = len(first) + np.arange(len(loose))
            self.corner = np.arange(len(first), dtype=np.int32)
            self.rest = np.concatenate((cleaned.surface.vertices, shell.vertices[loose]))
        else:
            self._owner = np.arange(len(body.nodes), dtype=np.int32)
            self.corner = on[first]
            self._owner[on[used]] = self.corner[cleaned.vertex_map[used]]
            self.rest = np.array(body.nodes)
        self.points = self.rest.copy()
        self.edge = cleaned.surface.mean_edge
        self.longest = float(cleaned.surface.edge_lengths.max())
        self.held: set[int] = set()
        self.version = 0
        self._begun = None if self.mesh is None else scaled_jacobians(self.mesh)
        self._topology = cleaned.surface.bare()
        self._surface: Surface | None = self._topology
        self._moved: Float | None = None
        self._longest: float | None = None

    @property
    def once(self) -> Int:
        """The nodes (k,), each once where triangles are not merged, as in an STL file."""
        mesh = self.body.mesh
        if isinstance(mesh, Surface) and distinct_nodes(mesh) < len(mesh.vertices):
            return np.unique(self._owner, return_index=True)[1].astype(np.int32)
        return np.arange(len(self.body.nodes), dtype=np.int32)

    @property
    def surface(self) -> Surface:
        """The cleaned, outward surface at the current points."""
        if self._surface is None:
            self._surface = self._topology.moved(self.points[self.corner])
        return self._surface

    def on_border(self, found: Closest) -> NDArray[np.bool_]:
        """Whether closest points (p,) lie on an open border, where there is no inside."""
        if not self.open_edges:
            return np.zeros(len(found.face), dtype=bool)
        border = self._topology.border[self.faces[found.face]]
        return triples.every(border | (found.barycentric <= 1e-12))

    @property
    def vertices(self) -> Float:
        """(k, 3) the surface's vertices at the current points."""
        return self.surface.vertices

    def normals(self, rows: Int) -> Float:
        """Return the unit normals (r, 3) of some vertices of the surface."""
        return normals_at(self.surface, rows)

    @property
    def rounding(self) -> float:
        """By how much single precision may bring two surfaces nearer each other where this one is."""
        return 2.0 * float(np.spacing(np.float32(np.abs(self.vertices).max())))

    @property
    def begun_surface(self) -> Surface:
        """The cleaned, outward surface where it began."""
        return self._topology

    @property
    def displacement(self) -> Float:
        """(k, 3) how far each vertex of the surface has moved."""
        if self._moved is None:
            self._moved = self.vertices - self.rest[self.corner]
        return self._moved

    @property
    def longest_now(self) -> float:
        """A length that no edge of the surface exceeds at the current points."""
        if self._longest is None:
            self._longest = self.longest + 2.0 * float(triples.length(self.displacement).max())
        return self._longest

    @property
    def nodes(self) -> Float:
        """(n, 3) the body's own nodes at the current points; those that did not move keep their bits."""
        out = np.array(self.body.nodes)
        moved = triples.some(self.points != self.rest)[self._owner]
        out[moved] = self.points[self._owner[moved]]
        return out

    def by_node(self, values: Float, rest: float) -> Float:
        """Return values (k,) of the surface's vertices by the body's own nodes (n,); `rest` for others."""
        out = np.full(len(self.points), rest)
        out[self.corner] = values
        return out[self._owner]

    @property
    def result(self) -> Surface | VolumeMesh:
        """The body's mesh at the current points; the very same object where nothing moved."""
        if not (self.points != self.rest).any():
            return self.body.mesh
        return self.body.mesh.moved(self.nodes)

    @property
    def inverted_input(self) -> Int:
        """(k,) elements that were inverted from the start."""
        if self._begun is None:
            return np.zeros(0, np.int32)
        return np.flatnonzero(self._begun <= 0).astype(np.int32)

    def inverted(self) -> Int:
        """Return (k,) the elements that are inverted now."""
        if self.mesh is None or self._begun is None:
            return np.zeros(0, np.int32)
        return np.flatnonzero(scaled_jacobians(self.mesh.moved(self.nodes)) <= 0).astype(np.int32)

    def put(self, points: Float) -> None:
        """Go to positions (p, 3) that were the body's before."""
        self.points, self._surface, self._moved, self._longest = points, None, None, None
        self.version += 1

    def move(self, rows: Int, step: Float, guard: bool = True) -> float:
        """Move the points `rows` (r,) by `step` (r, 3); return the largest distance that one moved.

        With `guard`, no element that was valid is inverted: the nodes of one that would be go a part of
        their way, at last none of it.
        """
        before = self.points
        after = before.copy()
        after[rows] += step
        if self.mesh is not None:
            after = carry_mid_nodes(self.mesh, after, self.rest) if len(self.mesh.mid_nodes) else after
            if guard:
                after = self._guarded(rows, before, after)
        self.put(after)
        return float(triples.length(after[rows] - before[rows]).max(initial=0.0))

    def reshape(self, progress: Progress = silent) -> None:
        """Give elements that were squeezed or sheared their shapes back, as far as the surface allows.

        The surface stays as it is, and so does what never moved.
        """
        if self.mesh is None or self._begun is None:
            return
        moved = triples.some(self.points != self.rest)
        touched = self._elements_at(np.flatnonzero(moved))
        if not len(touched):
            return
        near, nodes = self.mesh.restricted(touched)
        fixed = ~moved[self._owner[nodes]]
        fixed |= np.isin(self._owner[nodes], self.corner)
        here = self.points[self._owner[nodes]]
        begun = self._begun[touched]
        after = reshaped(near, here, np.flatnonzero(fixed), begun, None, progress)
        out = self.points.copy()
        out[self._owner[nodes[~fixed]]] = after[~fixed]
        self.put(out)

    def _guarded(self, rows: Int, before: Float, after: Float) -> Float:
        """Go from `before` to `after` as far as no valid element is inverted."""
        assert self.mesh is not None and self._begun is not None
        touched = self._elements_at(rows)
        if not len(touched):
            return after
        near, nodes = self.mesh.restricted(touched)
        # restricted keeps the order of the elements
        begun = self._begun[touched]
        floor = np.where(begun > 0, np.minimum(LEAST, 0.5 * begun), -np.inf)
        own, of_node = np.unique(self._owner[nodes], return_inverse=True)
        share = np.ones(len(own))
        attempts = np.zeros(len(own), dtype=int)
        start, goal = before[own], after[own]
        while True:
            here = np.where(share[:, None] == 1.0, goal, start + share[:, None] * (goal - start))
            moved = here[of_node]
            if len(near.mid_nodes):
                moved = carry_mid_nodes(near, moved, self.rest[nodes])
            bad = np.flatnonzero(scaled_jacobians(near.moved(moved)) < floor)
            corners = np.unique(of_node[_nodes_of(near, bad)])
            free = corners[share[corners] > 0]
            if not len(free):  # all is well, or nothing that moves is to blame
                break
            attempts[free] += 1
            share[free] = np.where(attempts[free] > ATTEMPTS, 0.0, share[free] * BACK)
        out = after.copy()
        out[nodes] = moved
        out[own] = here
        self.held.update(own[share < 1.0].tolist())
        return out

    def _elements_at(self, rows: Int) -> Int:
        """Return (k,) the solid elements that have one of these nodes, ascending."""
        assert self.mesh is not None
        inside: NDArray[np.bool_] = np.zeros(len(self.points), dtype=bool)
        inside[rows] = True
        inside = inside[self._owner]
        found = [
            start + np.flatnonzero(inside[block.nodes].any(axis=1))
            for block, start in zip(self.mesh.blocks, self.mesh.starts[:-1].tolist(), strict=True)
            if block.shape.solid
        ]
        return np.concatenate([np.zeros(0, np.int64), *found])


def _nodes_of(mesh: VolumeMesh, elements: Int) -> Int:
    """Return (k,) the nodes of some elements."""
    chosen = np.zeros(mesh.element_count, dtype=bool)
    chosen[elements] = True
    parts = [
        block.nodes[chosen[start : start + len(block)]].ravel()
        for block, start in zip(mesh.blocks, mesh.starts[:-1].tolist(), strict=True)
    ]
    return np.concatenate([np.zeros(0, np.int32), *parts])
