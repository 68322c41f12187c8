# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes for tests of the command line."""

from __future__ import annotations

import numpy as np

from femors_addon.meshfiles import MeshFile


def ball(rings: int, segments: int, radii: tuple[float, float, float]) -> MeshFile:
    """Return an ellipsoid of quads, with triangles at its poles."""
    theta, phi = np.linspace(0, np.pi, rings + 1)[1:-1, None], np.arange(segments) * 2 * np.pi / segments
    grid = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], axis=-1
    )
    vertices = np.concatenate((grid.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]])) * radii
    first = np.arange(segments)
    second, north, last = np.roll(first, -1), np.full(segments, len(vertices) - 2), (rings - 2) * segments
    quads = [
        np.column_stack((first, first + segments, second + segments, second)) + i * segments
        for i in range(rings - 2)
    ]
    tops = np.column_stack((north, first, second))
    bottoms = np.column_stack((north + 1, last + second, last + first))
    sizes = [4] * sum(map(len, quads)) + [3] * 2 * segments
    return MeshFile(vertices, np.array(sizes), np.concatenate([a.ravel() for a in (*quads, tops, bottoms)]))


SOURCE, TARGET = ball(10, 12, (30, 24, 60)), ball(12, 14, (35, 26, 64))
