# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts, instances and the assembly of an Abaqus deck: what each keyword's ids belong to."""

from __future__ import annotations

import numpy as np

from .deck import Instance
from .inp_syntax import Keyword
from .mesh import Float


class Scopes:
    """Sets every keyword's scope, and knows the parts and instances.

    A scope is "" outside of all, "P:NAME" in a part, "I:NAME" in an instance, "A:" in the assembly;
    node and element ids are unique within one.

    Attributes
    ----------
    names : dict
        Names of the part and instance scopes as the deck spells them.
    instances : tuple of Instance
    """

    def __init__(self, words: list[Keyword]) -> None:
        self.names: dict[str, str] = {}
        self.instances: tuple[Instance, ...] = ()
        self._part_of: dict[str, str] = {}
        part, assembly, instance = "", "", ""
        for word in words:
            if word.name == "PART":
                part = self._begun(word, "P:")
            elif word.name == "INSTANCE":
                instance = self._begun(word, "I:")
                of = word.parameters.get("PART", "")
                self._part_of[instance] = f"P:{of.upper()}"
                self.instances += (Instance(self.names[instance], of, placement(word)),)
            elif word.name == "ASSEMBLY":
                assembly = "A:"
            word.scope = instance or part or assembly
            if word.name == "END PART":
                part = ""
            elif word.name == "END INSTANCE":
                instance = ""
            elif word.name == "END ASSEMBLY":
                assembly = ""
        self._filled = {word.scope for word in words if word.name == "NODE"}

    def _begun(self, word: Keyword, prefix: str) -> str:
        name = word.parameters.get("NAME", "")
        if not name:
            raise word.error(f"*{word.name} needs NAME=")
        scope = prefix + name.upper()
        if scope in self.names:
            raise word.error(f"the {word.name.lower()} '{name}' is there already")
        self.names[scope] = name
        return scope

    def owner(self, scope: str) -> str:
        """Return the scope that holds a scope's nodes: of an instance its part, unless it has some itself."""
        return scope if scope in self._filled else self._part_of.get(scope, scope)

    def target(self, word: Keyword) -> str:
        """Return the scope whose members a set or surface names: its own, or that of INSTANCE=."""
        name = word.parameters.get("INSTANCE", "")
        return self.owner(f"I:{name.upper()}" if name else word.scope)


def placement(word: Keyword) -> Float:
    """Return the matrix (4, 4) of an *INSTANCE: a translation, then a turn about an axis.

    Raises
    ------
    FemorsError
        Data lines that are not 3 numbers and then 7 (two points of the axis, angle in degrees).
    """
    rows: list[list[float]] = []
    for source, offset, fields in word.lines():
        try:
            # Fortran's exponent is as good as any
            rows.append([float(field.upper().replace(b"D", b"E")) for field in fields if field])
        except ValueError:
            rows.append([])
        if len(rows) > 2 or len(rows[-1]) != (3, 7)[len(rows) - 1] or not np.isfinite(rows[-1]).all():
            expected = "3 numbers (translation), then 7 (two points of the axis, angle)"
            raise source.error(offset, f"{expected} were expected to place an instance")
    out = np.eye(4)
    if rows:
        out[:3, 3] = rows[0]
    if len(rows) == 2:
        out = _turn(word, np.array(rows[1][:3]), np.array(rows[1][3:6]), np.radians(rows[1][6])) @ out
    return out


def _turn(word: Keyword, a: Float, b: Float, angle: float) -> Float:
    """Return the rotation about the axis from a to b (Rodrigues)."""
    length = float(np.linalg.norm(b - a))
    if not length > 0:
        raise word.error("the axis of the instance's rotation has no length")
    x, y, z = (b - a) / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    out = np.eye(4)
    out[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    out[:3, 3] = a - out[:3, :3] @ a
    return out
