# SPDX-License-Identifier: GPL-3.0-or-later
"""A ball with a fold: for tests of mending."""

from __future__ import annotations

import numpy as np

from femors_addon.mend import FARTHEST, REACH
from femors_addon.mesh import Float, Surface
from femors_addon.patches import Part


def whole(surface: Surface) -> Part:
    """All of a surface as the part that may move."""
    faces, nodes = np.arange(len(surface.faces)), np.ones(len(surface.vertices), bool)
    return Part.around(faces, surface, nodes, REACH, FARTHEST * surface.mean_edge)


def pulled(ball: Surface, share: float = 1.9) -> tuple[int, Float]:
    """A displacement that pulls one node over the far side of a neighbour, along the sphere."""
    node = 200
    other = ball.adjacency[node].indices[0]
    displacement = np.zeros_like(ball.vertices)
    displacement[node] = share * (ball.vertices[other] - ball.vertices[node])
    return node, displacement
