# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether what a field is to carry, and what it is to be laid on, are still where the morph left them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..femors_addon.progress import FemorsError
from .lazy import Array, np

if TYPE_CHECKING:
    from ..femors_addon.carry import Carrier
    from ..femors_addon.mesh import Surface

OWN = 0.005  # of the size: half of an object's vertices may be so far from the surface that a field knows
NEARER = 5.0  # times as near to the morphed surface: it is that one
ROUNDED = 1e-4  # of the size: no distance at all
ELSEWHERE = 0.05  # of the size: a target farther from where the field ends is another one


def check_own(carrier: Carrier, field_name: str, name: str, vertices: Array) -> None:
    """Refuse an object that a field was not made for, or that lies on the target already.

    Parameters
    ----------
    name : str
        Of the object.
    vertices : (n, 3) array
        Its vertices, in world coordinates.
    """
    from ..femors_addon.nearest import SurfaceIndex

    field = carrier.field
    if not len(field.faces):
        raise FemorsError(f"The field '{field_name}' has no faces (of an early version): morph again")
    away = float(np.median(SurfaceIndex(field.origin).closest(vertices).distance))
    if away <= ROUNDED * field.origin.diagonal:
        return
    there = float(np.median(SurfaceIndex(field.morphed).closest(vertices).distance))
    if there <= OWN * field.morphed.diagonal and NEARER * there < away:
        raise FemorsError(
            f"'{name}' lies on the target already (was it morphed in place?): "
            f"choose '{field.source}' as it was, whose groups the field '{field_name}' carries"
        )
    if away <= OWN * field.origin.diagonal:  # remeshed or edited since
        return
    if name == field.source:
        what = "moved" if _same_shape(vertices, field.origin.vertices) else "moved or edited"
        raise FemorsError(
            f"'{name}' was {what} since the morph (by {away:.3g} in the median): "
            "put it back to where it was, or morph again"
        )
    raise FemorsError(
        f"The field '{field_name}' was made for another object: half of '{name}' is {away:.3g} "
        f"or more from '{field.source}' as it was morphed; choose that one, or morph again"
    )


def _same_shape(one: Array, other: Array) -> bool:
    """Whether two sets of points extend alike along their own axes."""
    widths = [
        np.linalg.svd(np.cov(np.unique(points, axis=0).T), compute_uv=False) ** 0.5 for points in (one, other)
    ]
    return bool(np.allclose(*widths, rtol=1e-3))


def check_target(carrier: Carrier, field_name: str, name: str, target: Surface) -> list[str]:
    """Refuse a target that is no longer where the field ends; return what to say of another one."""
    from ..femors_addon.cleaning import clean
    from ..femors_addon.nearest import SurfaceIndex

    field, size = carrier.field, carrier.field.morphed.diagonal
    if not len(field.faces) or np.isnan(field.residual).any():
        return []
    away = SurfaceIndex(clean(target.vertices, target.faces, "target").surface).closest(
        field.morphed.vertices
    )
    more = float(np.percentile(np.maximum(away.distance - field.residual, 0.0), 95))
    if more <= OWN * size:
        return []
    if name == field.target:
        raise FemorsError(
            f"'{name}' was moved or edited since the morph (it is {more:.3g} from where the field "
            f"'{field_name}' ends): put it back to where it was, or morph again"
        )
    words = f"'{name}' is up to {more:.3g} from where the field '{field_name}' ends"
    if more > ELSEWHERE * size:
        raise FemorsError(f"{words}: choose '{field.target}', which it was made for, or morph again")
    return [words]
