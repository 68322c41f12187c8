# SPDX-License-Identifier: GPL-3.0-or-later
"""Element kinds: corners, faces, edges and names, one table for every format.

Nodes are numbered as in Abaqus, from 0: the base face first, seen from outside clockwise (its normal
points into the element), then the opposite one, then mid-side nodes along `edges` in order.
"""

from __future__ import annotations

import dataclasses
import re
from typing import Any


@dataclasses.dataclass(frozen=True)
class Kind:
    """What all elements of one kind have in common.

    Attributes
    ----------
    name : str
        As in FEBio: tet4, hex8, penta6, tri3 and so on.
    corners : int
        Number of corner nodes; they come first.
    faces : tuple of tuples
        Corners of each face, counter-clockwise seen from outside, in Abaqus' order (S1, S2 ...). A
        shell has itself as its only face.
    edges : tuple of pairs
        The corners that each mid-side node stands between, in the order of the mid-side nodes; empty
        for linear kinds.
    frames : tuple of (corner, a, b, c)
        At each corner the ends of three edges that are right-handed in a valid element; empty for shells.
    ideal : float
        Determinant of three such unit vectors in the regular element; the scaled Jacobian is its share.
    """

    name: str
    corners: int
    faces: tuple[tuple[int, ...], ...]
    edges: tuple[tuple[int, int], ...] = ()
    frames: tuple[tuple[int, int, int, int], ...] = ()
    ideal: float = 1.0

    @property
    def size(self) -> int:
        """Number of nodes."""
        return self.corners + len(self.edges)

    @property
    def solid(self) -> bool:
        """Whether it has a volume; else it is a shell."""
        return len(self.faces) > 1

    @property
    def mirrored(self) -> tuple[int, ...]:
        """The order of its nodes in which the mirror image of a valid element is valid."""
        order = _MIRRORED[self.corners, self.solid]
        ends = [frozenset(edge) for edge in self.edges]
        mids = (ends.index(frozenset((order[a], order[b]))) for a, b in self.edges)
        return (*order, *(self.corners + mid for mid in mids))


_MIRRORED = {
    (4, True): (0, 2, 1, 3),
    (5, True): (0, 3, 2, 1, 4),
    (6, True): (0, 2, 1, 3, 5, 4),
    (8, True): (0, 3, 2, 1, 4, 7, 6, 5),
    (3, False): (0, 2, 1),
    (4, False): (0, 3, 2, 1),
}
"""By number of corners, and whether solid: its base face the other way round."""

_TET: dict[str, Any] = {
    "corners": 4,
    "faces": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    "frames": ((0, 1, 2, 3), (1, 2, 0, 3), (2, 0, 1, 3), (3, 2, 1, 0)),
    "ideal": 0.5**0.5,
}
_PYRAMID: dict[str, Any] = {
    "corners": 5,
    "faces": ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    "frames": ((0, 1, 3, 4), (1, 2, 0, 4), (2, 3, 1, 4), (3, 0, 2, 4)),
    "ideal": 0.5**0.5,
}
_WEDGE: dict[str, Any] = {
    "corners": 6,
    "faces": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "frames": ((0, 1, 2, 3), (1, 2, 0, 4), (2, 0, 1, 5), (3, 5, 4, 0), (4, 3, 5, 1), (5, 4, 3, 2)),
    "ideal": 0.75**0.5,
}
_HEX: dict[str, Any] = {
    "corners": 8,
    "faces": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    "frames": (
        *((0, 1, 3, 4), (1, 2, 0, 5), (2, 3, 1, 6), (3, 0, 2, 7)),
        *((4, 7, 5, 0), (5, 4, 6, 1), (6, 5, 7, 2), (7, 6, 4, 3)),
    ),
}
_TRI: dict[str, Any] = {"corners": 3, "faces": ((0, 1, 2),)}
_QUAD: dict[str, Any] = {"corners": 4, "faces": ((0, 1, 2, 3),)}
_RING3, _RING4 = ((0, 1), (1, 2), (2, 0)), ((0, 1), (1, 2), (2, 3), (3, 0))
_TOP3, _TOP4 = ((3, 4), (4, 5), (5, 3)), ((4, 5), (5, 6), (6, 7), (7, 4))

KINDS: dict[str, Kind] = {
    name: Kind(name, edges=edges, **shape)
    for name, shape, edges in (
        ("tet4", _TET, ()),
        ("tet10", _TET, (*_RING3, (0, 3), (1, 3), (2, 3))),
        ("pyra5", _PYRAMID, ()),
        ("pyra13", _PYRAMID, (*_RING4, (0, 4), (1, 4), (2, 4), (3, 4))),
        ("penta6", _WEDGE, ()),
        ("penta15", _WEDGE, (*_RING3, *_TOP3, (0, 3), (1, 4), (2, 5))),
        ("hex8", _HEX, ()),
        ("hex20", _HEX, (*_RING4, *_TOP4, (0, 4), (1, 5), (2, 6), (3, 7))),
        ("tri3", _TRI, ()),
        ("tri6", _TRI, _RING3),
        ("quad4", _QUAD, ()),
        ("quad8", _QUAD, _RING4),
    )
}
"""Every kind that takes part in a morph, by name."""

# --- Abaqus ---------------------------------------------------------------------------------------
# each pattern holds one group, the number of nodes; what stands behind it are variants of the formulation
_ABAQUS_SOLID = re.compile(r"(?:AC|DCC?|EMC|Q|C)3D(4|5|6|8|10|15|20)[A-Z]{0,4}|SC([68])R[A-Z]?")
_ABAQUS_SHELL = re.compile(
    r"S([3468])R?[A-Z]{0,2}5?|STRI(3)|STRI6(5)|DS([3468])|R3D([34])|SFM3D([3468])[A-Z]?|M3D([3468])[A-Z]?"
    r"|F3D([34])|(?:DC|AC|Q|EMC)2D([3468])[A-Z]{0,2}|(?:CPS|CPE|CPEG|CAX|CGAX|DCAX|ACAX)([3468])[A-Z]{0,3}"
)
_SOLIDS = {4: "tet4", 10: "tet10", 5: "pyra5", 6: "penta6", 15: "penta15", 8: "hex8", 20: "hex20"}
_SHELLS = {3: "tri3", 6: "tri6", 5: "tri6", 4: "quad4", 8: "quad8"}
ABAQUS_NAMES = {
    "tet4": "C3D4",
    "tet10": "C3D10",
    "pyra5": "C3D5",
    "penta6": "C3D6",
    "penta15": "C3D15",
    "hex8": "C3D8",
    "hex20": "C3D20",
    "tri3": "S3",
    "tri6": "STRI65",
    "quad4": "S4",
    "quad8": "S8R",
}
"""What to call a kind that comes from another format; Abaqus has no 13-node pyramid."""


def abaqus_kind(name: str) -> Kind | None:
    """Return the kind of an Abaqus element type (any case), None where it takes no part in a morph.

    C3D15V and its like, whose number of nodes varies, and elements without a surface of their own
    (trusses, springs, cohesive and gasket elements) take none.
    """
    name = name.strip().upper()
    for pattern, kinds in ((_ABAQUS_SOLID, _SOLIDS), (_ABAQUS_SHELL, _SHELLS)):
        match = pattern.fullmatch(name)
        if match is not None and not name.endswith("V"):
            count = next(int(group) for group in match.groups() if group is not None)
            return KINDS[kinds[count]]
    return None


# --- FEBio ----------------------------------------------------------------------------------------
_FEBIO = re.compile(r"(tet4|tet10|pyra5|pyra13|penta6|penta15|hex8|hex20|tri3|tri6|quad4|quad8)(g[0-9].*)?")


def febio_kind(name: str) -> Kind | None:
    """Return the kind of an FEBio element type such as "hex8" or "TET10G4", None for others."""
    match = _FEBIO.fullmatch(name.strip().lower())
    if match is not None:
        return KINDS[match[1]]
    return KINDS["quad4"] if name.strip().lower() in ("q4ans", "q4eas") else None


# --- meshio ---------------------------------------------------------------------------------------
MESHIO_NAMES = {
    "tet4": "tetra",
    "tet10": "tetra10",
    "pyra5": "pyramid",
    "pyra13": "pyramid13",
    "penta6": "wedge",
    "penta15": "wedge15",
    "hex8": "hexahedron",
    "hex20": "hexahedron20",
    "tri3": "triangle",
    "tri6": "triangle6",
    "quad4": "quad",
    "quad8": "quad8",
}
"""meshio numbers the nodes of these as Abaqus does; other cells take no part in a morph."""
MESHIO_KINDS = {meshio: KINDS[name] for name, meshio in MESHIO_NAMES.items()}
