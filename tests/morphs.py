# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies and settings that tests of the morph share."""

from __future__ import annotations

import functools
import json

import numpy as np

from femors_addon import shapes
from femors_addon.mesh import Surface
from femors_addon.morph import MorphResult, MorphSettings, morph

STAY = MorphSettings(alignment="none")
LAYERED = MorphSettings(levels=2, reduction=0.4, iterations=4, fine_iterations=3)
"""All stages, on meshes of a few hundred nodes."""


def ellipsoid(halvings: int = 2, radii: tuple[float, float, float] = (1.0, 1.3, 1.7)) -> Surface:
    ball = shapes.sphere(halvings)
    return ball.moved(ball.vertices * radii)


SMALL, GOAL = ellipsoid(), ellipsoid(2, (1.2, 1.2, 2.0))


def finite(result: MorphResult, source: Surface) -> bool:
    """One finite number for whatever the source has."""
    assert result.vertices.shape == source.vertices.shape
    assert result.surface_distance.shape == result.displacement.shape == (len(source.vertices),)
    arrays = (result.vertices, result.surface_distance, result.displacement, result.transform)
    json.dumps(result.report(), allow_nan=False)
    return all(np.isfinite(array).all() for array in arrays)


@functools.cache
def subjects() -> shapes.Pair:
    """Two subjects, meshed independently, the true place of every vertex known."""
    return shapes.pair(900, 800, seed=1)


@functools.cache
def subjects_morphed() -> MorphResult:
    return morph(subjects().source, subjects().target)
