# SPDX-License-Identifier: GPL-3.0-or-later
"""Affine transforms as (4, 4) matrices for column vectors, and the best one between paired landmarks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from .progress import FemorsError
from .triples import Float


def transformed(matrix: Float, points: ArrayLike) -> Float:
    """Apply a (4, 4) matrix to points (p, 3)."""
    return np.asarray(points) @ matrix[:3, :3].T + matrix[:3, 3]


def homogeneous(linear: Float, translation: Float) -> Float:
    """Return the (4, 4) matrix of x -> linear x + translation."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = linear, translation
    return out


def inverse(matrix: Float) -> Float:
    """Return the inverse of an affine (4, 4) matrix, by cofactors.

    Closed form, for LAPACK's threads cost more than the work on a busy machine.
    """
    (a, b, c), (d, e, f), (g, h, i) = matrix[:3, :3].tolist()
    cofactors = [
        [e * i - f * h, c * h - b * i, b * f - c * e],
        [f * g - d * i, a * i - c * g, c * d - a * f],
        [d * h - e * g, b * g - a * h, a * e - b * d],
    ]
    linear = np.array(cofactors) / (a * cofactors[0][0] + b * cofactors[1][0] + c * cofactors[2][0])
    return homogeneous(linear, -linear @ matrix[:3, 3])


def mirrors(matrix: Float) -> bool:
    """Whether a (4, 4) matrix turns right hands into left ones."""
    return bool(np.linalg.det(matrix[:3, :3]) < 0)


def landmark_transform(source: ArrayLike, target: ArrayLike, kind: str = "similarity") -> Float:
    """Least-squares transform between paired landmarks (k, 3), k >= 3.

    Umeyama (1991) for ``rigid`` and ``similarity``; ``affine`` falls back to ``similarity`` where
    there are fewer than five landmarks or all lie in a plane.

    Raises
    ------
    FemorsError
        Unequal counts, fewer than three, or all on one line.
    """
    a, b = np.asarray(source, dtype=float).reshape(-1, 3), np.asarray(target, dtype=float).reshape(-1, 3)
    if len(a) != len(b):
        raise FemorsError(f"landmarks must be paired: source has {len(a)}, target has {len(b)}")
    if len(a) < 3:
        raise FemorsError(f"alignment needs at least 3 paired landmarks, not {len(a)}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise FemorsError("landmarks have coordinates that are not finite")
    ca, cb = a.mean(axis=0), b.mean(axis=0)
    spread, other = (np.linalg.svd(points, compute_uv=False) for points in (a - ca, b - cb))
    for name, widths in (("source", spread), ("target", other)):
        if widths[1] < 1e-6 * max(widths[0], np.finfo(float).tiny):
            raise FemorsError(f"the {name}'s landmarks lie on one line; choose at least one beside it")
    if kind == "affine" and len(a) >= 5 and spread[2] > 0.02 * spread[0]:
        linear = np.linalg.lstsq(a - ca, b - cb, rcond=None)[0].T
        return homogeneous(linear, cb - linear @ ca)
    u, s, vt = np.linalg.svd((b - cb).T @ (a - ca))
    sign = np.array([1.0, 1.0, math.copysign(1.0, np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * sign) @ vt
    scale = 1.0 if kind == "rigid" else float((s * sign).sum() / ((a - ca) ** 2).sum())
    return homogeneous(scale * rotation, cb - scale * rotation @ ca)
