# SPDX-License-Identifier: GPL-3.0-or-later
"""What is reported of a transfer: each landmark and each thing before and after, and pictures of both."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .callouts import named
from .carry import FADE
from .cleaning import clean
from .landmarks import UNSEEN, Prediction
from .mesh import Float, Surface
from .nearest import SurfaceIndex
from .picture import BONE, FINER, Colours, Look, View, facing, views
from .plots import histogram
from .quality import Stat
from .regions import Region
from .report_figures import TARGET, with_unit
from .report_html import Figure, Item, Section
from .shapes import sphere
from .transfer import Transfer, Transferred, distinct

DOT, DOT_SIZE = (0.80, 0.18, 0.12), 0.012  # a landmark in pictures: colour, and radius of the size
NUDGE = 1e-3  # of the size: so much nearer to the eye is drawn what was carried
NAMED = 36  # landmarks in a picture: the names of more would be a thicket, and so many fit beside it
CARRIED = (0.45, 0.66, 0.38)
ROUNDING = 1e-7  # of the size
FEW = 30  # points: fewer make no histogram
SURFACES = {False: ("source, aligned", "target"), True: ("target", "source")}
"""From and to what distances are measured, by `TransferSettings.inverse`."""


@dataclasses.dataclass(frozen=True, eq=False)
class Carried:
    """A thing that was carried, for a report.

    Attributes
    ----------
    name : str
    before : (p, 3) float64
    moved : Transferred
    after : (p,) float64
        Signed distance from the surface that it ends beside, see `Transfer.distance_after`.
    names : tuple of str
        Of landmarks, one for each point; empty for any other thing.
    faces : (m, 3) int32 or None
        Of a mesh, for the pictures.
    """

    name: str
    before: Float
    moved: Transferred
    after: Float
    names: tuple[str, ...] = ()
    faces: Any = None


def landmarks_of(known: Prediction, target: Surface) -> Carried:
    """Return landmarks that were predicted on a target, measured from its surface."""
    assert known.before is not None
    moved = Transferred(known.points, known.distance, np.zeros(len(known.points)), known.projected)
    after = SurfaceIndex(clean(target.vertices, target.faces, "target").surface).signed(known.points)
    return Carried("landmarks", known.before, moved, after, known.names)


def in_range(distance: float, size: float, residual: float = 0.0) -> str:
    """Return in words how far a field of a size reaches at a distance from its surface.

    `residual` is how far the target is from the morphed surface there; NaN where that is not known.
    """
    if residual > UNSEEN * size:
        return "no, the target does not show it"
    if abs(distance) <= FADE[0] * size:
        return "yes"
    return "partly" if abs(distance) < FADE[1] * size else "no, alignment only"


def landmark_rows(carried: Carried, size: float, known: Prediction | None = None) -> list[dict[str, Any]]:
    """Return one record for each landmark: places, distances, and what tells how far to trust it.

    Parameters
    ----------
    carried : Carried
        With `names`.
    size : float
        Of the field's surface, `Carrier.size`.
    known : Prediction, optional
        Of the same landmarks in the same order.
    """
    columns = {} if known is None else known.columns()
    if known is not None and known.templates.max() < 2:
        columns = {key: columns[key] for key in ("residual", "stretch")}
    rows = []
    for row, name in enumerate(carried.names):
        distance = float(carried.moved.distance[row])
        record: dict[str, Any] = {
            "landmark": name,
            "before": [float(value) for value in carried.before[row]],
            "after": [float(value) for value in carried.moved.points[row]],
            "distance_before": tidy(distance, size),
            "distance_after": tidy(carried.after[row], size),
            "in_range": in_range(distance, size, np.nan if known is None else float(known.residual[row])),
            "projected": tidy(carried.moved.projected[row], size),
        }
        for key in ("residual", "stretch", "spread", "templates"):
            if key in columns:
                record[key] = finite(columns[key][row])
        rows.append(record)
    return rows


def thing_row(carried: Carried, size: float) -> dict[str, Any]:
    """Return the record of a mesh, a curve or a model: distances as statistics over its points.

    Of a soup of triangles, points at one place count as one.
    """
    moved, points = carried.moved, carried.moved.points
    soup = carried.faces is not None and np.size(carried.faces) == len(points)
    rows = distinct(points) if soup else np.arange(len(points))
    away, projected, error = np.abs(moved.distance[rows]), moved.projected[rows], moved.error[rows]
    after = carried.after[rows][np.isfinite(carried.after[rows])]
    return {
        "name": carried.name,
        "points": len(rows),
        "distance_before": Stat.of(away).as_dict(),
        "distance_after": Stat.of(np.abs(after)).as_dict() if len(after) else None,
        "in_range": f"{100 * (away <= FADE[0] * size).mean():.4g} %",
        "moved": Stat.of(np.linalg.norm(points[rows] - carried.before[rows], axis=1)).as_dict(),
        "projected": Stat.of(projected).as_dict() if projected.any() else None,
        "error_of_the_inverse": Stat.of(error).as_dict() if error.any() else None,
        "put_back_to_its_side": moved.kept or None,
    }


def region_rows(regions: Mapping[str, Region]) -> list[dict[str, Any]]:
    """Return one record for each region on a target's mesh."""
    return [
        {
            "region": name,
            "vertices": int(np.count_nonzero(region.weights)),
            "area": finite(region.area),
            "area_error": finite(region.area_error),
            "centroid_off_by": finite(region.centroid_error),
        }
        for name, region in regions.items()
    ]


def tidy(value: float, size: float) -> float | None:
    """Return a length, 0 where single precision would have it so, None where it is not known."""
    return (float(value) if abs(value) > ROUNDING * size else 0.0) if np.isfinite(value) else None


def finite(value: Any) -> Any:
    """Return a number, or None for one that is not known; whole numbers stay whole."""
    if isinstance(value, int):
        return value
    return float(value) if np.isfinite(value) else None


def transfer_report(
    transfer: Transfer,
    carried: Sequence[Carried],
    known: Mapping[str, Prediction] | None = None,
    onto: str = "",
) -> dict[str, Any]:
    """Return the report of what a field has carried, as `report_tables` reads it.

    Parameters
    ----------
    transfer : Transfer
    carried : sequence of Carried
    known : mapping of str to Prediction, optional
        By the names of things that are landmarks.
    onto : str, optional
        The name of the surface that was projected onto.
    """
    field, size = transfer.carrier.field, transfer.carrier.size
    before, after = SURFACES[transfer.settings.inverse]
    ends = f"'{onto}'" if onto else f"the {after}, where the field has it"
    out: dict[str, Any] = {
        "kind": "transfer",
        "distance_before": f"from the {before}; negative inside",
        "distance_after": f"from {ends}; negative inside" if transfer.settings.strength == 1.0 else None,
    }
    rows: list[dict[str, Any]] = []
    marked = [one for one in carried if one.names]
    for one in marked:
        beside = {"file": one.name} if len(marked) > 1 else {}  # which of them a landmark is of
        found = landmark_rows(one, size, (known or {}).get(one.name))
        rows += [{"landmark": row["landmark"], **beside, **row} for row in found]
    if rows:
        out["landmarks"] = rows
    things = [thing_row(one, size) for one in carried if not one.names]
    if things:
        out["carried"] = things
    out["field"] = {"name": field.name, "made": field.date or None, "size": size, "reach": FADE[0] * size}
    out["notes"] = [f"{one.name}: {note}" for one in carried for note in one.moved.notes]
    out["faults"] = [f"{one.name}: {fault}" for one in carried for fault in one.moved.faults]
    out["settings"] = dataclasses.asdict(transfer.settings)
    return out


# --- pictures -----------------------------------------------------------------------------------
def transfer_figures(
    before: Surface | None,
    after: Surface | None,
    carried: Sequence[Carried],
    unit: str = "",
    regions: tuple[Float | None, Float | None] = (None, None),
) -> list[Section]:
    """Return the sections "Pictures" and "Distributions" of a transfer.

    Parameters
    ----------
    before, after : Surface
        What things were carried off, and what they end beside; None where it is not known any more.
    unit : str
        Of lengths; "" where it is not known.
    regions : pair of (n,) and (m,) arrays, optional
        Weights, 0 to 1, of the two surfaces' vertices: how far each is in a region.
    """
    items: list[Item] = []
    for surface, weights, colour, title, last in (
        (before, regions[0], BONE, "Before", False),
        (after, regions[1], TARGET, "After", True),
    ):
        if surface is None:
            continue
        ink = colour if weights is None else _mixed(weights, colour)
        beside = []
        for one in carried:
            points = one.moved.points if last else one.before
            if one.faces is not None and len(one.faces):
                beside.append(_Drawn(Surface(points, one.faces), CARRIED))
            elif one.names and len(points):
                ball = dots(points, DOT_SIZE * surface.diagonal)
                beside.append(_Drawn(ball, DOT, points, one.names))
        sights = views([surface, *(one.surface for one in beside)])
        for seen, word in zip(sights, ("", ", a quarter turn on"), strict=True):
            sight = facing(seen, [one.surface.vertices for one in beside])
            items.append(_figure(surface, ink, beside, sight, title + word))
    if any(one.names for one in carried) and items:
        items.append("Landmarks are the red dots; one inside the surface or behind it is hidden.")
    spread = {
        "before": np.concatenate([np.abs(one.moved.distance) for one in carried] or [np.empty(0)]),
        "after": np.concatenate([np.abs(one.after) for one in carried] or [np.empty(0)]),
    }
    sections = [Section("Pictures", tuple(items))]
    if len(spread["before"]) >= FEW:
        label = with_unit("distance from the surface", unit)
        drawn = histogram(spread, label, "points")
        words = "Distance of what was carried from the surface, before and after."
        sections.append(Section("Distributions", (Figure(drawn, words),)))
    return sections


@dataclasses.dataclass(frozen=True, eq=False)
class _Drawn:
    """What was carried, in a picture; of landmarks the points (p, 3) and their names, else none."""

    surface: Surface
    colour: tuple[float, float, float]
    points: Float | None = None
    names: tuple[str, ...] = ()


def _figure(surface: Surface, ink: Colours, beside: Sequence[_Drawn], sight: View, title: str) -> Figure:
    """Draw a surface and what was carried, with the names of the landmarks that are seen."""
    closer = NUDGE * surface.diagonal * sight.towards  # what lies on the surface is seen
    look = Look.of([surface, *(one.surface.moved(one.surface.vertices + closer) for one in beside)], sight)
    drawn = look.coloured([ink, *(one.colour for one in beside)])
    names: list[tuple[float, float, str]] = []
    for one, (balls, _, faces, *_) in zip(beside, look.parts[1:], strict=True):
        if one.points is None:
            continue
        seen = np.unique(faces // (len(balls.faces) // len(one.points)))
        places = sight.placed(one.points, look.shape) / FINER
        names += [(*places[k].tolist(), one.names[k]) for k in seen.tolist()]
    return Figure(named(drawn, names, title) if 0 < len(names) <= NAMED else drawn, title)


def _mixed(weights: Float, colour: tuple[float, float, float]) -> Float:
    share = np.clip(weights, 0.0, 1.0)[:, None]
    return share * np.array(CARRIED) + (1.0 - share) * np.array(colour)


def dots(points: Float, radius: float) -> Surface:
    """Return small balls at points (k, 3), as one surface."""
    ball = sphere(1, radius=radius)
    vertices = (np.asarray(points)[:, None, :] + ball.vertices[None]).reshape(-1, 3)
    first = len(ball.vertices) * np.arange(len(points))
    return Surface(vertices, (ball.faces[None] + first[:, None, None]).reshape(-1, 3))
