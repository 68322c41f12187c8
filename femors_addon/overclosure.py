# SPDX-License-Identifier: GPL-3.0-or-later
"""Algorithm 2: push bodies that overlap apart, to a least gap, with one smooth field for each pair.

Pairs are found by themselves. In every iteration each pair in turn is looked at as the others have left
it, a GRNN over the vectors of both bodies (the second body's negated) gives its field, and both bodies
take their share of it, inner nodes too. The loop ends on a certificate from a search built anew: gaps,
crossings, containment and elements. See `removal` and `removal_loop` for the story,
`effort` for what is done about a pair, `contact_field` for the field, `overclosure_check` for the measure.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Mapping, Sequence

from .bodies import Body
from .crew import crew
from .limits import Limits
from .mesh import Float
from .overclosure_check import Finding, PairGaps, asked_gaps, find
from .overclosure_notes import notes_of
from .overclosure_result import OverclosureResult
from .overclosure_settings import OverclosureSettings
from .progress import Progress, part, silent
from .removal import Removal
from .removal_input import band_of, nodes_of, solids_of

__all__ = ["Body", "OverclosureResult", "OverclosureSettings", "check_overclosure", "remove_overclosure"]

LARGE = 8000  # nodes of a body, on average, from which two threads are faster than one

Preview = Callable[[Mapping[str, Float]], None]
"""Called with the nodes (n, 3) of each body by name while a removal runs."""


def check_overclosure(
    bodies: Sequence[Body],
    settings: OverclosureSettings | None = None,
    progress: Progress = silent,
    *,
    exclude: Iterable[tuple[str, str]] = (),
    gaps: PairGaps | None = None,
    tell: Callable[[str], None] | None = None,
) -> list[Finding]:
    """Return the pairs of bodies that overlap or are closer than the band, the deepest first.

    Parameters and errors are those of `remove_overclosure`; nothing is moved. `tell` is called with
    each thing that the user should know of the bodies, in words.
    """
    settings = settings or OverclosureSettings()
    with crew(_are_large(bodies)):
        solids = solids_of(bodies, settings)
        asked = asked_gaps(solids, settings.gap, exclude, gaps or {})
        found = find(solids, asked, band_of(solids, settings), progress)
        if tell is not None:
            for note in notes_of(solids, found):
                tell(note)
    return found


def remove_overclosure(
    bodies: Sequence[Body],
    settings: OverclosureSettings | None = None,
    progress: Progress = silent,
    *,
    exclude: Iterable[tuple[str, str]] = (),
    gaps: PairGaps | None = None,
    preview: Preview | None = None,
) -> OverclosureResult:
    """Push bodies apart until none overlaps another and every pair keeps its gap.

    Parameters
    ----------
    bodies : sequence of Body
        At least two, in one unit of length and one frame; the input is left as it is.
    settings : OverclosureSettings, optional
    progress : Progress
        Called with the fraction done and a text; may raise `Cancelled`.
    exclude : iterable of pairs of names
        Bodies that may overlap, such as a cartilage that is tied to its bone.
    gaps : mapping of pairs of names to float
        Gaps of single pairs, in place of the settings'.
    preview : callable, optional
        Called with the bodies' nodes after each iteration.

    Returns
    -------
    OverclosureResult
        Certified, or the best state met and the reason why it is not.

    Raises
    ------
    FemorsError
        Fewer than two bodies, a name twice, a mesh that is no surface, two copies of one surface,
        settings outside their limits, bodies in two units, a gap that is wide for a body; more memory needed
        than is allowed.
    Cancelled
        From `progress`.
    """
    started = time.process_time()
    with crew(_are_large(bodies)):
        removal = Removal(bodies, settings or OverclosureSettings(), exclude, gaps or {}, preview)
        removal.run(part(progress, 0.0, 0.9))
        solved = time.process_time()
        result = removal.result(part(progress, 0.9, 1.0))
    progress(1.0, "done")
    return dataclasses.replace(result, seconds=time.process_time() - started, solve_seconds=solved - started)


def _are_large(bodies: Sequence[Body]) -> bool:
    return Limits.threads > 1 and nodes_of(bodies) >= LARGE * len(bodies)
