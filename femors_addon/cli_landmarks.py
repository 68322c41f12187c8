# SPDX-License-Identifier: GPL-3.0-or-later
"""``femors landmarks``: templates morphed onto a target, and their landmarks carried along."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from . import cli_convert, deckfiles, files, landmarkfiles, landmarks
from .carry import Carrier
from .cleaning import clean
from .cli_transfer import REPORT, TABLE, table_of, write_all
from .commandline import Console, add_settings, check_paths, settings_of
from .landmarkfiles import Landmarks
from .mesh import Surface
from .morph import morph
from .morph_settings import PRESETS, MorphSettings
from .nearest import SurfaceIndex
from .progress import FemorsError, Progress, counted, part
from .report_files import check_ending, report_bytes
from .report_transfer import landmark_rows, landmarks_of, transfer_figures
from .transfer import Transfer
from .transfer_settings import AxesSettings, TransferSettings
from .version import version


def options(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``femors landmarks``."""
    parser.add_argument(
        "inputs",
        metavar="TEMPLATE TARGET TEMPLATE.csv",
        nargs="+",
        help=f"a mesh, the mesh to find the landmarks on, and those of the first ({landmarkfiles.MARKS}); "
        "or TARGET alone, with --template",
    )
    parser.add_argument("-o", "--out", metavar="OUT.csv", required=True, help="the landmarks on TARGET")
    parser.add_argument(
        *("--template", "-t"),
        metavar=("MESH", "CSV"),
        nargs=2,
        action="append",
        default=[],
        help="one more template; the median of all their predictions is taken, landmark by name",
    )
    parser.add_argument(
        "--known",
        metavar="K.csv",
        help="landmarks known on TARGET: templates are aligned by those of equal names, three or more, and "
        "with --steer also pulled onto them",
    )
    parser.add_argument("--project", action="store_true", help="lay the landmarks onto TARGET's surface")
    parser.add_argument("--table", metavar="T.csv", help=TABLE)
    parser.add_argument("--report", metavar="R", help=REPORT)
    add_settings(parser, MorphSettings, {"alignment": "--align"})
    add_settings(parser, AxesSettings, {})


def run(args: argparse.Namespace, console: Console) -> int:
    """Morph every template onto the target and carry its landmarks; write the median."""
    settings = settings_of(args, PRESETS[getattr(args, "setting_preset", "standard")])
    space = settings_of(args, AxesSettings()).space
    target, templates = _named_inputs(args)
    others = [path for path in (args.table, args.report) if path is not None]
    known = [args.known] if args.known is not None else []
    inputs = [target, *known, *(path for template in templates for path in template)]
    check_paths(inputs, [args.out, *others])
    landmarkfiles.ending_of(args.out)
    if args.report is not None:
        check_ending(args.report)
    files.check_writable(args.out, *others)
    marks = [landmarkfiles.read(csv, space) for _, csv in templates]
    steer = landmarkfiles.read(args.known, space) if known else None
    _check_alike(templates, marks)
    _check_different(templates)
    aim = _whole_surface(target)
    sources = [_whole_surface(mesh) for mesh, _ in templates]
    found: list[_Found] = []
    notes: list[str] = []
    faults: list[str] = []
    for number, (source, mark) in enumerate(zip(sources, marks, strict=True)):
        step = part(console.progress, number / len(sources), (number + 1) / len(sources))
        name, csv = templates[number]
        try:
            one = _predicted(source, aim, mark, settings, steer, args.project, step)
        except FemorsError as error:
            raise FemorsError(_with_file(str(error), name, target, len(sources) > 1)) from None
        found.append(one)
        notes += [_with_file(note, name, target) for note in one.notes]
        faults += [f"{csv}: {fault}" for fault in one.units] + [f"{name}: {fault}" for fault in one.faults]
    console.end_progress()
    median, missing = landmarks.median_of([one.prediction for one in found])
    faults += median.disagreeing(found[0].size)
    if args.project and len(found) > 1:
        median = _laid_on(median, aim)
    whole = marks[0] if median.names == marks[0].labels else Landmarks(median.points, median.names)
    data = {Path(args.out): landmarkfiles.encoded(args.out, whole.with_points(median.points))}
    if args.table is not None:
        data[Path(args.table)] = table_of([median])
    if args.report is not None:
        report = {
            **_report(args, settings, templates, found),
            "notes": [*missing, *notes],
            "faults": faults,
        }
        data[Path(args.report)] = _encoded(args.report, report, median, sources[0], aim, found[0].size)
    write_all(data)
    console.written = True
    console.say(median.table())
    for note in [*missing, *notes] if not args.quiet else []:
        console.warn(f"note: {note}")
    for fault in faults:
        console.warn(f"{fault}; the result is written")
    return 1 if faults else 0


def _with_file(text: str, template: str, target: str, always: bool = True) -> str:
    """Name the file in a sentence of the core about the "source" or the "target"."""
    for role, path in (("source: ", template), ("target: ", target)):
        if text.startswith(role):
            return f"{path}: {text.removeprefix(role)}"
    return f"{template}: {text}" if always else text


class _Found(NamedTuple):
    prediction: landmarks.Prediction
    notes: list[str]
    units: list[str]  # faults of the landmarks themselves
    faults: list[str]
    verdict: str
    fit: dict[str, float]
    size: float


def _predicted(
    source: Surface,
    aim: Surface,
    marks: Landmarks,
    settings: MorphSettings,
    steer: Landmarks | None,
    project: bool,
    progress: Progress,
) -> _Found:
    """Morph one template and carry its landmarks."""
    pairs = {} if steer is None else _steering(marks, steer)
    result = morph(source, aim, settings, part(progress, 0.0, 0.9), **pairs)
    carrier = Carrier(result.kept())
    transfer = Transfer(carrier, TransferSettings(), aim if project else None, own=True)
    moved = transfer.points(marks.points, part(progress, 0.9, 1.0))
    prediction = landmarks.predicted(carrier, marks.labels, marks.points, moved.points, moved.projected)
    units = dataclasses.replace(transfer.unit, name="template").of_landmarks(marks.points)
    # where they are in another unit that explains all else that is odd of them
    far = [] if units else landmarks.far_ones(marks.labels, moved.distance, carrier.size)
    notes, faults = [*result.warnings, *far], [*([] if units else moved.faults), *result.faults]
    faults += [] if units else prediction.unseen(carrier.size)
    if result.steering is not None:
        notes.append(result.steering.sentence())
        faults += result.steering.faults
    notes = [note for note in notes if note not in faults]
    faults += [] if result.converged else [result.stop_reason]
    fit = result.after.target_to_surface.as_dict()
    return _Found(prediction, notes, units, faults, result.stop_reason, fit, carrier.size)


def _report(
    args: argparse.Namespace,
    settings: MorphSettings,
    templates: Sequence[tuple[str, str]],
    found: Sequence[_Found],
) -> dict[str, Any]:
    """Return what is said of a prediction, but for the landmarks themselves."""
    fits = [
        {"template": mesh, "landmarks": csv, "fit, target to template": one.fit, "verdict": one.verdict}
        for (mesh, csv), one in zip(templates, found, strict=True)
    ]
    return {
        "femors": version(),
        "kind": "landmarks",
        "distance_before": "from the template's surface, aligned; negative inside",
        "distance_after": "from the target's surface; negative inside",
        "files": {"target": args.inputs[1] if len(args.inputs) == 3 else args.inputs[0], "out": args.out},
        "templates": fits,
        "settings": dataclasses.asdict(settings),
    }


def _encoded(
    path: str,
    report: dict[str, Any],
    median: landmarks.Prediction,
    source: Surface,
    aim: Surface,
    size: float,
) -> bytes:
    """Return the report in its format, with the landmarks before (on the first template) and after."""
    carried = landmarks_of(median, aim)
    report = {"landmarks": landmark_rows(carried, size, median), **report}
    title = f"Landmarks on {Path(report['files']['target']).name}"
    return report_bytes(path, report, title, lambda: transfer_figures(source, aim, [carried]))


def _steering(marks: Landmarks, known: Landmarks) -> dict[str, Any]:
    """Return the pairs of equal names, as arguments of `morph`."""
    names = [name for name in marks.labels if name in known.labels]
    if len(names) < 3:
        raise FemorsError(
            f"--known shares {counted(len(names), 'name')} with the template; at least 3 are needed"
        )
    return {
        "source_landmarks": marks.named(names),
        "target_landmarks": known.named(names),
        "landmark_names": names,
    }


def _laid_on(median: landmarks.Prediction, aim: Surface) -> landmarks.Prediction:
    """The median of points of a surface is near it, not on it."""
    place = SurfaceIndex(clean(aim.vertices, aim.faces, "target").surface).closest(median.points)
    return dataclasses.replace(median, points=place.point, projected=median.projected + place.distance)


def _named_inputs(args: argparse.Namespace) -> tuple[str, list[tuple[str, str]]]:
    """Return the target, and the templates as (mesh, landmarks)."""
    given = args.inputs
    templates = [(mesh, marks) for mesh, marks in args.template]
    if len(given) == 3:
        return given[1], [(given[0], given[2]), *templates]
    if len(given) == 1 and templates:
        return given[0], templates
    raise FemorsError(
        f"{counted(len(given), 'file is', 'files are')} given; 'TEMPLATE TARGET TEMPLATE.csv' are needed, "
        "or TARGET alone with one --template MESH CSV or more"
    )


def _check_alike(templates: Sequence[tuple[str, str]], marks: Sequence[Landmarks]) -> None:
    """Landmarks without names go by their order: every file must then have as many."""
    if len({bool(one.names) for one in marks}) > 1:
        raise FemorsError("some landmark files have names and some have none; give all of them names")
    counts = {len(one.points) for one in marks}
    if not marks[0].names and len(counts) > 1:
        listed = ", ".join(
            f"{path}: {len(one.points)}" for (_, path), one in zip(templates, marks, strict=True)
        )
        raise FemorsError(f"landmarks without names must be as many in every file ({listed})")


def _check_different(templates: Sequence[tuple[str, str]]) -> None:
    """The same template twice would agree with itself, and its spread say nothing."""
    seen: dict[tuple[bytes, bytes], str] = {}
    for mesh, csv in templates:
        content = (files.read_bytes(mesh), files.read_bytes(csv))
        if content in seen:
            raise FemorsError(f"{mesh}: the same template as '{seen[content]}'; name each one once")
        seen[content] = mesh


def _whole_surface(path: str) -> Surface:
    thing = deckfiles.read(path)
    return cli_convert.placed(
        cli_convert.placement_of(thing, None, "--part"), cli_convert.surface_of(thing, None, "--part")
    )
