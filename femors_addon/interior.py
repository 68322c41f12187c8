# SPDX-License-Identifier: GPL-3.0-or-later
"""The inside of a finite-element mesh that follows its surface: the harmonic extension of displacements."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import cg

from .mesh import Float, Int
from .volume import VolumeMesh


def element_edges(mesh: VolumeMesh) -> Int:
    """Return (e, 2) unique edges between corner nodes, lower index first."""
    pairs = [np.zeros((0, 2), np.int64)]
    for block in mesh.blocks:
        for face in block.shape.faces:
            for one, two in zip(face, face[1:] + face[:1], strict=True):
                pairs.append(np.sort(block.nodes[:, [one, two]].astype(np.int64), axis=1))
    keys = np.unique(np.concatenate(pairs) @ np.array([len(mesh.nodes), 1]))
    edges = np.column_stack(np.divmod(keys, max(len(mesh.nodes), 1)))
    return edges[edges[:, 0] != edges[:, 1]].astype(np.int32)


def stiffness(mesh: VolumeMesh) -> sparse.csr_matrix:
    """Return the (n, n) Laplacian of the edges, each as stiff as the inverse square of its length."""
    one, two = element_edges(mesh).T
    squared = np.sum((mesh.nodes[one] - mesh.nodes[two]) ** 2, axis=1)
    weight = 1.0 / np.maximum(squared, 1e-12 * max(float(np.mean(squared)), 1e-300))
    n = len(mesh.nodes)
    half = sparse.csr_matrix((weight, (one, two)), shape=(n, n))
    both = half + half.T
    return (sparse.diags(np.asarray(both.sum(axis=1)).ravel()) - both).tocsr()


def harmonic(
    laplacian: sparse.csr_matrix, displacement: Float, inside: NDArray[np.bool_], rtol: float = 1e-6
) -> Float:
    """Return the displacement (n, 3) with that of the nodes `inside` (n,) made harmonic.

    Nodes without an edge (mid-side and loose ones) keep theirs. `laplacian` is from `stiffness`.
    """
    solved = inside & (laplacian.diagonal() > 0)
    displacement = displacement.copy()
    if not solved.any():
        return displacement
    rows = laplacian[solved]
    system, load = rows[:, solved].tocsr(), -(rows[:, ~solved] @ displacement[~solved])
    scale = sparse.diags(1.0 / system.diagonal())
    for axis in range(3):
        displacement[solved, axis] = cg(
            system, load[:, axis], x0=displacement[solved, axis], rtol=rtol, maxiter=400, M=scale
        )[0]
    return displacement
