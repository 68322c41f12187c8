# SPDX-License-Identifier: GPL-3.0-or-later
"""What a check and a removal compute between reading and writing the scene; pure functions of arrays."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from ..femors_addon.overclosure_settings import OverclosureSettings
from ..femors_addon.progress import FemorsError, Preview, Progress, counted, part
from . import bodies
from .body_names import Pair
from .deck_nodes import Shape, together
from .lazy import Array, np

if TYPE_CHECKING:
    from ..femors_addon.overclosure import OverclosureResult
    from ..femors_addon.overclosure_check import Finding


@dataclasses.dataclass(frozen=True, eq=False)
class Ask:
    """What is asked of the bodies.

    Attributes
    ----------
    settings : OverclosureSettings
    exclude : tuple of pairs of names
    gaps : dict of pair of names to float
    """

    settings: OverclosureSettings
    exclude: tuple[Pair, ...]
    gaps: dict[Pair, float]


@dataclasses.dataclass(frozen=True, eq=False)
class Checked:
    """What a check found.

    Attributes
    ----------
    findings : list of Finding
    gaps : dict of str to (n,)
        Signed distance to the nearest other body, by vertex of each body.
    notes : tuple of str
        What the user should know of the bodies.
    """

    findings: list[Finding]
    gaps: dict[str, Array]
    notes: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True, eq=False)
class Removed:
    """What a removal gave, as Blender will hold it.

    Attributes
    ----------
    result : OverclosureResult
        Its certificate was measured on positions in single precision.
    moved : dict of str to (local, known)
        By name of each body that moved: positions by vertex, and exact ones by node of a deck's part.
    gaps : dict of str to (n,)
        As in `Checked`, afterwards.
    """

    result: OverclosureResult
    moved: dict[str, tuple[Array, Array | None]]
    gaps: dict[str, Array]


def check(shots: list[bodies.BodyShot], ask: Ask, progress: Progress) -> Checked:
    """Find the pairs that overlap, and the gap of every vertex."""
    from ..femors_addon.overclosure import check_overclosure

    models = bodies.models(shots)
    found = [model.body for model in models]
    notes: list[str] = []
    options: dict[str, Any] = {"exclude": ask.exclude, "gaps": ask.gaps, "tell": notes.append}
    findings = check_overclosure(found, ask.settings, part(progress, 0.0, 0.7), **options)
    gaps = _gaps(models, found, ask, part(progress, 0.7, 1.0))
    return Checked(findings, gaps, tuple(notes))


def remove(
    shots: list[bodies.BodyShot],
    ask: Ask,
    progress: Progress,
    previews: Mapping[str, Preview | None] | None = None,
) -> Removed:
    """Push the bodies apart; what is certified is what Blender will hold, not what was computed.

    Parameters
    ----------
    previews : dict of str to Preview, optional
        By name of the bodies that may move, where somebody looks on: given world positions by vertex.

    Raises
    ------
    FemorsError
        As the core's; also parts of one deck that share nodes and are not an excluded pair.
    """
    from ..femors_addon.overclosure import check_overclosure, remove_overclosure

    models = bodies.models(shots)
    _refuse_tied(models, ask.exclude)
    options: dict[str, Any] = {"exclude": ask.exclude, "gaps": _widened(models, ask)}
    if previews and any(previews.values()):
        options["preview"] = _shown(models, previews)
    result = remove_overclosure(
        [model.body for model in models], ask.settings, part(progress, 0.0, 0.85), **options
    )
    moved, held = {}, []
    for model, after in zip(models, result.bodies, strict=True):
        if after.moved:
            moved[model.body.name] = model.local(after.nodes)
            held.append(model.held(moved[model.body.name][0]))
        else:
            held.append(model.body)
    _refuse_torn(models, moved)
    if moved:
        options.pop("preview", None)
        options["gaps"] = ask.gaps
        findings = check_overclosure(held, ask.settings, part(progress, 0.85, 0.95), **options)
        result = _as_held(result, findings, ask)
    return Removed(result, moved, _gaps(models, held, ask, part(progress, 0.95, 1.0)))


def _shown(
    models: list[bodies.Model], previews: Mapping[str, Preview | None]
) -> Callable[[Mapping[str, Array]], None]:
    """Return what takes the nodes of all bodies to their previews, by vertex."""
    seen = {}
    for model in models:
        preview = previews.get(model.body.name)
        if preview is not None:
            matrix = model.shot.seen.matrix
            start = model.shot.local @ matrix[:3, :3].T + matrix[:3, 3]
            seen[model.body.name] = (start, model.rows, preview)

    def show(nodes: Mapping[str, Array]) -> None:
        for name, (start, rows, preview) in seen.items():
            moved = start.copy()
            moved[rows] = nodes[name]
            preview(moved)

    return show


def _gaps(models: list[bodies.Model], placed: list[Any], ask: Ask, progress: Progress) -> dict[str, Array]:
    from ..femors_addon.overclosure_check import gap_map

    values = gap_map(placed, progress=progress, exclude=ask.exclude)
    rest = max(float(value.max()) for value in values.values())
    return {model.body.name: model.by_vertex(values[model.body.name], rest) for model in models}


def _widened(models: list[bodies.Model], ask: Ask) -> dict[Pair, float]:
    """Return gaps by pair that still hold when objects with a transform are rounded in their own space."""
    own = {frozenset(pair): gap for pair, gap in ask.gaps.items()}
    out = dict(ask.gaps)
    for one, two in itertools.combinations(models, 2):
        rounding = one.rounding + two.rounding
        if rounding > 0:
            pair = one.body.name, two.body.name
            out.pop(pair[::-1], None)
            out[pair] = own.get(frozenset(pair), ask.settings.gap) + rounding
    return out


def _as_held(result: OverclosureResult, findings: list[Finding], ask: Ask) -> OverclosureResult:
    """Return the result with the pairs as they were measured on what Blender will hold."""
    asked = {frozenset(pair): gap for pair, gap in ask.gaps.items()}
    before = tuple(
        dataclasses.replace(f, gap=asked.get(frozenset(f.names), ask.settings.gap)) for f in result.before
    )
    reasons = result.reasons
    if not reasons:
        reasons = tuple(f"{f} (in single precision, as Blender keeps it)" for f in findings if not f.clear)
    return dataclasses.replace(
        result, before=before, after=tuple(findings), certified=not reasons, reasons=reasons
    )


# --- parts of one deck --------------------------------------------------------------------------------
def _refuse_tied(models: list[bodies.Model], exclude: Iterable[Pair]) -> None:
    """Refuse to part two parts of a deck where they share nodes."""
    spared = {frozenset(pair) for pair in exclude}
    for one, two in itertools.combinations(models, 2):
        if one.deck is None or one.deck is not two.deck or one.shot.part.part == two.shot.part.part:
            continue
        shared = np.intersect1d(one.members, two.members)
        if len(shared) and frozenset((one.body.name, two.body.name)) not in spared:
            raise FemorsError(
                f"'{one.body.name}' and '{two.body.name}' share {counted(len(shared), 'node')} of "
                "their deck and cannot be parted: exclude the pair"
            )


def _refuse_torn(models: list[bodies.Model], moved: Mapping[str, tuple[Array, Array | None]]) -> None:
    """Refuse what would invert elements that share nodes with a body and belong to none."""
    from ..femors_addon.volume_quality import scaled_jacobians

    for deck in {id(m.deck): m.deck for m in models if m.deck is not None}.values():
        mine = [m for m in models if m.deck is deck]
        placed = {m.shot.part.part: m for m in mine if m.body.name in moved}
        if not placed or len({m.shot.part.part for m in mine}) < len(mine):
            continue  # a part that stands in several places has no one shape
        shots = []
        for model in placed.values():
            local, known = moved[model.body.name]
            shape = Shape(local.astype(np.float32), known)
            shots.append(dataclasses.replace(model.shot.part, base=shape, keys=()))
        inside = np.concatenate([m.shot.part.of(deck).elements for m in mine])
        outside = np.ones(deck.mesh.element_count, dtype=bool)
        outside[inside] = False
        after = together(deck, shots)  # refuses nodes that two bodies moved to different places
        if not outside.any():
            continue
        valid = outside & (scaled_jacobians(deck.mesh) > 0)
        torn = np.flatnonzero(valid & (scaled_jacobians(after.mesh) <= 0))
        if len(torn):
            raise FemorsError(
                f"{counted(len(torn), 'element')} of no body, sharing nodes with '{mine[0].body.name}' or "
                f"its like, would be inverted (first: {int(deck.mesh.element_ids[torn[0]])}): make "
                "them a body"
            )
