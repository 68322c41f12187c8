# SPDX-License-Identifier: GPL-3.0-or-later
"""Which side of a surface is outside: winding made consistent and outward, component by component."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from . import triples
from .crew import blockwise
from .mesh import Float, Int, Surface

PROBES = 12  # vertices of a component that are looked at to tell whether it lies in another
FLAT = 1e-10  # of its area to the power 1.5: a component of less volume has no inside


def oriented(surface: Surface) -> tuple[Surface, int]:
    """Wind faces consistently and outward; return the surface and how many faces were turned."""
    flip, component = _consistent(surface)
    faces = np.where(flip[:, None], surface.faces[:, ::-1], surface.faces)
    volume = _component_volumes(surface, flip, component)
    inside = _nesting(surface.vertices, faces, component, volume)
    # a flat flap has no inside; rounding alone must not turn it
    area = np.bincount(component, triples.length(surface.face_cross))
    wrong = np.abs(volume) > FLAT * area**1.5
    wrong &= (volume < 0) != (inside % 2 == 1)
    turn = flip != wrong[component]
    if not turn.any():
        return surface, 0
    return Surface(surface.vertices, np.where(turn[:, None], surface.faces[:, ::-1], surface.faces)), int(
        turn.sum()
    )


def _consistent(surface: Surface) -> tuple[NDArray[np.bool_], Int]:
    """Walk a spanning tree of the faces; return (face to flip, component of the face)."""
    m = len(surface.faces)
    faces, disagree = surface.edge_faces[0], surface.opposed_edges
    component = surface.components
    flip = np.zeros(m, dtype=bool)
    if disagree.any():
        # one node more, joined to a face of each component: a single walk comes to them all
        roots = np.unique(component, return_index=True)[1]
        # two faces that share several edges (twins) are joined by one of them: sparse entries add up
        single = np.unique(faces[:, 0].astype(np.int64) * m + faces[:, 1], return_index=True)[1]
        row = np.concatenate((faces[single, 0], np.full(len(roots), m)))
        column = np.concatenate((faces[single, 1], roots))
        value = np.concatenate((disagree[single] + 1.0, np.ones(len(roots))))
        sign = sparse.csr_matrix((value, (row, column)), shape=(m + 1, m + 1))
        sign = (sign + sign.T).tocsr()
        order, before = csgraph.breadth_first_order(sign, m, directed=False)
        order = order[1:]
        step = np.asarray(sign[order, before[order]]).ravel() > 1.5
        turned = np.zeros(m + 1, dtype=bool)
        for face, parent, odd in zip(order, before[order], step, strict=True):
            turned[face] = turned[parent] != odd
        flip = turned[:m]
    return flip, component


def _component_volumes(surface: Surface, flip: NDArray[np.bool_], component: Int) -> Float:
    """Signed volume of each component about its own centroid (so that open shells have one too)."""
    count = np.bincount(component)

    def middles(block: slice) -> Float:
        return triples.total(surface.vertices.take(surface.faces[block], axis=0)) / 3.0

    middle = blockwise(middles, len(surface.faces))
    centre = np.column_stack([np.bincount(component, middle[:, k]) / count for k in range(3)])
    middle -= centre.take(component, axis=0)
    height = triples.dot(middle, surface.face_cross)
    np.negative(height, out=height, where=flip)
    return np.bincount(component, height) / 6.0


def _nesting(vertices: Float, faces: Int, component: Int, volume: Float) -> Int:
    """How many closed components each component lies in (of the 32 largest; others count none).

    A component that crosses another is not in it: `PROBES` of its vertices, far from each other in the
    file, all have to be.
    """
    depth = np.zeros(len(volume), dtype=np.int32)
    if len(volume) == 1:
        return depth
    largest = np.argsort(-np.abs(volume), kind="stable")[:32]
    shells = [vertices[faces[component == shell]] for shell in largest]
    low, high = (np.array([reach(shell, axis=(0, 1)) for shell in shells]) for reach in (np.min, np.max))
    probes = []
    for shell in shells:
        corners = shell.reshape(-1, 3)
        probes.append(corners[np.linspace(0, len(corners) - 1, PROBES).astype(int)])
    for at, shell in enumerate(shells):
        inner = np.flatnonzero(((low > low[at]) & (high < high[at])).all(axis=1))
        for probe in range(PROBES):  # the first tells most of those that are not inside
            points = np.array([probes[i][probe] for i in inner]).reshape(-1, 3)
            inner = inner[np.abs(winding_number(shell, points)) > 0.9]
        depth[largest[inner]] += 1
    return depth


def winding_number(corners: Float, points: Float) -> Float:
    """Generalized winding number of triangles (m, 3, 3) about points (k, 3), by solid angles.

    Van Oosterom & Strackee (1983); 1 inside an outward closed surface, 0 outside.
    """
    out = np.empty(len(points))
    for i, point in enumerate(points):
        a, b, c = np.moveaxis(corners - point, 1, 0)
        la, lb, lc = (triples.length(v) for v in (a, b, c))
        top = triples.dot(a, triples.cross(b, c))
        ab, bc, ca = (triples.dot(u, v) for u, v in ((a, b), (b, c), (c, a)))
        out[i] = np.arctan2(top, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2 * np.pi)
    return out
