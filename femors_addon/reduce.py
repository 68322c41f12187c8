# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh reduction (Process 1 of the paper): coarser versions of a surface, made once and kept."""

from __future__ import annotations

import fast_simplification
import numpy as np

from .mesh import Surface, clean
from .progress import FemorsError


def reduced(surface: Surface, nodes: int) -> Surface:
    """Return a version with about `nodes` nodes, by quadric edge collapse (fast-simplification).

    The surface itself is returned where it has no more nodes than that, and where it cannot be
    reduced (its pieces would collapse).
    """
    if nodes >= len(surface.vertices):
        return surface
    # Euler: about two faces a node; scaled from what the surface has, borders and all
    faces = max(int(len(surface.faces) * nodes / len(surface.vertices)), 8)
    if faces >= len(surface.faces):
        return surface
    low, high = surface.bounds
    centre, scale = (low + high) / 2, max(surface.diagonal, np.finfo(float).tiny)
    # works in single precision inside: give it numbers near one
    points, triangles = fast_simplification.simplify(
        (surface.vertices - centre) / scale, surface.faces.copy(), target_count=faces
    )
    try:
        return clean(points.astype(np.float64) * scale + centre, triangles, "reduced mesh").surface
    except FemorsError:
        return surface


def pyramid(surface: Surface, counts: list[int]) -> list[Surface]:
    """Return versions with about `counts` nodes each, every one from the next finer."""
    out: list[Surface] = []
    for count in sorted(counts, reverse=True):
        surface = reduced(surface, count)
        out.append(surface)
    return out[::-1]
