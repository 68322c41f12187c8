# SPDX-License-Identifier: GPL-3.0-or-later
"""Made-up bones, with known correspondence, for the demonstration, the tests and the timings.

A bone is an implicit surface of blended capsules and ellipsoids, meshed anew at every request; a
`warp` is a smooth map of space. Two subjects are the bone and its warped self, meshed independently,
so that the true place of every vertex of the one on the other is known.

Axes as seen on a right femur: x to the side (lateral), y to the front (anterior), z up.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .isosurface import halved, meshed
from .mesh import Float, Surface
from .triples import unit

Step = tuple[str, float]
"""A kind of warp and its strength."""

LENGTH = 400.0
"""Length of the bone that the numbers below describe, in mm."""


# --- the bone ---------------------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True)
class _Form:
    """What makes one femur differ from another: factors on the proportions, all about 1."""

    head: float = 1.0
    neck: float = 1.0
    bow: float = 1.0
    shaft: float = 1.0
    condyles: float = 1.0
    trochanter: float = 1.0

    @classmethod
    def of(cls, seed: int) -> _Form:
        """Return the plain form for seed 0, and one of its kin for any other."""
        if seed == 0:
            return cls()
        spread = np.random.default_rng(seed).uniform(-1.0, 1.0, 6) * (0.08, 0.1, 0.5, 0.08, 0.06, 0.1)
        return cls(*(1.0 + spread))


def bone(nodes: int = 4000, *, length: float = LENGTH, seed: int = 0, lattice: int = 0) -> Surface:
    """Return a closed femur-like surface of well-shaped triangles.

    Parameters
    ----------
    nodes : int
        How many vertices, met to a few percent; from about 600.
    length : float
        From the condyles to the top of the head, in the unit wanted.
    seed : int
        Which individual: 0 the plain one, others vary its proportions.
    lattice : int
        Which mesh: the same surface gets other vertices.
    """
    form = _Form.of(seed)
    low, high = np.array([-60.0, -65.0, -15.0]), np.array([80.0, 50.0, 415.0])
    surface = meshed(lambda points: _femur(points, form), low, high, nodes, lattice)
    return Surface(surface.vertices * (length / LENGTH), surface.faces)


def _femur(points: Float, form: _Form) -> Float:
    """Implicit femur, 400 long."""
    head = np.array([-14.0, 4.0, 377.0])
    value = _shaft(points, form)
    neck = _capsule(points, (33.0, 1.0, 335.0), head, 16.0 * form.neck, 12.5 * form.neck)
    value = _join(value, neck, 30.0)
    trochanter = _ellipsoid(points, (43.0, -5.0, 343.0), np.array([14.0, 20.0, 27.0]) * form.trochanter)
    value = _join(value, trochanter, 24.0)
    value = _join(value, _ellipsoid(points, (19.0, -11.0, 301.0), (9.0, 9.0, 15.0)), 18.0)
    value = _join(value, np.linalg.norm(points - head, axis=1) - 22.5 * form.head, 10.0)
    # the far end: a flare, two condyles, the groove for the kneecap and the notch between
    value = _join(
        value, _ellipsoid(points, (1.0, 1.0, 45.0), np.array([31.0, 19.0, 44.0]) * form.condyles), 40.0
    )
    for side, back in ((-23.0, -14.0), (24.0, -12.0)):
        centre, radii = (side, back, 22.5), np.array([15.5, 31.0, 22.5]) * (form.condyles, form.condyles, 1.0)
        value = _join(value, _ellipsoid(points, centre, radii), 24.0)
    value = _carve(value, _capsule(points, (0.0, 32.0, 55.0), (0.0, 24.0, 0.0), 9.0, 11.0), 18.0)
    return _carve(value, _capsule(points, (0.0, -52.0, 20.0), (0.0, -6.0, -4.0), 13.0, 8.0), 12.0)


def _shaft(points: Float, form: _Form) -> Float:
    """A bowed tube, narrowest in the middle, with a ridge along its back."""
    z = np.clip(points[:, 2], 60.0, 318.0)
    share = (z - 60.0) / 258.0
    x = points[:, 0] - (2.0 + 30.0 * share)
    y = points[:, 1] - (13.0 * form.bow * np.sin(np.pi * share) - 2.0)
    radius = (15.6 + 3.0 * np.cos(2.0 * np.pi * share)) * form.shaft  # level at the ends: no seam
    around = np.hypot(x, y)
    ridge = 1.8 * np.exp(-((x / 5.0) ** 2)) * np.where(y < 0, y**2 / (y**2 + 25.0), 0.0)
    return np.hypot(around, points[:, 2] - z) - radius - ridge * np.sin(np.pi * share)


def _ellipsoid(points: Float, centre: ArrayLike, radii: ArrayLike) -> Float:
    """Value of an ellipsoid, scaled by its gradient to be close to a distance."""
    radii = np.asarray(radii, dtype=np.float64)
    scaled = (points - np.asarray(centre)) / radii
    size = np.linalg.norm(scaled, axis=1)
    slope = np.linalg.norm(scaled / radii, axis=1)
    middle = size < 1e-6
    return np.where(middle, -radii.min(), size * (size - 1.0) / np.where(middle, 1.0, slope))


def _capsule(points: Float, start: ArrayLike, stop: ArrayLike, first: float, last: float) -> Float:
    """Distance to a rod whose radius goes from `first` at its start to `last` at its stop."""
    start, along = np.asarray(start), np.asarray(stop) - np.asarray(start)
    share = np.clip((points - start) @ along / (along @ along), 0.0, 1.0)
    return np.linalg.norm(points - start - share[:, None] * along, axis=1) - first - (last - first) * share


def _join(one: Float, two: Float, width: float) -> Float:
    """Union of two implicits with a fillet."""
    overlap = np.maximum(1.0 - np.abs(one - two) / width, 0.0)
    return np.minimum(one, two) - overlap**3 * (width / 6.0)


def _carve(one: Float, two: Float, width: float) -> Float:
    """Take the second implicit off the first, with a rounded rim."""
    return -_join(-one, two, width)


# --- warps ------------------------------------------------------------------------------------------
def warp(points: ArrayLike, *steps: Step, length: float = LENGTH) -> Float:
    """Map points (p, 3) through smooth warps of space, one after the other.

    Parameters
    ----------
    points : (p, 3) float64
        Positions on, in or about a `bone` of that length.
    *steps : (kind, strength)
        ``stretch``: along z by a factor of 1 + strength, thinner across so that volume stays;
        ``grow``: every way by a factor of 1 + strength;
        ``bend``: in the y-z plane, by strength radians from end to end;
        ``twist``: about the shaft, by strength radians from end to end;
        ``bump``: the front of the far end out by strength x length, fading over an eighth of the length;
        ``turn``: rigidly, by strength radians about an oblique axis;
        ``shift``: rigidly, by strength x length in an oblique direction.
        All are one-to-one near the bone for strengths of up to 1 (bump: 0.15; -1 < stretch, grow).
    length : float
        Length of the bone that is warped.
    """
    out = np.array(points, dtype=np.float64).reshape(-1, 3) / length
    for kind, strength in steps:
        if kind not in _WARPS:
            raise ValueError(f"'{kind}' is not one of {', '.join(_WARPS)}")
        out = _WARPS[kind](out, float(strength))
    return out * length


def _stretch(p: Float, strength: float) -> Float:
    across = (1.0 + strength) ** -0.5
    return p * (across, across, 1.0 + strength)


def _grow(p: Float, strength: float) -> Float:
    return p * (1.0 + strength)


def _bend(p: Float, strength: float) -> Float:
    """The middle line becomes an arc of a circle; cross-sections stay plane and normal to it."""
    along = strength * (p[:, 2] - 0.5)
    z = p[:, 2] - 0.5
    # sin(along) / strength and (1 - cos(along)) / strength, also for no strength at all
    forth = z * np.sinc(along / np.pi)
    aside = 0.5 * strength * (z * np.sinc(along / (2.0 * np.pi))) ** 2
    y = p[:, 1] * np.cos(along) - aside
    return np.column_stack((p[:, 0], y, 0.5 + forth + p[:, 1] * np.sin(along)))


def _twist(p: Float, strength: float) -> Float:
    angle, x0 = strength * (p[:, 2] - 0.5), 0.04
    cos, sin, x = np.cos(angle), np.sin(angle), p[:, 0] - x0
    return np.column_stack((x0 + cos * x - sin * p[:, 1], sin * x + cos * p[:, 1], p[:, 2]))


def _bump(p: Float, strength: float) -> Float:
    fade = np.exp(-0.5 * np.sum(((p - (0.04, 0.05, 0.12)) / 0.125) ** 2, axis=1))
    return p + strength * fade[:, None] * (0.48, 0.84, 0.253)


def _turning(p: Float, strength: float) -> Float:
    """Rodrigues' formula about an axis through the middle of the bone."""
    axis, centre = np.array([2.0, -1.0, 2.0]) / 3.0, (0.0, 0.0, 0.5)
    q = p - centre
    along = (q @ axis)[:, None] * axis
    return centre + along + np.cos(strength) * (q - along) + np.sin(strength) * np.cross(axis, q)


def _shift(p: Float, strength: float) -> Float:
    return p + strength * np.array([2.0, 3.0, -6.0]) / 7.0


_WARPS: dict[str, Callable[[Float, float], Float]] = {
    "stretch": _stretch,
    "grow": _grow,
    "bend": _bend,
    "twist": _twist,
    "bump": _bump,
    "turn": _turning,
    "shift": _shift,
}


class Pair(NamedTuple):
    """Source mesh, target mesh, and where the source's vertices truly are on the target (n, 3)."""

    source: Surface
    target: Surface
    truth: Float


def pair(
    nodes_source: int = 4000,
    nodes_target: int = 4000,
    seed: int = 0,
    *,
    strength: float = 1.0,
    posed: bool = False,
    length: float = LENGTH,
) -> Pair:
    """Return a bone and another subject's, meshed independently, with the true correspondence.

    Parameters
    ----------
    nodes_source, nodes_target : int
        About how many vertices each.
    seed : int
        Which individual, and how the other differs.
    strength : float
        How much the other differs: 1 as much as people do, 0 not at all.
    posed : bool
        Also turn and shift the target, as another scanner would.
    length : float
        Length of the source.
    """
    source = bone(nodes_source, length=length, seed=seed, lattice=0)
    other = bone(nodes_target, length=length, seed=seed, lattice=1)
    steps = differences(seed, strength)
    if posed:
        steps = (*steps, ("turn", 0.4), ("shift", 0.3))
    target = Surface(warp(other.vertices, *steps, length=length), other.faces)
    return Pair(source, target, warp(source.vertices, *steps, length=length))


def differences(seed: int, strength: float = 1.0) -> tuple[Step, ...]:
    """Return the warps, for `warp`, by which `pair` makes the other subject."""
    rng = np.random.default_rng([seed, 7])
    usual = (("grow", 0.06), ("stretch", 0.05), ("bend", 0.12), ("twist", 0.2), ("bump", 0.012))
    share = rng.uniform(0.5, 1.0, len(usual)) * rng.choice((-1.0, 1.0), len(usual))
    return tuple(
        (kind, float(strength * much * part)) for (kind, much), part in zip(usual, share, strict=True)
    )


# --- plain solids -----------------------------------------------------------------------------------
def sphere(halvings: int = 3, *, radius: float = 1.0, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Surface:
    """Return a sphere of 10 x 4**halvings + 2 vertices: an icosahedron, its edges halved again and again."""
    golden = (1.0 + 5.0**0.5) / 2.0
    points = np.array([(0.0, i, j * golden) for i in (-1, 1) for j in (-1, 1)])
    points = np.concatenate([np.roll(points, k, axis=1) for k in range(3)])
    faces = np.array([f for f in combinations(range(12), 3) if _side(points[list(f)]) < 2.1])
    outward = (
        np.einsum("ij,ij->i", points[faces[:, 0]], np.cross(points[faces[:, 1]], points[faces[:, 2]])) > 0
    )
    surface = Surface(points, np.where(outward[:, None], faces, faces[:, ::-1]))
    for _ in range(halvings):
        surface = halved(surface.moved(unit(surface.vertices)))
    return Surface(unit(surface.vertices) * radius + np.asarray(centre), surface.faces)


def _side(corners: Float) -> float:
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max())


def box(
    size: ArrayLike = (1.0, 1.0, 1.0), cells: int | Sequence[int] = 4, *, low: ArrayLike = (0, 0, 0)
) -> Surface:
    """Return a closed box with its lowest corner at `low`, of cells along each axis, two faces to a cell."""
    count = np.broadcast_to(np.asarray(cells, dtype=np.int64), 3)
    faces = []
    for axis in range(3):
        one, two = (axis + 1) % 3, (axis + 2) % 3
        i, j = (
            grid.ravel() for grid in np.meshgrid(np.arange(count[one]), np.arange(count[two]), indexing="ij")
        )
        for top in (0, 1):
            at = np.zeros((4, len(i), 3), dtype=np.int64)
            at[:, :, axis] = top * count[axis]
            at[:, :, one] = i + np.array([[0], [1], [1], [0]])
            at[:, :, two] = j + np.array([[0], [0], [1], [1]])
            a, b, c, d = np.ravel_multi_index(tuple(np.moveaxis(at, 2, 0)), tuple(count + 1))
            quad = np.stack((np.column_stack((a, b, c)), np.column_stack((a, c, d))), axis=1).reshape(-1, 3)
            faces.append(quad if top else quad[:, ::-1])
    used, compact = np.unique(np.concatenate(faces), return_inverse=True)
    lattice = np.column_stack(np.unravel_index(used, tuple(count + 1)))
    vertices = np.asarray(low) + lattice / count * np.asarray(size, dtype=np.float64)
    return Surface(vertices, compact.reshape(-1, 3))
