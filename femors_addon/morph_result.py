# SPDX-License-Identifier: GPL-3.0-or-later
"""What a morph gives back: vertices, field, history, figures and warnings."""

from __future__ import annotations

import dataclasses
from typing import Any

from numpy.typing import ArrayLike

from .cached import cached_property
from .carry import Carrier
from .files import Location
from .grnn import DisplacementField
from .keptfield import KeptField
from .mesh import Float, Int
from .morph_settings import MorphSettings
from .quality import Comparison
from .steer import Steering


@dataclasses.dataclass(frozen=True)
class Step:
    """What one iteration did.

    Attributes
    ----------
    level : str
        Stage: reduced, fine or dense.
    nodes : int
        Of the mesh that was worked on.
    iteration : int
        Counted from one within its level.
    rms : float
        Root mean square length of the displacement vectors found, before the step.
    largest : float
        Largest movement of a node in the step.
    spread : float
        Of the field.
    """

    level: str
    nodes: int
    iteration: int
    rms: float
    largest: float
    spread: float


@dataclasses.dataclass(frozen=True, eq=False)
class MorphResult:
    """A morphed source.

    Attributes
    ----------
    vertices : (n, 3) float64
        Position of every vertex of the source that was given, in its order.
    transform : (4, 4) float64
        The alignment: source to aligned source.
    field : DisplacementField
        From aligned positions to displacements; its centres are the cleaned source's nodes.
    faces : (m, 3) int32
        Triangles over the field's centres, outward.
    residual : (c,) float64
        Misfit around each morphed centre, see `misfit_around`.
    history : tuple of Step
    converged : bool
        Whether the two surfaces have come together: see `stop_reason`.
    stop_reason : str
    warnings : tuple of str
        Whatever the user should know of the input and the result.
    before, after : Comparison
        The aligned source and the result against the target.
    surface_distance : (n,) float64
        Distance of each result vertex to the target's surface.
    displacement : (n,) float64
        How far each vertex was moved after the alignment.
    settings : MorphSettings
    seconds : float
        CPU time of the whole.
    steering : Steering, optional
        What became of paired landmarks.
    faults : tuple of str
        Of the warnings, those for which a result is not to be trusted blindly.
    """

    vertices: Float
    transform: Float
    field: DisplacementField
    faces: Int
    residual: Float
    history: tuple[Step, ...]
    converged: bool
    stop_reason: str
    warnings: tuple[str, ...]
    before: Comparison
    after: Comparison
    surface_distance: Float
    displacement: Float
    settings: MorphSettings
    seconds: float
    steering: Steering | None = None
    faults: tuple[str, ...] = ()

    def apply(self, points: ArrayLike) -> Float:
        """Carry points (k, 3) of the source's space along; see `carry.Carrier.carry`.

        A point of the surface stays in its triangle, a point off it keeps its offset, and far away the
        deformation fades out until the alignment alone is left.
        """
        return self._carrier.carry(points).points

    @cached_property
    def _carrier(self) -> Carrier:
        return Carrier(self.kept())

    def kept(self, source: str = "", target: str = "", date: str = "") -> KeptField:
        """Return alignment and displacement as a thing of their own, named after the pair.

        Parameters
        ----------
        source, target : str
            What the two are called.
        date : str
            When it was made, ISO 8601.
        """
        figures = {
            "vertices": len(self.vertices),
            "stop_reason": self.stop_reason,
            "target_to_surface": self.after.target_to_surface.as_dict(),
            "surface_to_target": self.after.surface_to_target.as_dict(),
        }
        return KeptField(
            self.transform,
            self.field.centres,
            self.field.displacements,
            self.faces,
            self.residual,
            self.field.spread,
            source,
            target,
            date,
            figures,
        )

    @property
    def sampled(self) -> str:
        """What to say where a sample tells how far the aligned source was; "" where all vertices do."""
        most = f"{self.before.sample:,}".replace(",", " ")
        words = f"aligned: distances at a sample of the vertices, at most {most} of each mesh"
        return words if self.before.sample else ""

    def report(self) -> dict[str, Any]:
        """Return everything but the arrays, for JSON."""
        return {
            "settings": dataclasses.asdict(self.settings),
            "transform": self.transform.tolist(),
            "converged": self.converged,
            "stop_reason": self.stop_reason,
            "warnings": list(self.warnings),
            "before": self.before.as_dict(),
            "after": self.after.as_dict(),
            **({"sampled": self.sampled} if self.sampled else {}),
            "history": [dataclasses.asdict(step) for step in self.history],
            "cpu_seconds": round(self.seconds, 3),
            **({} if self.steering is None else {"landmarks": self.steering.as_dict()}),
        }

    def summary(self) -> str:
        """Return a table of the figures for a person: median [1st, 99th percentile] and maximum."""
        rows = [
            ("surface, source to target", "surface_to_target"),
            ("surface, target to source", "target_to_surface"),
            ("nearest vertex", "hausdorff"),
            ("aspect ratio", "aspect"),
            ("dihedral angle, degrees", "dihedral"),
            ("movement", "movement"),
        ]
        lines = [f"{'':28}{'aligned':44}{'morphed'}"]
        for label, name in rows:
            lines.append(f"{label:28}{getattr(self.before, name)!s:43} {getattr(self.after, name)!s}")
        for label, name in (("flipped faces", "flipped"), ("self-intersecting faces", "self_intersecting")):
            lines.append(f"{label:28}{getattr(self.before, name):<44}{getattr(self.after, name)}")
        lines += [self.sampled] if self.sampled else []
        if self.steering is not None:
            lines.append(self.steering.sentence())
        lines.append(f"{self.stop_reason}; {self.seconds:.1f} s of CPU time")
        return "\n".join(lines)

    def save_field(self, path: Location, source: str = "", target: str = "", date: str = "") -> None:
        """Write what `kept` returns as an ``.npz`` file; `keptfield.load` reads it."""
        self.kept(source, target, date).save(path)
