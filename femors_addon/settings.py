# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings written once: a dataclass field carries default, limits, unit and help.

Blender's properties (`operators.props`) and the options of the command line (`femors_addon.cli`)
are made from these fields, so that a number, its limits and its words stand in one place.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, Literal

from .progress import FemorsError

Unit = Literal["", "length", "factor", "angle"]


@dataclasses.dataclass(frozen=True)
class Spec:
    """How a setting is shown and checked."""

    label: str
    help: str
    minimum: float | None = None
    maximum: float | None = None
    unit: Unit = ""
    choices: tuple[tuple[str, str, str], ...] = ()
    """For an enumeration: (value, label, help) each."""
    advanced: bool = False


def setting(default: Any, label: str, help: str, **spec: Any) -> Any:
    """Declare a dataclass field with its `Spec`."""
    return dataclasses.field(default=default, metadata={"spec": Spec(label, help, **spec)})


def specs(cls: type) -> dict[str, tuple[dataclasses.Field[Any], Spec]]:
    """Return the declared settings of a dataclass by name, in order."""
    return {f.name: (f, f.metadata["spec"]) for f in dataclasses.fields(cls) if "spec" in f.metadata}


def check(settings: Any, called: Callable[[str], str] | None = None) -> None:
    """Raise `FemorsError` for the first value outside its limits or choices.

    `called` gives the name by which the user knows a setting, where that is not its label.
    """
    for name, (_, spec) in specs(type(settings)).items():
        value, label = getattr(settings, name), called(name) if called else spec.label
        if spec.choices:
            allowed = [choice[0] for choice in spec.choices]
            if value not in allowed:
                raise FemorsError(f"{label}: '{value}' is not one of {', '.join(allowed)}")
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            low, high = spec.minimum, spec.maximum
            low, high = (-math.inf if low is None else low), (math.inf if high is None else high)
            if not low <= value <= high:  # also where it is NaN
                raise FemorsError(f"{label}: {value} is outside {low:g} to {high:g}")
