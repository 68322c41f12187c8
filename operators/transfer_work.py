# SPDX-License-Identifier: GPL-3.0-or-later
"""What a transfer computes, as functions of arrays for the worker; SciPy is imported when they run."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ..femors_addon.progress import FemorsError, Progress, part
from .lazy import Array, np
from .transfer_checks import check_own, check_target

if TYPE_CHECKING:
    from ..femors_addon.carry import Carrier
    from ..femors_addon.landmarks import Prediction
    from ..femors_addon.mesh import Surface
    from ..femors_addon.regions import Region
    from ..femors_addon.report_transfer import Carried
    from ..femors_addon.transfer import Transfer, Transferred
    from ..femors_addon.transfer_settings import TransferSettings

LANDMARKS = "landmarks"
LOST = -0.5  # error of a region's area on the target, from which on the target may not show it
"""What landmarks together are called in a report."""


@dataclasses.dataclass(frozen=True, eq=False)
class Template:
    """A field, and the mesh whose groups are carried by it.

    Attributes
    ----------
    name : str
        Of the field.
    data : bytes
        Its file.
    source : str
        Name of the object.
    vertices, triangles : (n, 3), (m, 3)
        World positions of the object's vertices, and its faces.
    groups : dict of str to (n,)
        Weights of its vertex groups that are carried.
    """

    name: str
    data: bytes
    source: str
    vertices: Array
    triangles: Array
    groups: dict[str, Array]


@dataclasses.dataclass(frozen=True, eq=False)
class Groups:
    """Groups on a target.

    Attributes
    ----------
    marks : Prediction or None
        Landmarks, from groups of one vertex.
    nearest : (k,) int
        The target's vertex nearest to each.
    missed : (k,) float64
        How far it is.
    weights : dict of str to float
        Of each landmark's vertex, as on the source.
    regions : dict of str to Region
    notes : list of str
    report : dict
        All of it in figures, as `report_transfer` has it.
    """

    marks: Prediction | None
    nearest: Array
    missed: Array
    weights: dict[str, float]
    regions: dict[str, Region]
    notes: list[str]
    report: dict[str, Any]


@dataclasses.dataclass(frozen=True, eq=False)
class Thing:
    """An object to be carried.

    Attributes
    ----------
    name : str
    points : (p, 3) float64
        World positions.
    part : PartSource or None
        The elements of an FE part.
    mark : str
        The landmark that an empty is, else "".
    """

    name: str
    points: Array
    part: Any = None
    mark: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class Things:
    """Objects that were carried: for each its points and an FE part's exact nodes; landmarks among them."""

    moved: list[tuple[Transferred, Any]]
    marks: Prediction | None
    notes: list[str]
    report: dict[str, Any]


def carrier_of(data: bytes, name: str) -> Carrier:
    """Return a field, ready to carry."""
    from ..femors_addon.carry import Carrier
    from ..femors_addon.keptfield import decoded

    return Carrier(decoded(data, f"the field '{name}'"))


def groups(
    templates: Sequence[Template],
    target: Surface,
    name: str,
    settings: TransferSettings,
    project: bool,
    progress: Progress,
) -> Groups:
    """Carry the vertex groups of one object, or the landmarks of several and take their median.

    Raises
    ------
    FemorsError
        A field made for another object; groups that can only be carried all the way.
    """
    from scipy.spatial import cKDTree

    from ..femors_addon import landmarks
    from ..femors_addon.report_transfer import landmarks_of, region_rows, transfer_report
    from ..femors_addon.transfer import Transfer

    if settings.strength < 1.0 or settings.inverse:
        raise FemorsError(
            "Vertex groups go all the way from source to target: set strength to 1 and no inverse"
        )
    notes: list[str] = []
    found, regions, heavy, first = [], {}, {}, None
    for number, one in enumerate(templates):
        step = part(progress, number / len(templates), (number + 1) / len(templates))
        carrier = carrier_of(one.data, one.name)
        check_own(carrier, one.name, one.source, one.vertices)
        notes += check_target(carrier, one.name, name, target)
        transfer = Transfer(carrier, settings, target if project else None)
        first = transfer if number == 0 else first
        single = {name: int(np.flatnonzero(w)[0]) for name, w in one.groups.items() if (w > 0).sum() == 1}
        heavy |= {name: float(one.groups[name].max()) for name in single if name not in heavy}
        if single:
            prediction, far = _predicted(transfer, one, single, part(step, 0.0, 0.3))
            found.append(prediction)
            notes += [f"{one.name}: {words}" if len(templates) > 1 else words for words in far]
        rest = {name: w for name, w in one.groups.items() if name not in single}
        if rest and number == 0:
            regions = _regions(carrier, one, rest, target, part(step, 0.3, 1.0))
    marks, missing = landmarks.median_of(found) if found else (None, [])
    nearest, missed = np.empty(0, int), np.empty(0)
    if marks is not None:
        used = np.unique(target.faces)
        missed, near = cKDTree(target.vertices[used]).query(marks.points)
        nearest = used[near]
    carried = [] if marks is None else [landmarks_of(marks, target)]
    known = {one.name: marks for one in carried}
    report = transfer_report(first, carried, known, name)
    if regions:
        report["regions"] = region_rows(regions)
        lost = [name for name, region in regions.items() if region.area_error < LOST]
        notes += [f"most of the region '{it}' is not on the target: does it show that part?" for it in lost]
    notes += missing
    if marks is not None and first is not None:
        notes += marks.disagreeing(first.carrier.size)
    return Groups(marks, nearest, missed, heavy, regions, notes, {**report, "notes": notes})


def _predicted(
    transfer: Transfer, template: Template, vertices: dict[str, int], progress: Progress
) -> tuple[Prediction, list[str]]:
    """Return where landmarks at vertices go, and what is to be said of those far off the surface."""
    from ..femors_addon import landmarks

    names, before = list(vertices), template.vertices[list(vertices.values())]
    moved = transfer.points(before, progress)
    far = landmarks.far_ones(names, moved.distance, transfer.carrier.size)
    known = landmarks.predicted(transfer.carrier, names, before, moved.points, moved.projected)
    return known, [*far, *known.unseen(transfer.carrier.size)]


def _regions(
    carrier: Carrier, template: Template, groups: dict[str, Array], target: Surface, progress: Progress
) -> dict[str, Region]:
    """Return weights of vertices as weights of the target's."""
    from ..femors_addon.mesh import Surface as Mesh
    from ..femors_addon.regions import RegionMap

    shape = carrier.carry(template.vertices, progress=part(progress, 0.0, 0.4)).points
    ways = RegionMap(Mesh(shape, template.triangles), target, part(progress, 0.4, 0.7))
    return {name: ways.region(weights, part(progress, 0.7, 1.0)) for name, weights in groups.items()}


def things(
    data: bytes,
    name: str,
    items: Sequence[Thing],
    settings: TransferSettings,
    onto: tuple[str, Surface] | None,
    progress: Progress,
) -> Things:
    """Carry objects; empties, which are landmarks, also get their confidence."""
    from ..femors_addon import landmarks
    from ..femors_addon.report_transfer import Carried, transfer_report
    from ..femors_addon.transfer import Transfer

    carrier = carrier_of(data, name)
    notes = [] if onto is None or settings.inverse else check_target(carrier, name, *onto)
    transfer = Transfer(carrier, settings, None if onto is None else onto[1])
    out: list[tuple[Transferred, Any]] = []
    for number, item in enumerate(items):
        step = part(progress, number / len(items), (number + 1) / len(items))
        try:
            if item.part is not None:
                moved, nodes = _elements(transfer, item, step)
            else:
                moved, nodes = transfer.points(item.points, step), None
            if not item.mark and not moved.faults:  # landmarks are told together
                moved = dataclasses.replace(moved, notes=(*moved.notes, *transfer.unseen(item.points)))
            out.append((moved, nodes))
        except FemorsError as error:
            raise FemorsError(f"'{item.name}': {error}") from None
    rows = [row for row, item in enumerate(items) if item.mark]
    known, carried = None, []
    if rows:
        marks = _gathered([items[row] for row in rows], [out[row][0] for row in rows], transfer)
        together = transfer.with_words(marks.moved, marks.before)
        together = transfer.of_landmarks(together, marks.before, marks.names)
        notes += together.faults or together.notes
        for row in rows:  # which says it of all
            out[row] = dataclasses.replace(out[row][0], notes=(), faults=()), None
        carried.append(marks)
        if not settings.inverse and settings.strength == 1.0:
            known = landmarks.predicted(
                transfer.carrier, marks.names, marks.before, marks.moved.points, marks.moved.projected
            )
            notes += [] if together.faults else known.unseen(transfer.carrier.size)
    for item, (moved, _) in zip(items, out, strict=True):
        if not item.mark:
            carried.append(Carried(item.name, item.points, moved, transfer.distance_after(moved.points)))
    report = transfer_report(
        transfer, carried, {} if known is None else {LANDMARKS: known}, onto[0] if onto else ""
    )
    return Things(out, known, notes, {**report, "notes": [*report["notes"], *notes]})


def _gathered(items: Sequence[Thing], moved: Sequence[Transferred], transfer: Transfer) -> Carried:
    """Return landmarks as one thing."""
    from ..femors_addon.report_transfer import Carried
    from ..femors_addon.transfer import Transferred

    keys = ("points", "distance", "error", "projected")
    arrays = {key: np.concatenate([getattr(one, key) for one in moved]) for key in keys}
    before = np.concatenate([item.points for item in items])
    after = transfer.distance_after(arrays["points"])
    names = tuple(item.mark for item in items)
    return Carried(LANDMARKS, before, Transferred(**arrays), after, names)


def _elements(transfer: Any, item: Thing, progress: Progress) -> tuple[Transferred, Any]:
    """Carry a part of a deck with the nodes inside, in double precision."""
    from ..femors_addon.transforms import transformed
    from . import deck_store

    source = item.part
    deck = deck_store.unpacked(source.archive)
    own, vertex, before = source.shot.of(deck), source.shot.vertices(deck), source.shot.nodes(deck)
    coordinates = np.array(deck.coordinates)
    coordinates[own.nodes] = transformed(source.seen.matrix, before)
    mesh, nodes = deck.with_coordinates(coordinates).submesh(own)
    moved = transfer.mesh(mesh, progress)
    coordinates[nodes] = moved.points
    by_vertex = np.argsort(vertex)
    spread = {}
    for key in ("distance", "error", "projected"):
        values = np.zeros(len(coordinates))
        values[nodes] = getattr(moved, key)
        spread[key] = values[own.nodes][by_vertex]
    points = coordinates[own.nodes][by_vertex]
    known = source.seen.to_local(coordinates[own.nodes])
    return dataclasses.replace(moved, points=points, **spread), known
