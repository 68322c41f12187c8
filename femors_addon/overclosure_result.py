# SPDX-License-Identifier: GPL-3.0-or-later
"""What comes back from a removal: the bodies, the certificate or the reasons, and the figures."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from .bodies import Solid
from .crew import each
from .findings import CONTAINED, NEAR, Excluded, Finding
from .overclosure_figures import BodyResult, figures_of, losses_of
from .overclosure_notes import afterwards, notes_of
from .overclosure_settings import OverclosureSettings
from .passing import Passing
from .progress import Progress, counted

if TYPE_CHECKING:
    from .effort import Effort

METHODS = {"grnn": "smooth field", "nodal": "nodal method", "published": "loop as published"}


@dataclasses.dataclass(frozen=True)
class Step:
    """One iteration: the largest depth still missing, edges that pierced, and the largest spread."""

    number: int
    missing: float
    pierced: int
    spread: float


@dataclasses.dataclass(frozen=True, eq=False)
class OverclosureResult:
    """What a removal has done.

    Attributes
    ----------
    bodies : tuple of BodyResult
        In the order given.
    before, after : tuple of Finding
        Pairs that overlapped or were close; the second is the certificate's own measure.
    certified : bool
        Whether every pair is clear, none went through each other, and no element was inverted.
    reasons : tuple of str
        Why it is not certified, pair by pair; empty where it is.
    history : tuple of Step
    spread : float
        Largest spread of a field: farther than three of it from contact nothing moved.
    notes : tuple of str
        What was mended for the maths, and what else the user should know.
    losses : tuple of str
        Which bodies have lost much of their volume, certified or not.
    excluded : tuple of Excluded
        Pairs that may overlap: the certificate does not cover them, and only tells how deep they are.
    seconds : float
        CPU time, figures included.
    solve_seconds : float
        CPU time from the input to the certificate.
    """

    bodies: tuple[BodyResult, ...]
    before: tuple[Finding, ...]
    after: tuple[Finding, ...]
    certified: bool
    reasons: tuple[str, ...]
    settings: OverclosureSettings
    history: tuple[Step, ...]
    spread: float
    notes: tuple[str, ...]
    losses: tuple[str, ...] = ()
    excluded: tuple[Excluded, ...] = ()
    seconds: float = 0.0
    solve_seconds: float = 0.0

    @property
    def untouched(self) -> bool:
        """Whether nothing had to be moved."""
        return not any(body.moved for body in self.bodies)

    @property
    def certificate(self) -> str:
        """The verdict in words."""
        if not self.certified:
            return "NOT CERTIFIED: " + "; ".join(self.reasons)
        least = min((finding.least for finding in self.after), default=None)
        gap = f"no two {'other ' if self.excluded else ''}bodies are near each other"
        if least is not None:
            gap = f"the smallest gap of a node to a surface is {least if least > 1e-12 else 0.0:.5g}"
        nearer = [finding.surfaces_apart or 0.0 for finding in self.after if finding.edges_nearer]
        if nearer:
            gap += f", of two edges {min(nearer):.3g}"
        further = "further " if any(len(body.inverted_input) for body in self.bodies) else ""
        words = f"CERTIFIED: nothing crosses, nothing is contained, no {further}element was inverted; {gap}"
        if self.excluded:
            deepest = max(pair.depth_after for pair in self.excluded)
            verb = "does" if len(self.excluded) == 1 else "do"
            words += f"; {counted(len(self.excluded), 'excluded pair')} may overlap, "
            words += f"and {verb} by {deepest:.3g} at most" if deepest > 0 else f"and {verb} not"
        return words if not self.untouched else f"{words}; nothing had to be moved"

    def report(self) -> dict[str, Any]:
        """Return everything but meshes and arrays, for JSON."""
        return {
            "certified": self.certified,
            "certificate": self.certificate,
            "reasons": list(self.reasons),
            "pairs": {
                "before": [finding.as_dict() for finding in self.before],
                "after": [finding.as_dict() for finding in self.after],
            },
            "excluded": [dataclasses.asdict(pair) for pair in self.excluded],
            "bodies": [body.report() for body in self.bodies],
            "settings": dataclasses.asdict(self.settings),
            "history": [dataclasses.asdict(step) for step in self.history],
            "iterations": len(self.history),
            "spread": self.spread,
            "warnings": [*self.losses, *self.notes],
            "cpu_seconds": round(self.seconds, 3),
            "solve_cpu_seconds": round(self.solve_seconds, 3),
        }

    def summary(self) -> str:
        """Return the pairs, the bodies and the verdict, for a person."""
        none = f"no two {'other ' if self.excluded else ''}bodies are near"
        lines = ["before:", *(f"  {finding}" for finding in self.before or (none,))]
        if not self.untouched:
            lines += ["after:", *(f"  {finding}" for finding in self.after)]
            lines += ["bodies:", *(f"  {body}" for body in self.bodies)]
        method = METHODS[self.settings.method]
        return "\n".join(
            [
                *lines,
                f"{self.certificate} ({method}, {counted(len(self.history), 'iteration')}, "
                f"{self.solve_seconds:.1f} s of CPU time, {self.seconds:.1f} s with all figures)",
            ]
        )


def result_of(
    solids: Sequence[Solid],
    before: Sequence[Finding],
    after: Sequence[Finding],
    efforts: Sequence[Effort],
    settings: OverclosureSettings,
    history: tuple[Step, ...],
    stop: str,
    through: Mapping[tuple[str, str], str],
    untold: Mapping[tuple[str, str], str],
    passed: Sequence[Passing],
    excluded: Sequence[Excluded],
    progress: Progress,
) -> OverclosureResult:
    """Put the result together; `stop` says why the loop ended early, or is ""; the rest as in `Removal`."""
    jobs: list[Callable[[], Any]] = [partial(notes_of, solids, before, after)]
    jobs += [partial(figures_of, solid, efforts) for solid in solids]
    measured: list[Any] = []
    with contextlib.closing(each(jobs)) as figures:
        for number in range(len(jobs)):
            name = solids[max(number - 1, 0)].name
            progress(number / len(jobs), f"figures of {name}")
            measured.append(next(figures))
    notes, *bodies = measured
    contained = {finding.names: finding for finding in before if finding.state == CONTAINED}
    reasons = [
        _untold(finding, untold[finding.names])
        if finding.names in untold
        else _reason(
            contained.get(finding.names, finding), solids, after, stop, through.get(finding.names, "")
        )
        + ("" if finding.names in through else _sheets(finding, solids))
        for finding in after
        if not finding.clear
    ]
    reasons += [_through(finding) for finding in passed]
    reasons += [
        f"'{body.name}': {counted(len(body.inverted_new), 'element')} inverted (first: "
        f"{int(body.inverted_new[0])})"
        for body in bodies
        if len(body.inverted_new)
    ]
    return OverclosureResult(
        bodies=tuple(bodies),
        before=tuple(before),
        after=tuple(after),
        certified=not reasons,
        reasons=tuple(reasons),
        settings=settings,
        history=history,
        spread=max((effort.widest for effort in efforts), default=0.0),
        notes=(*notes, *afterwards(bodies, solids, excluded, efforts, before)),
        losses=tuple(losses_of(bodies, solids)),
        excluded=tuple(excluded),
    )


def _reason(
    finding: Finding, solids: Sequence[Solid], after: Sequence[Finding], stop: str, sheet: str
) -> str:
    """Say why a pair is not clear; `sheet` is which of the two runs right through the other, or ""."""
    of = {solid.name: solid for solid in solids}
    one, two = of[finding.one], of[finding.two]
    place = ", ".join(f"{x:.4g}" for x in finding.where)
    where = f"'{one.name}' and '{two.name}' at ({place})"
    if finding.state == CONTAINED:
        inner = f"a piece of '{finding.contained}' lies inside the other"
        return f"{where}: {inner}; move it out or exclude the pair"
    if one.share == two.share == 0:
        return f"{where}: both are rigid and {finding.deep}; let one deform or exclude the pair"
    left = f"{finding.deep}, {counted(finding.crossings, 'pair')} of triangles crossing"
    if finding.state == NEAR:
        left = f"{finding.least:.4g} apart where {finding.gap:g} is asked for"
    elif sheet:
        whole = two.name if sheet == one.name else one.name
        remedy = "move it to the side where it belongs, or exclude the pair"
        return f"{where}: {left}; '{sheet}' is open and runs right through '{whole}': {remedy}"
    for body, other in ((one, two), (two, one)):
        rivals = [
            name
            for f in after
            if not f.clear and body.name in f.names
            for name in f.names
            if name not in (body.name, other.name) and of[name].share == 0
        ]
        if rivals and other.share == 0:
            return f"{where}: {left}; '{body.name}' is pinched between rigid '{other.name}' and '{rivals[0]}'"
    if finding.state == NEAR:
        return f"{where}: {left}; the gap may be larger than the room there ({stop or 'stopped'})"
    held = [solid.name for solid in (one, two) if solid.held]
    if held:
        return f"{where}: {left}; elements of '{held[0]}' would be inverted ({stop or 'stopped'})"
    return f"{where}: {left} ({stop or 'stopped'})"


def _untold(finding: Finding, name: str) -> str:
    """Say why a pair was left alone of which the normals of a body that is open say that it overlaps."""
    place = ", ".join(f"{x:.4g}" for x in finding.where)
    return (
        f"'{finding.one}' and '{finding.two}' at ({place}): '{name}' is open and its normals say "
        f"{finding.depth:.4g} deep, where nothing crossed: left alone; close its holes (Fill Holes in "
        "Blender) or exclude the pair"
    )


def _through(finding: Passing) -> str:
    """Say that a pair is clear on the wrong sides."""
    place = ", ".join(f"{x:.4g}" for x in finding.where)
    return (
        f"'{finding.one}' and '{finding.two}' at ({place}): one went through the other, {finding.depth:.4g} "
        "deep on the way: there is too little room; widen the gap in steps, or let others give way"
    )


def _sheets(finding: Finding, solids: Sequence[Solid]) -> str:
    """What else to do where a body of the pair is open: of a sheet, both sides may be outside."""
    mine = [solid for solid in solids if solid.name in finding.names]
    names = [f"'{solid.name}'" for solid in mine if solid.open_edges]
    if not names:
        return ""
    verb = "is" if len(names) == 1 else "are"
    return f"; {' and '.join(names)} {verb} open: give a sheet a thickness (Solidify in Blender)"
