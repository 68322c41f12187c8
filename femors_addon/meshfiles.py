# SPDX-License-Identifier: GPL-3.0-or-later
"""Surface meshes in and out of files: STL, PLY and OBJ, with everything else in them kept."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import obj, ply, stl
from .files import Location, check_no_folder, read_bytes, require_finite, write_bytes
from .mesh import Float, Int, Surface, frozen, triangulate
from .progress import FemorsError

FORMATS: dict[str, Any] = {".stl": stl, ".ply": ply, ".obj": obj}
"""Each module has ``parse(data) -> vertices, sizes, corners, template``, ``build(the same) -> data``, and
``called(index) -> str``: what the file calls a vertex."""


@dataclasses.dataclass(frozen=True, eq=False)
class MeshFile:
    """A polygon mesh, and the rest of the file that it was read from.

    Attributes
    ----------
    vertices : (n, 3) float64
        In file order. Every triangle of an STL file brings three of its own.
    sizes : (p,) int32
        Number of corners of each polygon.
    corners : (sum(sizes),) int32
        The polygons' vertices, one polygon after the other.
    suffix : str
        ".stl", ".ply" or ".obj": the format that `template` belongs to; "" for a mesh from elsewhere.
    template : object
        What else was in the file, for writing the same format again.
    """

    vertices: Float
    sizes: Int
    corners: Int
    suffix: str = ""
    template: Any = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", frozen(self.vertices, np.float64, 3))
        for name in ("sizes", "corners"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.int32, 1)[:, 0])

    @classmethod
    def of(cls, surface: Surface) -> MeshFile:
        """Return a surface as something that can be written."""
        return cls(surface.vertices, np.full(len(surface.faces), 3), surface.faces)

    def surface(self) -> Surface:
        """Return the polygons as triangles over the same vertices."""
        return Surface(self.vertices, triangulate(self.sizes, self.corners)[0])

    def with_vertices(self, vertices: ArrayLike) -> MeshFile:
        """Return the same mesh at other positions (n, 3)."""
        positions = np.asarray(vertices, dtype=np.float64)
        if positions.shape != self.vertices.shape:
            raise ValueError(f"positions of shape {positions.shape}, the mesh has {self.vertices.shape}")
        return dataclasses.replace(self, vertices=positions)


def read(path: Location) -> MeshFile:
    """Read an STL (binary or ASCII), PLY (ASCII or binary) or OBJ file.

    Raises
    ------
    FemorsError
        One line that names the file and says what is wrong with it.
    """
    suffix = check_suffix(path)
    data = read_bytes(path)
    try:
        vertices, sizes, corners, template = FORMATS[suffix].parse(data)
        require_finite(vertices, "vertices", FORMATS[suffix].called)
    except FemorsError as error:
        raise FemorsError(f"{path}: {error}") from None
    return MeshFile(vertices, sizes, corners, suffix, template)


def write(path: Location, mesh: MeshFile) -> None:
    """Write a mesh, whole or not at all; the path's ending says in which format.

    A mesh that was read from the same format keeps its variant and all else that was in its file;
    any other becomes a binary STL (of triangles), a binary PLY or an OBJ with its polygons.
    """
    write_bytes(path, encoded(path, mesh))


def encoded(path: Location, mesh: MeshFile) -> bytes:
    """Return the bytes that `write` would write."""
    suffix = check_suffix(path)
    template = mesh.template if mesh.suffix == suffix else None
    try:
        return FORMATS[suffix].build(mesh.vertices, mesh.sizes, mesh.corners, template)
    except FemorsError as error:
        raise FemorsError(f"{path}: {error}") from None


def check_suffix(path: Location) -> str:
    """Return the path's ending in lower case; raise `FemorsError` where it is no known format."""
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        check_no_folder(path)
        what = f"'{suffix}' is not a known kind of mesh file" if suffix else "the name has no ending"
        raise FemorsError(f"{path}: {what}; use {', '.join(FORMATS)}")
    return suffix
