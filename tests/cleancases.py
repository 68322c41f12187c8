# SPDX-License-Identifier: GPL-3.0-or-later
"""What tests of cleaning and orientation do to a surface, and ask of it."""

from __future__ import annotations

import numpy as np

from femors_addon.cleaning import Cleaned, clean
from femors_addon.mesh import Surface


def inverted(surface: Surface, faces=slice(None)) -> Surface:
    """The surface with some faces (all) wound the other way."""
    turned = surface.faces.copy()
    turned[faces] = turned[faces][:, ::-1]
    return Surface(surface.vertices, turned)


def cleaned(surface: Surface, name: str = "mesh") -> Cleaned:
    return clean(surface.vertices, surface.faces, name)


def assert_maps_hold(raw: Surface, result: Cleaned) -> None:
    """Each used vertex is where it was, and each face has the corners of the one that it came from."""
    used = result.vertex_map >= 0
    assert np.array_equal(result.surface.vertices[result.vertex_map[used]], raw.vertices[used])
    origin = np.sort(result.vertex_map[raw.faces[result.face_map]], axis=1)
    assert np.array_equal(np.sort(result.surface.faces, axis=1), origin)
    assert np.array_equal(np.unique(result.surface.faces), np.arange(len(result.surface.vertices)))


def assert_closed_and_alike(surface: Surface) -> None:
    """Every half-edge has one partner that runs the other way."""
    half = surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    forth = set(map(tuple, half.tolist()))
    assert len(forth) == len(half)
    assert forth == set(map(tuple, half[:, ::-1].tolist()))
