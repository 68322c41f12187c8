# SPDX-License-Identifier: GPL-3.0-or-later
"""What a mesh can be coloured by: names, units, and the figures that follow from its shape alone."""

from __future__ import annotations

import dataclasses

import numpy as np

from .mesh import Float, Surface
from .quality import aspect_ratio, skewness
from .settings import Unit


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A number at every vertex or face.

    Attributes
    ----------
    label, help : str
    attribute : str
        Under which a mesh keeps it.
    unit : str
        "length", or "" for a pure number.
    signed : bool
        Whether zero divides two kinds, so that the range is centred there.
    of_faces : bool
        Whether it belongs to faces and follows from their shape, see `of_shape`.
    """

    label: str
    attribute: str
    help: str
    unit: Unit = ""
    signed: bool = False
    of_faces: bool = False


QUANTITIES: dict[str, Quantity] = {
    "surface_distance": Quantity(
        "Distance to target", "femors_surface_distance", "From each vertex to the target's surface", "length"
    ),
    "displacement": Quantity(
        "Displacement", "femors_displacement", "How far each vertex was moved after the alignment", "length"
    ),
    "gap": Quantity(
        "Gap",
        "femors_gap",
        "Signed distance to the other mesh: negative where the two overlap",
        "length",
        signed=True,
    ),
    "aspect": Quantity(
        "Aspect ratio", "femors_aspect", "Longest side of a face over its shortest; 1 is best", of_faces=True
    ),
    "skewness": Quantity(
        "Skewness", "femors_skewness", "0 is an equilateral triangle, 1 has no area", of_faces=True
    ),
    "scaled_jacobian": Quantity(
        "Scaled Jacobian",
        "femors_scaled_jacobian",
        "Of the elements at each node, or of the face: 1 is regular, 0 flat, negative inside out",
        of_faces=True,
    ),
}
"""By key, in the order in which they are offered."""


def of_shape(key: str, surface: Surface) -> Float:
    """Return a quantity of the faces (m,) that follows from their shape."""
    if key == "aspect":
        return aspect_ratio(surface)
    if key == "skewness":
        return skewness(surface)
    if key == "scaled_jacobian":
        return triangle_jacobians(surface)
    raise KeyError(key)


def triangle_jacobians(surface: Surface) -> Float:
    """Scaled Jacobian (m,) of triangles, in [0, 1]: the sine of the smallest angle, 1 where equilateral.

    Twice the area over the product of the two longest sides, as a share of what it is in the equilateral
    triangle (Knupp; Stimpson et al., SAND2007-1751).
    """
    corners = surface.corners
    sides = [corners[:, i] - corners[:, i - 1] for i in range(3)]
    lengths = np.sort(np.column_stack([np.linalg.norm(side, axis=1) for side in sides]), axis=1)
    longest = lengths[:, 1] * lengths[:, 2]
    twice = 2.0 * surface.face_areas
    return np.clip(
        np.divide(twice, longest, out=np.zeros(len(twice)), where=longest > 0) * 2 / 3**0.5, 0.0, 1.0
    )


def worst(key: str, values: Float, group: np.ndarray, count: int) -> Float:
    """Return (count,) the worst of the values of each group (a polygon's triangles, say); 0 where none is."""
    smaller = key == "scaled_jacobian"
    out = np.full(count, np.inf if smaller else -np.inf)
    (np.minimum if smaller else np.maximum).at(out, group, values)
    out[~np.isfinite(out)] = 0.0
    return out
