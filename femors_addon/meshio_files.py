# SPDX-License-Identifier: GPL-3.0-or-later
"""VTK, VTU, Gmsh and other meshes through meshio, where it is installed.

Node and cell data are kept. A file whose nodes have not moved stays as it is, byte for byte; otherwise
it is written by meshio, with coordinates in double precision.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import importlib
import io
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from .deck import Deck, Load, OneFile, Part
from .elements import MESHIO_KINDS, MESHIO_NAMES
from .files import read_bytes, require_finite, shown
from .gmsh_nodes import NodePlaces, node_places, without_data
from .mesh import Float, Int
from .progress import FemorsError
from .volume import Block, VolumeMesh
from .vtk_poly import called

PACKAGE = "meshio==5.3.5"
FORMATS = {".vtk": "vtk", ".vtu": "vtu", ".msh": "gmsh", ".mesh": "medit"}
"""meshio's module for each ending; all of them do without h5py, netCDF4 and lxml."""
MEDIT_KINDS = ("tet4", "pyra5", "penta6", "hex8", "tri3", "quad4")
"""Those that meshio writes to Medit's files; it leaves out all others without an error."""
LEAST_COUNT = 1_000_000  # loops over so many lines, of a file that has fewer, do no harm
_COUNT = re.compile(rb"^[ \t]*([0-9]{7,4000})[ \t\r]*$", re.MULTILINE)
PART_DATA = ("gmsh:physical", "medit:ref", "part", "gmsh:geometrical")


@dataclasses.dataclass(frozen=True, eq=False)
class Template(OneFile):
    """A file and what meshio read from it; `nodes` (n, 3) as read, `places` where they stand, if known."""

    path: Path
    data: bytes
    content: Any
    nodes: Float
    places: NodePlaces | None = None

    def encoded(self, nodes: Float) -> bytes:
        """Return the file's bytes, or what meshio writes where nodes have moved."""
        if np.array_equal(nodes, self.nodes):
            return self.data
        if self.places is not None:
            return self.places.moved(self.data, nodes)
        return self.converted(nodes, self.path.suffix.lower(), self.data)

    def converted(self, nodes: Float, suffix: str, like: bytes = b"") -> bytes:
        """Return what meshio writes, in the variant of `like`."""
        content = copy.copy(self.content)
        # sets may be turned into data on the way
        for name in ("point_data", "cell_data", "point_sets", "cell_sets"):
            setattr(content, name, dict(getattr(content, name) or {}))
        content.points = np.array(nodes)
        return _written(content, suffix, like)


def read(path: Path, load: Load = read_bytes) -> Deck:
    """Read a mesh; arguments and errors as for `inp.read`."""
    suffix = path.suffix.lower()
    data = load(path)
    content, notes = _parsed(path, data)
    points = np.asarray(content.points, dtype=np.float64)
    if points.ndim != 2 or not len(points) or points.shape[1] not in (2, 3):
        raise FemorsError(f"{path}: has no nodes with three coordinates")
    nodes = np.zeros((len(points), 3))
    nodes[:, : points.shape[1]] = points
    places = node_places(data) if suffix == ".msh" else None
    if places is not None and not np.array_equal(places.positions, nodes, equal_nan=True):
        places = None
    given = content.point_data.get("node_id") if places is None else places.ids
    ids = _ids(given, len(nodes))
    try:
        from_zero = suffix in (".vtk", ".vtu") and given is None
        require_finite(nodes, "nodes", called if from_zero else lambda index: f"node {ids[index]}")
        blocks, where = _blocks(content)
        mesh = VolumeMesh(
            nodes,
            tuple(blocks),
            ids,
            _node_sets(content, len(nodes)),
            _element_sets(content, where),
        )
    except FemorsError as error:
        raise FemorsError(f"{path}: {error}") from None
    if not mesh.element_count:
        raise FemorsError(f"{path}: has no elements with a surface (solids or shells)")
    parts = {
        name: Part(name, mesh.restricted(members)[1], members)
        for name, members in _parts(content, where, path.stem).items()
    }
    if suffix == ".msh" and places is None:
        notes.append("where nodes move, Gmsh's own numbers and data are not kept")
    template = Template(path, data, content, mesh.nodes, places)
    return Deck(path, suffix, mesh, parts, template, (), tuple(notes))


# --- meshio ---------------------------------------------------------------------------------------
def _module(suffix: str) -> ModuleType:
    """Return meshio's module of a format; meshio then has the dimensions of all kinds of elements.

    5.3.5 knows names, sizes and orders of `wedge15` and `pyramid13`, but not that they are solids, without
    which it neither reads nor writes them.
    """
    try:
        module = importlib.import_module(f"meshio.{FORMATS[suffix]}")
        dimensions = importlib.import_module("meshio._mesh").topological_dimension
    except (ImportError, AttributeError) as error:
        raise FemorsError(
            f"{suffix} files need the Python package meshio, which is not installed here "
            f"({error}); pip install {PACKAGE}"
        ) from None
    for name, kind in MESHIO_KINDS.items():
        dimensions.setdefault(name, 3 if kind.solid else 2)
    return module


@contextlib.contextmanager
def _quietly() -> Iterator[io.StringIO]:
    """Keep what meshio prints off the terminal."""
    said = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        yield said


def _parsed(path: Path, data: bytes) -> tuple[Any, list[str]]:
    """Return meshio's mesh, and what it had to say."""
    suffix = path.suffix.lower()
    module = _module(suffix)
    _check(path, data, suffix)
    with tempfile.TemporaryDirectory() as folder, _quietly() as said:
        copied = Path(folder) / f"mesh{suffix}"
        copied.write_bytes(without_data(data) if suffix == ".msh" else data)
        try:
            content = module.read(str(copied))
        except MemoryError:
            raise FemorsError(f"{path}: needs more memory than there is, or a count in it is wrong") from None
        # a malformed file makes meshio fail in as many ways as Python has
        except (Exception, SystemExit) as error:
            reason = " ".join(str(error).replace(str(copied), path.name).split())
            reason = f"{type(error).__name__}: {reason}" if reason else type(error).__name__
            what = f"is not a {FORMATS[suffix]} file that can be read"
            raise FemorsError(f"{path}: {what} ({shown(reason.encode(), 120)})") from None
    return content, [f"meshio: {line.strip()}" for line in said.getvalue().splitlines() if line.strip()][:3]


def _check(path: Path, data: bytes, suffix: str) -> None:
    """Refuse what meshio would stumble over, or never come back from."""
    expected = {".vtk": b"# vtk", ".vtu": b"<", ".msh": b"$"}.get(suffix, b"")
    start = data.removeprefix(b"\xef\xbb\xbf").lstrip()
    if not start.startswith(expected):
        found = shown(start.partition(b"\n")[0])
        raise FemorsError(f"{path}: line 1: '{expected.decode()}' was expected, not '{found}'")
    if suffix == ".vtu" and (b"<!DOCTYPE" in data or b"<!ENTITY" in data):
        raise FemorsError(f"{path}: has a DOCTYPE, which no VTU file needs; remove it")
    dataset = re.search(rb"^DATASET[ \t]+([A-Z_]+)", data[:10_000], re.MULTILINE | re.IGNORECASE)
    if suffix == ".vtk" and dataset is not None and dataset[1].upper() != b"UNSTRUCTURED_GRID":
        raise FemorsError(f"{path}: is a {dataset[1].decode()} dataset; an UNSTRUCTURED_GRID is needed")
    for count in _COUNT.findall(data if suffix == ".mesh" else b""):
        if int(count) > max(len(data), LEAST_COUNT):
            raise FemorsError(f"{path}: announces {int(count)} items, more than it has bytes")


def _written(content: Any, suffix: str, like: bytes = b"") -> bytes:
    """Return what meshio makes of a mesh, in the variant (text or binary, version) of `like`."""
    module = _module(suffix)
    options: list[dict[str, Any]] = [{}]
    if suffix == ".vtk":
        options = [{"binary": b"ASCII" not in b"".join(like.split(b"\n", 3)[2:3]).upper()}]
    elif suffix == ".msh":
        head = like.split(b"\n", 2)[1:2] or [b"2.2 0 8"]
        version, kind = (head[0].split() + [b"", b""])[:2]
        new = {"fmt_version": "4.1" if version.startswith(b"4") else "2.2", "binary": kind == b"1"}
        options = [new, {"fmt_version": "2.2", "binary": kind == b"1"}]
    problem: BaseException | None = None
    for option in options:
        with tempfile.TemporaryDirectory() as folder, _quietly():
            new_path = Path(folder) / f"mesh{suffix}"
            try:
                module.write(str(new_path), content, **option)
                return new_path.read_bytes()
            except (MemoryError, OSError):
                raise
            except (Exception, SystemExit) as error:  # whatever the format cannot hold
                problem = error
    raise FemorsError(f"this mesh cannot be written as {suffix} ({type(problem).__name__}: {problem})")


# --- content --------------------------------------------------------------------------------------
def _blocks(content: Any) -> tuple[list[Block], dict[int, tuple[int, int]]]:
    """Return the blocks, and for meshio's number of each where its elements start and stop among ours."""
    blocks, where, start, count = [], {}, 0, 0
    numbers = content.cell_data.get("element_id")
    for index, cells in enumerate(content.cells):
        kind = MESHIO_KINDS.get(cells.type)
        if kind is not None and len(cells.data):
            data = np.asarray(cells.data)
            if data.ndim != 2 or data.shape[1] != kind.size or data.dtype.kind not in "iu":
                raise FemorsError(f"cells of type {cells.type} need {kind.size} nodes each")
            if data.min() < 0 or data.max() >= len(content.points):
                raise FemorsError(
                    f"a cell names node {data.max()} (from 0), the file has {len(content.points)}"
                )
            given = None if numbers is None or index >= len(numbers) else numbers[index]
            ids = _ids(given, len(data), count)
            blocks.append(Block(kind.name, data, ids, cells.type))
            where[index] = (start, start + len(data))
            start += len(data)
        count += len(cells.data)
    return blocks, where


def _ids(given: Any, count: int, start: int = 0) -> np.ndarray:
    """Return the ids that a file brings along, or numbers from `start` + 1."""
    ids = np.asarray(given).ravel() if given is not None else np.zeros(0)
    if len(ids) == count and ids.dtype.kind in "iu" and len(np.unique(ids)) == count:
        return ids.astype(np.int64)
    return np.arange(start + 1, start + count + 1)


def _node_sets(content: Any, count: int) -> dict[str, Int]:
    out = {}
    for name, members in (content.point_sets or {}).items():
        index = np.unique(np.asarray(members, dtype=np.int64))
        out[str(name)] = index[(index >= 0) & (index < count)].astype(np.int32)
    return out


def _element_sets(content: Any, where: dict[int, tuple[int, int]]) -> dict[str, Int]:
    out = {}
    for name, per_block in (content.cell_sets or {}).items():
        if name == "gmsh:bounding_entities":
            continue
        members = [np.zeros(0, np.int64)]
        for index, some in enumerate(per_block):
            if index in where and some is not None and len(some):
                start, stop = where[index]
                mine = np.asarray(some, dtype=np.int64) + start
                members.append(mine[(mine >= start) & (mine < stop)])
        out[str(name)] = np.unique(np.concatenate(members)).astype(np.int32)
    return {name: members for name, members in out.items() if len(members)}


def _parts(content: Any, where: dict[int, tuple[int, int]], stem: str) -> dict[str, Int]:
    """Return the elements of each part: by the first cell data that number parts, else all of them."""
    total = max(stop for _, stop in where.values())
    for key in PART_DATA:
        arrays = content.cell_data.get(key)
        if arrays is None or any(index >= len(arrays) for index in where):
            continue
        tags = np.concatenate([np.asarray(arrays[index]).ravel() for index in where])
        if len(tags) != total or tags.dtype.kind not in "iu":
            continue
        names = {}
        for name, value in (content.field_data or {}).items():
            if key == "gmsh:physical" and len(np.ravel(value)) == 2:
                names[int(np.ravel(value)[0])] = str(name)
        found = np.unique(tags)
        if len(found) == 1 and int(found[0]) not in names:
            break
        return {
            names.get(int(tag), f"{stem} {tag}"): np.flatnonzero(tags == tag).astype(np.int32)
            for tag in found
        }
    return {stem: np.arange(total, dtype=np.int32)}


# --- from scratch ---------------------------------------------------------------------------------
def fresh(mesh: VolumeMesh, parts: dict[str, Int], suffix: str) -> bytes:
    """Return a file with the nodes and elements, the part of each element by number, and the ids.

    Gmsh also takes the parts' names; Gmsh and Medit number nodes and elements afresh.

    Raises
    ------
    FemorsError
        Kinds of elements that the format cannot hold.
    """
    beyond = sorted({block.kind for block in mesh.blocks} - set(MEDIT_KINDS)) if suffix == ".mesh" else []
    if beyond:
        raise FemorsError(
            f"{suffix} files hold no elements like {', '.join(beyond)}; write .vtu or .msh instead"
        )
    _module(suffix)
    meshio = importlib.import_module("meshio")
    number = np.zeros(mesh.element_count, np.int64)
    for index, elements in enumerate(parts.values()):
        number[elements] = index + 1
    starts = mesh.starts[1:-1]
    cells = [(MESHIO_NAMES[block.kind], block.nodes.astype(np.int64)) for block in mesh.blocks]
    by_block = [np.array(some) for some in np.split(number, starts)]
    names: dict[str, Any] = {}
    points: dict[str, Any] = {}
    data: dict[str, Any] = {}
    form = FORMATS[suffix]
    if form == "gmsh":
        data = {"gmsh:physical": by_block, "gmsh:geometrical": by_block}
        dimension = 3 if mesh.solid else 2
        names = {name: np.array([index + 1, dimension]) for index, name in enumerate(parts)}
    elif form == "medit":
        data = {"medit:ref": by_block}
    elif form in ("vtk", "vtu"):
        points = {"node_id": np.array(mesh.node_ids)}
        data = {"element_id": [np.array(block.ids) for block in mesh.blocks], "part": by_block}
    content = meshio.Mesh(np.array(mesh.nodes), cells, points, data, names)
    return _written(content, suffix)
