# SPDX-License-Identifier: GPL-3.0-or-later
"""Abaqus decks that are refused, and the numbers that are written."""

from __future__ import annotations

import os
import re

import numpy as np
import pytest
from decktexts import ASSEMBLY, TETS, deck_of, refused
from hypothesis import given
from hypothesis import strategies as st

from femors_addon import deckfiles, inp_table
from femors_addon.fields import number
from femors_addon.inp_write import replaced
from femors_addon.progress import FemorsError

pytestmark = pytest.mark.filterwarnings("error::DeprecationWarning")


# --- refusals -------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("3, 4,\n 5", "3, 4,\n 6", ("line 14", "element 2 names node 6, which the deck lacks")),
        ("1, 1, 2, 3, 4\n", "1, 1, 2, 3\n", ("line 13", "element 1 has 3 nodes, and C3D4 needs 4")),
        ("1, 1, 2, 3, 4\n", "1, 1, 2, 3, 4, 5\n", ("line 13", "element 1 has 5 nodes, and C3D4 needs 4")),
        ("1, 1, 2, 3, 4\n", "1, 1, 2, 3, 4, 2, 2, 3, 4, 5\n", ("line 13", "element 1 has 9 nodes")),
        ("  3, 4,\n 5\n", "  3, 4\n", ("line 14", "element 2 has 3 nodes, and C3D4 needs 4")),
        ("  3, 4,\n 5\n", "  3, 4,\n 5, 1\n", ("line 14", "element 2 has 5 nodes")),
        ("2, 2,\n", "1, 2,\n", ("line 14", "element 1 is there already, on line 13 of deck.inp")),
        ("      5,  1", "      4,  1", ("line 11", "node 4 is there already, on line 10 of deck.inp")),
        ("  4, 0, 0", "  4, O, 0", ("line 10", "'O' is not a number")),
        ("  4, 0, 0", "  4, 1_0, 0", ("line 10", "'1_0' is not a number")),
        ("  4, 0, 0", "  4, 0 0, 0", ("line 10", "'0 0' is not a number")),
        ("  4, 0, 0", "  4, nan, 0", ("line 10", "not finite")),
        ("  4, 0, 0", "  4, 1e999, 0", ("line 10", "not finite")),
        ("  4, 0, 0", "  4.5, 0, 0", ("line 10", "a node's id was expected, a whole number from 1, not 4.5")),
        ("  4, 0, 0", "  -4, 0, 0", ("line 10", "a node's id was expected")),
        ("      5,  1 , 1,  1\n", "      5\n", ("line 11", "coordinates x, y, z were expected, not 1 value")),
        ("      5,  1 ,", "      5,  1 ,1,2,3,4,5,6,", ("line 11", "not 10 values")),
        ("1, 1, 2, 3, 4\n", "1, 1, 2, x, 4\n", ("line 13", "a whole number was expected, not 'x'")),
        ("1, 1, 2, 3, 4\n", "1, 1, 2, , 4\n", ("line 13", "a whole number was expected, not ''")),
        ("1, 1, 2, 3, 4\n", f"1, 1, 2, {10**19}, 4\n", ("line 13", "a whole number was expected")),
        ("1, 1, 2, 3, 4\n", "1, 1, 2, 3.0, 4\n", ("line 13", "a whole number was expected, not '3.0'")),
        ("TYPE=C3D4, ", "", ("line 12", "needs TYPE=")),
        ("TYPE=C3D4", "TYPE=C3D27", ("no elements with a surface", "C3D27")),
        ("TYPE=C3D4", "TYPE=C3D4, INPUT=x.txt", ("line 12", "INPUT= is not read")),
        ("*Node, nset", "*Node, INPUT=n.txt, nset", ("line 4", "INPUT= is not read")),
        ("*Node, nset", "*Node, SYSTEM=C, nset", ("line 4", "coordinate system of their own")),
        ("*Node, nset", "*SYSTEM\n1,0,0\n*Node, nset", ("line 6", "coordinate system of their own")),
        ("*Elset, elset=both", "*ELGEN", ("line 22", "*ELGEN makes nodes or elements")),
        ("nset=Even, generate", "generate", ("line 18", "needs NSET= and a name")),
        ("2, 4, 2", "2, 4, 0", ("line 19", "a step from 1 was expected, not 0")),
        ("2, 4, 2", "2, four", ("line 19", "first, last and step")),
        ("*HEADING\n", "", ("line 1", "a keyword line (*...) was expected, not 'Two tetrahedra")),
    ],
)
def test_faults_are_named_with_their_line(tmp_path, old, new, words):
    assert old in TETS
    refused(tmp_path, TETS.replace(old, new, 1), *words)


@pytest.mark.parametrize("chunk", [1, 3, 1000])
def test_a_field_that_is_no_number_is_left_to_who_knows_the_line(monkeypatch, chunk):
    monkeypatch.setattr(inp_table, "CHUNK", chunk)
    assert inp_table.parsed(b"", np.float64).tolist() == []
    assert inp_table.parsed(b"1, -2.5e1 ,\t.5", np.float64).tolist() == [1.0, -25.0, 0.5]
    assert inp_table.parsed(b"1, -2\r,+3", np.int64).tolist() == [1, -2, 3]
    for text in (b"1,,2", b",1", b"1,", b"1, ", b"1,2 3", b"1,1_0", b"1,x", b"1,1e", b"1,1.2.3", b"1,0x1"):
        assert inp_table.parsed(text, np.float64) is None, text
    for text in (b"1,2.0", b"1,2-3", b"1,1_0", b"1,", b"1,%d" % 10**19):
        assert inp_table.parsed(text, np.int64) is None, text


def test_files_that_are_no_decks(tmp_path):
    refused(tmp_path, "", "is empty")
    refused(tmp_path, "**\n", "has no nodes")
    refused(tmp_path, "*NODE\n*ELEMENT, TYPE=S3\n", "has no nodes")
    refused(tmp_path, "*NODE\n1,0,0,0\n", "no elements with a surface")
    refused(tmp_path, b"\x89PNG\r\n\x1a\n\0\0", "binary")
    refused(tmp_path, os.urandom(5000), "")
    refused(tmp_path, TETS.replace("\n", "\r"), "carriage returns alone")
    refused(tmp_path, "*NODE\n" + "1, " * 400_000, "line 2", "a line of 1200000 bytes")
    refused(tmp_path, "*ELEMENT, TYPE=S3\n1,1,2,3\n", "has no nodes")
    refused(tmp_path, "solid ascii\nfacet normal 0 0 1\n", "line 1", "a keyword line")
    refused(tmp_path, ASSEMBLY.replace("name=Plate\n", "name=femur\n"), "line 16", "there already")
    refused(tmp_path, ASSEMBLY.replace("*Part, name=Plate", "*Part"), "line 16", "needs NAME=")
    refused(tmp_path, ASSEMBLY.replace("10., 0., 1., 90.", "10., 0., 1."), "line 29", "to place an instance")
    refused(tmp_path, ASSEMBLY.replace("10., 0., 1., 90.", "10., 0., 0., 90."), "line 27", "no length")
    with pytest.raises(FemorsError, match="no such file"):
        deckfiles.read_deck(tmp_path / "none.inp")


def test_coordinates_must_be_finite_and_as_many(tmp_path):
    deck = deck_of(tmp_path, TETS)
    with pytest.raises(FemorsError, match=r"not finite \(first: node 1\)"):
        deck.with_coordinates(np.full((5, 3), np.inf))
    with pytest.raises(ValueError, match="shape"):
        deck.with_coordinates(np.zeros((4, 3)))


# --- numbers --------------------------------------------------------------------------------------
@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_fit_the_twenty_characters_that_are_read(value):
    text = number(value)
    assert len(text) <= 20
    assert re.fullmatch(r"-?[0-9]*\.[0-9]*(e[+-]?[0-9]+)?", text), text
    if len(repr(value)) <= 20:
        assert float(text) == value
    else:
        assert abs(float(text) - value) <= max(1e-18, 1e-12 * abs(value)), text


@given(st.floats(min_value=0.1, max_value=1e15) | st.floats(min_value=-1e15, max_value=-0.1))
def test_numbers_of_a_body_are_exact(value):
    assert float(number(value)) == value


@given(st.floats(min_value=-1e300, max_value=1e300))
def test_numbers_fit_the_fields_of_nastran(value):
    text = number(value, 16)
    assert len(text) <= 16
    assert "." in text
    assert abs(float(text) - value) <= 1e-8 * abs(value)


def test_a_line_keeps_its_looks():
    old, new = [1.0, 2.0, 3.0], [1.5, 2.0, 3.5]
    assert replaced(b"  7 , 1.0,  2.0d0 ,3. \r", new, old) == b"  7 , 1.5,  2.0d0 ,3.5 \r"
    assert replaced(b"7,1,2,3,0.,0.,1.", new, old) == b"7,1.5,2,3.5,0.,0.,1."
    assert replaced(b"7,1", new, [1.0, 0.0, 0.0]) == b"7,1.5,2.0,3.5"
    assert replaced(b"7,1", [1.0, 0.0, 5.0], [1.0, 0.0, 0.0]) == b"7,1,,5.0"
