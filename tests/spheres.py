# SPDX-License-Identifier: GPL-3.0-or-later
"""Spheres and plates that overlap, and how tests see that they came apart."""

from __future__ import annotations

import itertools

import numpy as np
from solids import crosses, gaps, hexes, moved, sphere

from femors_addon.bodies import Body
from femors_addon.mesh import Surface
from femors_addon.volume_quality import scaled_jacobians

GAP = 0.01
TILT = (17.0, 1.0, 2.0)  # of a second sphere: 2.85 deep, and no symmetry


def pair(by=TILT, **shares) -> list[Body]:
    """Two spheres of radius 10."""
    return [
        Body("one", sphere(), shares.get("one")),
        Body("two", moved(sphere(), by), shares.get("two")),
    ]


def surface_of(mesh) -> Surface:
    return mesh if isinstance(mesh, Surface) else mesh.surface()[0]


def smallest_gap(a: Surface, b: Surface) -> float:
    """By brute force, without the code that gave the certificate; see `solids.gaps`."""
    return float(min(gaps(a.vertices, b).min(), gaps(b.vertices, a).min()))


def assert_apart(result, gap: float = GAP) -> None:
    """Check the certificate by other means than the code that gave it, in double and single precision."""
    assert result.certified, result.reasons
    meshes = [surface_of(body.mesh) for body in result.bodies]
    for a, b in itertools.combinations(meshes, 2):
        for kind in (np.float64, np.float32):
            one, two = (Surface(s.vertices.astype(kind).astype(np.float64), s.faces) for s in (a, b))
            assert smallest_gap(one, two) >= gap - 1e-5
            assert not crosses(one, two)
    for body in result.bodies:
        if not isinstance(body.mesh, Surface):
            assert scaled_jacobians(body.mesh).min() > 0


def plates(depth: float, thick: float = 2.0) -> list[Body]:
    """Two bent plates of hexahedra, 24 x 20, one on the other."""
    return [
        Body("low", hexes((20, 16, 4), (24, 20, thick), 0.01)),
        Body("high", hexes((19, 17, 4), (24, 20, thick), 0.012, centre=(1.0, 0.5, thick - depth))),
    ]
