# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks of 3D Slicer: point lists as ``.fcsv`` and as ``.mrk.json``.

Slicer's axes are patient axes: LPS (left, posterior, superior) or RAS (right, anterior, superior), which
differ by the signs of x and y. Each file says which it has; points are turned into the axes of the
meshes that they belong to, and back when they are written.
"""

from __future__ import annotations

import copy
import csv
import dataclasses
import json
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from .csvtext import Manner, joined, lines_of
from .files import shown
from .mesh import Float
from .progress import FemorsError

SYSTEMS = {"LPS": "LPS", "1": "LPS", "RAS": "RAS", "0": "RAS"}
"""The older ``.fcsv`` files count the systems; 2 is voxels, which mean nothing without their image."""
FLIP = np.array([-1.0, -1.0, 1.0])
COLUMNS = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"
LABEL = COLUMNS.split(",").index("label")
SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)


def turned(points: Float, system: str, space: str) -> Float:
    """Return points (k, 3) of one system in the other's axes (the way back is the same)."""
    return points if system == space else points * FLIP


def _system(value: object) -> str:
    known = SYSTEMS.get(str(value).strip().upper())
    if known is None:
        raise FemorsError(f"the coordinate system '{shown(str(value).encode())}' is neither LPS nor RAS")
    return known


# --- fcsv -----------------------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True)
class _Fcsv:
    """Lines of the file, and cells of those that are points."""

    lines: tuple[str, ...]
    rows: tuple[tuple[int, tuple[str, ...]], ...]
    system: str
    manner: Manner


def parse_fcsv(data: bytes, space: str) -> tuple[Float, tuple[str, ...], _Fcsv]:
    """Return points (k, 3) in the axes of `space`, labels, and the rest of the file."""
    try:
        lines = lines_of(data.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise FemorsError("is not a text file") from None
    system, label = "RAS", LABEL  # as Slicer had it before it wrote down which
    rows, points, names = [], [], []
    for number, line in enumerate(lines):
        if line.startswith("#"):
            key, _, value = line.lstrip("# ").partition("=")
            if key.strip().lower() == "coordinatesystem":
                system = _system(value)
            if key.strip().lower() == "columns" and "label" in value:
                label = [name.strip() for name in value.split(",")].index("label")
        elif line.strip():
            cells = next(csv.reader([line]))
            point = _numbers(cells[1:4], f"line {number + 1}")
            rows.append((number, tuple(cells)))
            points.append(point)
            names.append(cells[label].strip() if len(cells) > label else "")
    if not rows:
        raise FemorsError("has no landmarks")
    return (
        turned(np.array(points), system, space),
        tuple(names),
        _Fcsv(tuple(lines), tuple(rows), system, Manner.of(data)),
    )


def build_fcsv(points: Float, names: Sequence[str], template: _Fcsv | None, space: str) -> bytes:
    """Write points (k, 3), given in the axes of `space`."""
    if template is None:
        lines = ["# Markups fiducial file version = 4.11", f"# CoordinateSystem = {space}"]
        lines.append(f"# columns = {COLUMNS}")
        rows: list[tuple[int, tuple[str, ...]]] = []
        for number, name in enumerate(names, 1):
            label = re.sub(r"[\r\n]+", " ", name)  # Slicer reads a line as a row
            made: tuple[str, ...] = (str(number), *[""] * 3, *"0001110", label, "", "")
            rows.append((len(lines), made))
            lines.append("")
        template = _Fcsv(tuple(lines), tuple(rows), space, Manner())
    lines = list(template.lines)
    for (number, cells), point in zip(template.rows, turned(points, space, template.system), strict=True):
        lines[number] = joined([cells[0], *(f"{value + 0.0:.10g}" for value in point), *cells[4:]])
    return template.manner.encoded(lines)


# --- mrk.json -------------------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True)
class _Json:
    """The whole document; points in it are known by their order."""

    document: dict[str, Any]
    space: str


def _control_points(document: Any) -> list[tuple[dict[str, Any], str]]:
    """Return the control points that have a position, and the axes that they are in."""
    markups = document.get("markups") if isinstance(document, dict) else None
    if not isinstance(markups, list):
        raise FemorsError("has no list 'markups'; is it a file of 3D Slicer's markups?")
    out = []
    for markup in markups:
        if not isinstance(markup, dict) or not isinstance(markup.get("controlPoints", []), list):
            raise FemorsError("has a markup without a list of control points")
        system = _system(markup.get("coordinateSystem", "LPS"))
        for point in markup.get("controlPoints", []):
            if not isinstance(point, dict):
                raise FemorsError("has a control point that is none")
            if point.get("positionStatus", "defined") == "defined":
                out.append((point, system))
    return out


def parse_json(data: bytes, space: str) -> tuple[Float, tuple[str, ...], _Json]:
    """Return points (k, 3) in the axes of `space`, labels, and the rest of the file."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        raise FemorsError("is not a JSON file") from None
    found = _control_points(document)
    if not found:
        raise FemorsError("has no landmarks: no control point has a position")
    points, names = [], []
    for number, (point, system) in enumerate(found, 1):
        position = _numbers(point.get("position"), f"control point {number}")
        points.append(turned(np.array(position), system, space))
        names.append(str(point.get("label", "")).strip())
    return np.array(points), tuple(names), _Json(document, space)


def build_json(points: Float, names: Sequence[str], template: _Json | None, space: str) -> bytes:
    """Write points (k, 3), given in the axes of `space`; what else the template has stays."""
    document = _document(names, space) if template is None else copy.deepcopy(template.document)
    for (point, system), position in zip(_control_points(document), points, strict=True):
        point["position"] = [float(f"{value + 0.0:.10g}") for value in turned(position, space, system)]
    return (json.dumps(document, indent=4) + "\n").encode()


def _document(names: Sequence[str], space: str) -> dict[str, Any]:
    control = [
        {
            "id": str(number),
            "label": name,
            "position": [0.0, 0.0, 0.0],
            "orientation": [-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0],
            "selected": True,
            "locked": False,
            "visibility": True,
            "positionStatus": "defined",
        }
        for number, name in enumerate(names, 1)
    ]
    markup = {
        "type": "Fiducial",
        "coordinateSystem": space,
        "coordinateUnits": "mm",
        "locked": False,
        "labelFormat": "%N-%d",
        "controlPoints": control,
    }
    return {"@schema": SCHEMA, "markups": [markup]}


def _numbers(values: Any, where: str) -> list[float]:
    """Return three finite numbers."""
    try:
        if isinstance(values, list) and len(values) == 3:
            out = [float(value) for value in values]
            if np.isfinite(out).all():
                return out
    except (TypeError, ValueError, OverflowError):
        pass
    raise FemorsError(f"{where}: three finite numbers are needed as its position")
