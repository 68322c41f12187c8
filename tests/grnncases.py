# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacements and places for tests of fields."""

from __future__ import annotations

import numpy as np


def smooth(points: np.ndarray) -> np.ndarray:
    """A displacement that varies over tens of units."""
    x, y, z = points.T
    return np.column_stack((50 * np.sin(x / 40), 30 * np.cos(y / 23 + z / 60), 0.2 * z - 20))


def around(points: np.ndarray, radius: float, count: int, seed: int = 0) -> np.ndarray:
    """Points at a distance, in random directions, from randomly chosen ones."""
    rng = np.random.default_rng(seed)
    way = rng.normal(size=(count, 3))
    way *= radius / np.linalg.norm(way, axis=1, keepdims=True)
    return points[rng.integers(0, len(points), count)] + way
