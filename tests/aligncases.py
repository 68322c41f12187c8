# SPDX-License-Identifier: GPL-3.0-or-later
"""Bones that are to be laid on each other, and where they are put before."""

from __future__ import annotations

import functools

import numpy as np
from scipy.spatial.transform import Rotation

from femors_addon import shapes
from femors_addon.mesh import Float, Surface
from femors_addon.transforms import homogeneous, transformed

BALL = shapes.sphere(3)
TURNED_BALL = BALL.moved(BALL.vertices @ Rotation.from_rotvec((0.3, 0.5, 0.7)).as_matrix().T)
SHEAR = np.array([[1.1, 0.1, 0.0], [0.0, 0.95, 0.05], [0.02, 0.0, 1.2]])


def pose(seed: int, reach: float = 300.0) -> Float:
    """A random rotation and shift (4, 4); seed 0 is none."""
    if seed == 0:
        return np.eye(4)
    shift = np.random.default_rng(seed).normal(size=3) * reach
    return homogeneous(Rotation.random(random_state=seed).as_matrix(), shift)


def placed(matrix: Float, surface: Surface) -> Surface:
    return surface.moved(transformed(matrix, surface.vertices))


def mirrored(surface: Surface) -> Surface:
    """The other side's bone, outward again."""
    return Surface(surface.vertices * (-1, 1, 1), surface.faces[:, ::-1])


def off(matrix: Float, points: Float, truth: Float, size: float) -> float:
    """Mean distance between where points go and where they belong, as a share of a size."""
    return float(np.linalg.norm(transformed(matrix, points) - truth, axis=1).mean() / size)


@functools.cache
def twice() -> tuple[Surface, Surface]:
    """One bone, meshed twice."""
    return shapes.bone(900, seed=3), shapes.bone(1000, seed=3, lattice=1)


@functools.cache
def subjects() -> shapes.Pair:
    """Two subjects' bones."""
    return shapes.pair(900, 900, seed=1)
