# SPDX-License-Identifier: GPL-3.0-or-later
"""Kinds of elements: their faces, and their names in decks."""

from __future__ import annotations

import collections

import numpy as np
import pytest
from volumecases import REGULAR

from femors_addon import elements
from femors_addon.elements import KINDS, abaqus_kind, febio_kind


def test_faces_of_every_solid_are_closed_and_look_outward():
    for kind in KINDS.values():
        if not kind.solid:
            continue
        halves = collections.Counter()
        for face in kind.faces:
            halves.update(zip(face, face[1:] + face[:1], strict=True))
        assert set(halves.values()) == {1}, kind.name
        assert all((b, a) in halves for a, b in halves), kind.name
        assert {tuple(sorted(pair)) for pair in halves} >= {tuple(sorted(edge)) for edge in kind.edges}
        corners = REGULAR[next(name for name in REGULAR if KINDS[name].corners == kind.corners)]
        for face in kind.faces:
            a, b, c = corners[list(face[:3])]
            assert np.dot(np.cross(b - a, c - a), a - corners.mean(axis=0)) > 0, (kind.name, face)
        for corner, *ends in kind.frames:
            assert np.linalg.det(corners[ends] - corners[corner]) > 0, (kind.name, corner)
            assert all((corner, end) in halves for end in ends)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *(
            ("C3D4", "tet4"),
            ("c3d10m", "tet10"),
            ("C3D10MH", "tet10"),
            ("C3D10HS", "tet10"),
            ("C3D6", "penta6"),
        ),
        *(
            ("C3D8", "hex8"),
            ("C3D8R", "hex8"),
            ("C3D8IH", "hex8"),
            ("C3D20R", "hex20"),
            ("C3D20RHT", "hex20"),
        ),
        *(("C3D15", "penta15"), ("DC3D8", "hex8"), ("AC3D4", "tet4"), ("SC8R", "hex8"), ("C3D5", "pyra5")),
        *(
            ("S3", "tri3"),
            ("S3R", "tri3"),
            ("S4", "quad4"),
            ("S4R", "quad4"),
            ("S4R5", "quad4"),
            ("S4RS", "quad4"),
        ),
        *(("STRI3", "tri3"), ("STRI65", "tri6"), ("S8R", "quad8"), ("S8R5", "quad8"), ("R3D3", "tri3")),
        *(("R3D4", "quad4"), ("M3D3", "tri3"), ("M3D4R", "quad4"), ("M3D6", "tri6"), ("SFM3D4R", "quad4")),
        *(("CPS3", "tri3"), ("CPE4RH", "quad4"), ("CPS6M", "tri6"), ("CPE8R", "quad8"), ("CAX4R", "quad4")),
        *(
            ("C3D27", None),
            ("C3D15V", None),
            ("T3D2", None),
            ("SPRINGA", None),
            ("B31", None),
            ("COH3D8", None),
        ),
        *(("MASS", None), ("CONN3D2", None), ("U1", None), ("", None), ("S9R5", None), ("GK3D8", None)),
    ],
)
def test_names_of_abaqus(name, kind):
    found = abaqus_kind(name)
    assert (found and found.name) == kind


def test_names_of_febio_and_back():
    assert febio_kind("TET10G4RI1").name == "tet10"
    assert febio_kind(" hex8 ").name == "hex8"
    assert febio_kind("q4ans").name == "quad4"
    assert febio_kind("hex27") is febio_kind("truss2") is febio_kind("") is None
    for kind in KINDS:
        assert febio_kind(kind).name == kind
    for kind, name in elements.ABAQUS_NAMES.items():
        assert abaqus_kind(name).name == kind
