# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole geometries carried by a field: projected where asked, kept on their side, and looked at.

What moves is `carry.Carrier`'s; here stands what is done around it for a mesh, a deck or landmarks, and
what the user should hear: points far from the source, things carried already, a field of another object.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from . import settings as declared
from . import triples
from .cached import cached_property
from .carry import FADE, Carrier
from .cleaning import clean
from .landmarks import UNSEEN, far_ones
from .mesh import Float, Int, Surface
from .nearest import SurfaceIndex
from .progress import FemorsError, Progress, counted, part, silent
from .transfer_settings import TransferSettings
from .transfer_units import FAR, ON, SAMPLE, FieldUnit
from .transforms import mirrors, transformed
from .volume import VolumeMesh
from .volume_morph import kept_valid
from .volume_quality import scaled_jacobians

OFF_TARGET = 0.02  # of the size: a surface to project onto that is farther may be the wrong one
SIDE = 1e-6  # of the size: what is closer to the surface is on no side of it
THERE = 0.002  # of the size: half of what was carried before is so near the surface that it was carried to,
AWAY = 5.0  # and so many times as far from the other


@dataclasses.dataclass(frozen=True, eq=False)
class Transferred:
    """Points (p, 3) that were carried, and what is to be said of them.

    Attributes
    ----------
    points : (p, 3) float64
    distance : (p,) float64
        From the surface that they were carried off, after the alignment; negative inside.
    error : (p,) float64
        Of an inverse, see `carry.Carried`.
    projected : (p,) float64
        How far each was moved onto the surface; 0 without projection.
    kept : int
        Points that were put back to the side of the surface that they came from.
    notes, faults : tuple of str
        What the user should know; faults say that the result is not what was wanted.
    """

    points: Float
    distance: Float
    error: Float
    projected: Float
    kept: int = 0
    notes: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()

    def summary(self, soup: bool = False) -> str:
        """Return the figures in a line; of a soup of triangles, points at one place count as one."""
        rows = distinct(self.points) if soup else np.arange(len(self.points))
        away, projected, error = np.abs(self.distance[rows]), self.projected[rows], self.error[rows]
        middle, most = np.median(away), away.max()
        words = [f"{counted(len(rows), 'point')}, median {middle:.3g} (max {most:.3g}) from the surface"]
        if projected.any():
            words.append(f"projected by {np.median(projected):.3g} (max {projected.max():.3g})")
        if error.any():
            words.append(f"error of the inverse {np.median(error):.2g} (max {error.max():.2g})")
        if self.kept:
            words.append(f"{self.kept} put back to their side of the surface")
        return "; ".join(words)


def distinct(points: Float) -> Int:
    """Return one row for each place among points (p, 3)."""
    return np.unique(points, axis=0, return_index=True)[1]


class Transfer:
    """A field, the settings, and the surface to project onto, for as many things as one likes.

    Parameters
    ----------
    carrier : Carrier
    settings : TransferSettings
    onto : Surface, optional
        What points are projected onto.
    own : bool
        Whether the things are known to be the source's, so that none was carried before.

    Raises
    ------
    FemorsError
        Settings outside their limits; a projection of what is carried only a part of the way.
    """

    def __init__(
        self, carrier: Carrier, settings: TransferSettings, onto: Surface | None = None, own: bool = False
    ) -> None:
        declared.check(settings)
        if onto is not None and settings.strength < 1.0:
            raise FemorsError("a projection needs strength 1: what goes a part of the way is on no surface")
        self.carrier, self.settings, self.own = carrier, settings, own
        self.onto = None if onto is None else SurfaceIndex(clean(onto.vertices, onto.faces, "target").surface)
        if self.onto is not None and len(carrier.field.faces):
            end = FieldUnit(self._after, f"surface that the field '{carrier.field.name}' ends on")
            if self._elsewhere and (faults := end.unlike(self.onto.surface.vertices)[1]):
                raise FemorsError(f"the surface to project onto {faults[0]}")

    # --- points and surfaces ------------------------------------------------------------------
    def points(self, points: Float, progress: Progress = silent) -> Transferred:
        """Carry points (p, 3) of landmarks or a surface; projected, all of them lie on the surface."""
        out = self._carried(points, part(progress, 0.0, 0.8))
        if self.onto is not None:
            place = self.onto.closest(out.points, part(progress, 0.8, 1.0))
            out = dataclasses.replace(out, points=place.point, projected=place.distance)
        elif self._whole:
            out = self._on_their_side(out, self._after)
        return self.with_words(out, points)

    @property
    def _whole(self) -> bool:
        return self.settings.strength == 1.0 and bool(len(self.carrier.field.faces))

    def _carried(self, points: Float, progress: Progress) -> Transferred:
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        if not len(points):
            raise FemorsError("has no points to be carried")
        if (bad := triples.unfit(points)) is not None:
            raise FemorsError(triples.complaint(bad, "points", lambda row: row + 1))
        onto = 0 if self.onto is None else len(self.onto.surface.vertices)
        first, which = triples.placed(points)  # an STL file has each node six times
        self.carrier.require(onto + len(first))
        way = self.carrier.uncarry if self.settings.inverse else self.carrier.carry
        got = way(points[first], self.settings.strength, progress)
        return Transferred(got.points[which], got.distance[which], got.error[which], np.zeros(len(points)))

    @cached_property
    def _after(self) -> SurfaceIndex:
        """The surface that things end beside."""
        field = self.carrier.field
        return SurfaceIndex(field.origin if self.settings.inverse else field.morphed)

    @cached_property
    def _before(self) -> SurfaceIndex:
        field = self.carrier.field
        return SurfaceIndex(field.morphed if self.settings.inverse else field.origin)

    def _on_their_side(self, out: Transferred, index: SurfaceIndex) -> Transferred:
        """Put what has changed sides of a closed surface back, as far from it as it was."""
        size, field = self.carrier.size, self.carrier.field
        if field.aligned.border.any() or index.surface.border.any():
            return out
        rows = np.flatnonzero((np.abs(out.distance) > SIDE * size) & (np.abs(out.distance) < FADE[0] * size))
        if not len(rows):
            return out
        found = index.closest(out.points[rows])
        normal = index.pseudonormals(found)
        if index is self._after and self.settings.inverse and mirrors(field.transform):
            normal = -normal  # the source of a mirrored field is wound inward
        side = np.einsum("ij,ij->i", out.points[rows] - found.point, normal)
        wrong = side * out.distance[rows] < 0
        points = out.points.copy()
        points[rows[wrong]] = found.point[wrong] + out.distance[rows[wrong], None] * normal[wrong]
        return dataclasses.replace(out, points=points, kept=int(wrong.sum()))

    # --- solids -------------------------------------------------------------------------------
    def mesh(self, mesh: VolumeMesh, progress: Progress = silent) -> Transferred:
        """Carry the nodes of a mesh of finite elements.

        Projected, the nodes that lay on the source's surface are laid onto the target's, all others stay on
        their side of it. No solid element that was valid is inverted.
        """
        if not mesh.solid:
            return self.points(mesh.nodes, progress)
        field, inverse = self.carrier.field, self.settings.inverse
        if mirrors(field.transform):
            raise FemorsError("the field mirrors, which would turn every solid element inside out")
        out = self._carried(mesh.nodes, part(progress, 0.0, 0.6))
        if self._whole:
            index = self._after
            if self.onto is not None:
                index, on = self.onto, np.abs(out.distance) <= ON * self.carrier.size
                place = self.onto.closest(out.points[on])
                points, projected = out.points.copy(), out.projected.copy()
                points[on], projected[on] = place.point, place.distance
                out = dataclasses.replace(out, points=points, projected=projected)
                out = dataclasses.replace(out, distance=np.where(on, 0.0, out.distance))
            out = self._on_their_side(out, index)
        progress(0.8, "no element inverted")
        matrix = np.linalg.inv(field.transform) if inverse else field.transform
        goal = transformed(matrix, mesh.nodes)
        base = mesh.nodes + self.settings.strength * (goal - mesh.nodes)
        nodes, held, held_by = kept_valid(mesh.moved(base), out.points, scaled_jacobians(mesh) > 0)
        out = self.with_words(dataclasses.replace(out, points=nodes), mesh.nodes)
        if len(held):
            note = (
                f"{counted(len(held), 'node')} held back by up to {held_by:.3g}, so that no "
                "element is inverted"
            )
            out = dataclasses.replace(out, notes=(*out.notes, note))
        return out

    def surfaces(self) -> tuple[Surface | None, Surface | None]:
        """Return what things are carried off, and what they end beside; None for a field without faces."""
        if not len(self.carrier.field.faces):
            return None, None if self.onto is None else self.onto.surface
        return self._before.surface, (self._after if self.onto is None else self.onto).surface

    def distance_after(self, points: Float) -> Float:
        """Return (p,) signed distances of carried points from the surface that they end beside.

        That which was projected onto, else where the field has the target (its source, for an inverse);
        NaN where it has no surface, and for what was carried only a part of the way.
        """
        if not self._whole:
            return np.full(len(points), np.nan)
        index = self._after if self.onto is None else self.onto
        out = index.signed(points)
        inward = self.settings.inverse and self.onto is None and mirrors(self.carrier.field.transform)
        return -out if inward else out

    # --- words --------------------------------------------------------------------------------
    def with_words(self, out: Transferred, points: Float) -> Transferred:
        """Return points (p, 3) that were carried with what is to be said of them."""
        size, away = self.carrier.size, np.abs(out.distance)
        notes, faults = list(out.notes), list(out.faults)
        here, there = ("target", "source") if self.settings.inverse else ("source", "target")
        name = self.carrier.field.name
        if away.min() >= FADE[1] * size:
            faults.append(
                f"every point is {away.min():.3g} or more from the {here} of the field '{name}', out of its "
                "reach, so that only the alignment was applied; was the field made for another object?"
            )
        elif np.median(away) > FAR * size:
            notes.append(
                f"half of the points are {np.median(away):.3g} or more from the {here}'s surface; "
                "do they belong to another bone?"
            )
        notes += self.unit.small(points)
        if self._elsewhere and np.median(out.projected) > OFF_TARGET * size:
            notes.append(
                f"projected by {np.median(out.projected):.3g} in the median: the surface is "
                f"{self._elsewhere:.3g} from where the field ends; is it the right one?"
            )
        if not self.own and self._already(points):
            way = "without inverse" if self.settings.inverse else "inverse"
            faults.append(
                f"lies on the {there} already, not on the {here}: carried before? "
                f"Carry the original, or go the other way ({way})"
            )
        return dataclasses.replace(out, notes=tuple(notes), faults=tuple(faults))

    def of_landmarks(self, moved: Transferred, points: Float, names: Sequence[str]) -> Transferred:
        """Return carried points with what is to be said where they are landmarks (p, 3), by their names.

        Another unit than the field's explains all else that is odd of them.
        """
        carried = not self.own and self._already(points)
        units = [] if carried else self.unit.of_landmarks(points)
        if units:
            return dataclasses.replace(moved, notes=(), faults=tuple(units))
        far = far_ones(names, moved.distance, self.carrier.size)
        return dataclasses.replace(moved, notes=(*far, *moved.notes))

    @cached_property
    def unit(self) -> FieldUnit:
        """What tells whether things are in the field's unit of length."""
        field, here = self.carrier.field, "target" if self.settings.inverse else "source"
        return FieldUnit(self._before if len(field.faces) else None, f"{here} of the field '{field.name}'")

    def unseen(self, points: Float) -> list[str]:
        """Return what to say of a mesh's points (p, 3): half of them are by what the target does not show."""
        if self.settings.inverse or self.settings.strength == 0.0:
            return []
        sample = points[:: max(len(points) // SAMPLE, 1)]
        known = self.carrier.residual_at(self.carrier.at(sample))
        known = known[np.isfinite(known)]
        residual = float(np.median(known)) if len(known) else 0.0
        if not residual > UNSEEN * self.carrier.size:
            return []
        return [
            f"the target shows nothing of the source there, it is {residual:.3g} away in the median: a guess"
        ]

    @cached_property
    def _elsewhere(self) -> float:
        """Median distance of where the field ends from the surface to project onto, 0 where it is near."""
        if self.onto is None or not len(self.carrier.field.faces):
            return 0.0
        away = float(np.median(self.onto.closest(self._after.surface.vertices).distance))
        return away if away > OFF_TARGET * self._after.surface.diagonal else 0.0

    def _already(self, points: Float) -> bool:
        """Whether points (p, 3) lie where they should end, and not where they should begin."""
        if not len(self.carrier.field.faces):
            return False
        sample = np.asarray(points)[:: max(len(points) // SAMPLE, 1)]
        near = float(np.median(self._after.closest(sample).distance))
        far = float(np.median(self._before.closest(sample).distance))
        near, far = near / self._after.surface.diagonal, far / self._before.surface.diagonal
        return near < THERE and far > max(AWAY * near, 1.5 * THERE)
