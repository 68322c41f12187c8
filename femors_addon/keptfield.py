# SPDX-License-Identifier: GPL-3.0-or-later
"""The field of a morph as a thing one keeps: self-contained arrays, in a file or in a .blend.

The layout is described in docs/landmarks.md; it holds all that `carry.Carrier` needs, and no more.
"""

from __future__ import annotations

import dataclasses
import io
import json
import zlib
from pathlib import Path
from typing import IO, Any
from zipfile import BadZipFile

import numpy as np

from .files import Location, check_no_folder, read_bytes, write_bytes
from .mesh import Float, Int, Surface, frozen
from .progress import FemorsError
from .transforms import inverse, transformed

ENDING = ".npz"
LAYOUT = 2
"""Of the file. 1 had no faces, residual, names, date and figures; it is still read."""


@dataclasses.dataclass(frozen=True, eq=False)
class KeptField:
    """An alignment and the displacement of a surface after it.

    Attributes
    ----------
    transform : (4, 4) float64
        The alignment: source coordinates to aligned coordinates, for column vectors.
    centres : (n, 3) float64
        The source's vertices where the alignment has put them: merged, used by a face.
    displacements : (n, 3) float64
        From there to where the morph has put them.
    faces : (m, 3) int32
        Triangles over the centres, outward; none in a file of layout 1.
    residual : (n,) float64
        How far morphed surface and target are apart around each vertex, at most; NaN where not known.
    spread : float
        Of the weighted mean near the surface, > 0, in the target's unit of length.
    source, target : str
        What the two were called.
    date : str
        When it was made: ISO 8601, to the second; "" where not known.
    figures : dict
        For people: plain numbers, texts and lists by name, as JSON has them.

    Raises
    ------
    FemorsError
        Arrays that do not fit each other, or are not finite.
    """

    transform: Float
    centres: Float
    displacements: Float
    faces: Int
    residual: Float
    spread: float
    source: str = ""
    target: str = ""
    date: str = ""
    figures: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, kind, columns in (
            ("transform", np.float64, 4),
            ("centres", np.float64, 3),
            ("displacements", np.float64, 3),
            ("faces", np.int32, 3),
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), kind, columns))
        object.__setattr__(self, "residual", frozen(self.residual, np.float64, 1)[:, 0])
        object.__setattr__(self, "spread", float(self.spread))
        count = len(self.centres)
        if self.transform.shape != (4, 4) or not np.isfinite(self.transform).all():
            raise FemorsError("the field's transform is not a finite 4 x 4 matrix")
        if not np.array_equal(self.transform[3], [0.0, 0.0, 0.0, 1.0]):
            raise FemorsError("the field's transform is not affine: its last row is not 0 0 0 1")
        if abs(np.linalg.det(self.transform[:3, :3])) < 1e-30:
            raise FemorsError("the field's transform flattens space")
        if count < 1 or len(self.displacements) != count or len(self.residual) != count:
            raise FemorsError("the field's centres, displacements and residuals are not as many")
        if not (np.isfinite(self.centres).all() and np.isfinite(self.displacements).all()):
            raise FemorsError("the field has values that are not finite")
        if not (np.isfinite(self.spread) and self.spread > 0):
            raise FemorsError(f"the field's spread must be a positive length, not {self.spread}")
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < count:
            raise FemorsError("the field's faces name centres that are not there")

    @property
    def name(self) -> str:
        """Named after the pair."""
        return f"{self.source or 'source'} to {self.target or 'target'}"

    @property
    def aligned(self) -> Surface:
        """The source's surface after the alignment."""
        return Surface(self.centres, self.faces)

    @property
    def morphed(self) -> Surface:
        """The source's surface where the morph has put it."""
        return Surface(self.centres + self.displacements, self.faces)

    @property
    def origin(self) -> Surface:
        """The source's surface in its own coordinates; inward where the alignment mirrors it."""
        return Surface(transformed(inverse(self.transform), self.centres), self.faces)

    def placed(self, matrix: Float) -> KeptField:
        """Return the field in other coordinates of both spaces, which a rigid (4, 4) matrix leads to."""
        if np.array_equal(matrix, np.eye(4)):
            return self
        return dataclasses.replace(
            self,
            transform=matrix @ self.transform @ inverse(matrix),
            centres=transformed(matrix, self.centres),
            displacements=self.displacements @ matrix[:3, :3].T,
        )

    # --- files --------------------------------------------------------------------------------
    def encoded(self) -> bytes:
        """Return the field as the bytes of an ``.npz`` file; equal fields give equal bytes."""
        out = io.BytesIO()
        np.savez_compressed(
            out,
            layout=np.array(LAYOUT),
            transform=self.transform,
            centres=self.centres,
            displacements=self.displacements,
            faces=self.faces,
            residual=self.residual,
            spread=np.array(self.spread),
            source=np.array(self.source),
            target=np.array(self.target),
            date=np.array(self.date),
            figures=np.array(json.dumps(self.figures, allow_nan=False)),
        )
        return out.getvalue()

    def save(self, path: Location) -> None:
        """Write the field as an ``.npz`` file, whole or not at all."""
        write_bytes(path, self.encoded())


def check_ending(path: Location) -> None:
    """Raise `FemorsError` where a field's file would have another ending: before a long computation."""
    if Path(path).suffix.lower() != ENDING:
        check_no_folder(path)
        raise FemorsError(f"{path}: a field's file ends in {ENDING}")


def load(path: Location) -> KeptField:
    """Read a field's file.

    Raises
    ------
    FemorsError
        Missing, not such a file, cut short, or of a newer layout.
    """
    return decoded(read_bytes(path), str(path))


def decoded(data: bytes, name: str) -> KeptField:
    """Return the field that the bytes of a file hold; `name` is what messages call it."""
    try:
        arrays = _arrays(io.BytesIO(data))
        layout = int(arrays["layout"])
        if layout > LAYOUT:
            raise FemorsError(
                f"was written by a newer FEMORS (layout {layout}, this one knows {LAYOUT}): update FEMORS"
            )
        if layout < 1:
            raise FemorsError(f"is not a field file (layout {layout})")
        if "faces" in arrays and not np.issubdtype(arrays["faces"].dtype, np.integer):
            raise FemorsError("the field's faces are not whole numbers")
        count = len(arrays["centres"])
        return KeptField(
            transform=arrays["transform"],
            centres=arrays["centres"],
            displacements=arrays["displacements"],
            faces=arrays.get("faces", np.empty((0, 3), np.int32)),
            residual=arrays.get("residual", np.full(count, np.nan)),
            spread=float(arrays["spread"]),
            **{key: str(arrays.get(key, "")) for key in ("source", "target", "date")},
            figures=dict(json.loads(str(arrays.get("figures", "{}")))),
        )
    except KeyError as error:
        raise FemorsError(f"{name}: is not a field file ({error.args[0]} is missing)") from None
    except FemorsError as error:
        raise FemorsError(f"{name}: {error}") from None
    except (OSError, EOFError, BadZipFile, zlib.error):
        raise FemorsError(f"{name}: is not a field file, or one that was cut short") from None
    except (TypeError, ValueError):
        raise FemorsError(f"{name}: is not a field file (its arrays are of another kind)") from None


def _arrays(file: IO[bytes]) -> dict[str, Any]:
    if file.read(4) != b"PK\x03\x04":  # numpy would take anything else for a pickle
        raise EOFError
    file.seek(0)
    with np.load(file, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}
