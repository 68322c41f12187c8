# SPDX-License-Identifier: GPL-3.0-or-later
"""Nastran bulk data: its ways of writing numbers and fields, and that all but nodes that moved is kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from femors_addon import deckfiles, nastran
from femors_addon.deck import Deck
from femors_addon.elements import KINDS
from femors_addon.progress import FemorsError
from femors_addon.volume import Block, VolumeMesh

BDF = """$ a comment
SOL 101
CEND
GRID = 3
BEGIN BULK
$ small fields
GRID    1               0.      0.0     .0              123456
GRID           2      0 1.      0.      -0.
GRID,3,,0.,1.+0,0.
GRID*                  4                             0.0             0.0
*                  1.0D0               0
grid,5,,1.,
,1.,70.-1
CTETRA  1       7       1       2       3       4
CTETRA,2,7,2,3,4,5
CTRIA3  11      8       1       2       3       0.0
CQUAD4  12      9       1       2       3       4
CBAR    20      1       1       2       0.0     0.0     1.0
MAT1    1       210000.         .3
PSOLID  7       1
SPC1    1       123456  1       THRU    3
ENDDATA
GRID    99      not read
"""


def deck_of(path: Path, content: str) -> Deck:
    path = path / "deck.bdf"
    path.write_bytes(content.encode())
    return deckfiles.read_deck(path)


def test_what_a_file_has(tmp_path):
    deck = deck_of(tmp_path, BDF)
    assert deck.mesh.node_ids.tolist() == [1, 2, 3, 4, 5]
    assert deck.coordinates.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0]]
    assert [(b.kind, b.type, b.ids.tolist()) for b in deck.mesh.blocks] == [
        *(("tet4", "CTETRA", [1, 2]), ("tri3", "CTRIA3", [11]), ("quad4", "CQUAD4", [12])),
    ]
    assert {name: part.elements.tolist() for name, part in deck.parts.items()} == {
        "PID 7": [0, 1],
        "PID 8": [2],
        "PID 9": [3],
    }


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_only_cards_of_nodes_that_moved_change(tmp_path, newline):
    text = BDF.replace("\n", newline)
    deck = deck_of(tmp_path, text)
    assert deck.encoded() == text.encode()
    moved = np.array(deck.coordinates)
    moved[0] = [-12.345678901234567, 1e-5, 3]
    moved[3, 0] = 0.5
    deck.with_coordinates(moved).write(tmp_path / "out.bdf")
    out = (tmp_path / "out.bdf").read_bytes().decode()
    before, after = text.split(newline), out.split(newline)
    assert after[:6] == before[:6]
    assert after[6] == "GRID*   1                               -12.3456789012351.e-05"
    assert after[7] == "*       3.0                             123456"
    assert after[8:10] == before[7:9]
    assert after[10] == "GRID*   4                               0.5             0.0"
    assert after[11:] == ["*       1.0D0           0", *before[11:]]
    assert np.allclose(deckfiles.read_deck(tmp_path / "out.bdf").coordinates, moved, atol=1e-12, rtol=0)


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_comments_in_the_cards_of_nodes_that_moved_are_kept(tmp_path, newline):
    """They come before the card, for other programs may not look for them in it."""
    large = "GRID*                  4                             0.0             0.0\n"
    text = BDF.replace(large, f"{large}$ within: 1.5\n\n  $GRID,7\n").replace(",1.+0,0.", ",1.+0,0. $ behind")
    text = text.replace("grid,5", "$ before\ngrid,5").replace("\n", newline)
    deck = deck_of(tmp_path, text)
    assert np.array_equal(deck.coordinates, deck_of(tmp_path, BDF).coordinates)
    assert deck.encoded() == text.encode()
    moved = deck.coordinates + [0, 0, 2]
    out = deck.with_coordinates(moved).encoded().decode()
    assert np.array_equal(deck_of(tmp_path, out).coordinates, moved)
    lines = [line[:24].rstrip() for line in out.split(newline)]
    at = lines.index("$ behind")
    assert lines[at : at + 11] == [
        *("$ behind", "GRID*   3", "*       2.0"),
        *("$ within: 1.5", "", "  $GRID,7", "GRID*   4", "*       3.0"),
        *("$ before", "GRID*   5", "*       2.0"),
    ]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("7.0", 7),
        (".7E1", 7),
        ("0.7+1", 7),
        (".70+1", 7),
        ("7.E+0", 7),
        ("70.-1", 7),
        ("7.D0", 7),
        ("-7", -7),
        ("", 0),
    ],
)
def test_spellings_of_seven(tmp_path, text, value):
    assert deck_of(tmp_path, BDF.replace("1.+0", text)).coordinates[2, 1] == value


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("CTETRA,2,7,2,3,4,5", "CTETRA,2,7,2,3,4,6", ("line 15", "element 2 names node 6")),
        ("CTETRA,2,7,2,3,4,5", "CTETRA,2,7,2,3,4", ("line 15", "the id of a node was expected, not ''")),
        ("CTETRA,2,7", "CTETRA,1,7", ("line 15", "element 1 is there already, on line 14")),
        ("GRID,3", "GRID,1", ("line 9", "node 1 is there already, on line 7")),
        ("GRID,3", "GRID,x", ("line 9", "a node's id was expected, not 'x'")),
        ("GRID,3,,0.", "GRID,3,,0x", ("line 9", "a coordinate was expected, not '0x'")),
        ("GRID,3,,0.", "GRID,3,,1.E999", ("line 9", "a coordinate was expected")),
        ("GRID,3,,0.", "GRID,3,,nan", ("line 9", "a coordinate was expected")),
        ("GRID,3,,0.", "GRID,3,4,0.", ("line 9", "node 3 is in coordinate system 4; use")),
        # of nodes without a system of their own; node 2 says that it is in the basic one
        ("$ small fields", "GRDSET,,4", ("line 7", "node 1 is in coordinate system 4 (by the GRDSET card)")),
    ],
)
def test_faults_are_named_with_their_line(tmp_path, old, new, words):
    assert old in BDF
    with pytest.raises(FemorsError) as caught:
        deck_of(tmp_path, BDF.replace(old, new))
    assert "\n" not in str(caught.value)
    for word in (str(tmp_path / "deck.bdf"), *words):
        assert word in str(caught.value)


def test_files_that_are_no_decks(tmp_path):
    for content, words in (
        ("BEGIN BULK\n", "has no nodes"),
        ("BEGIN BULK", "has no nodes"),
        ("ENDDATA\n", "has no nodes"),
        ("GRID,1,,0.,0.,0.\n", "no elements with a surface"),
        ("GRID\0", "binary"),
        ("", "empty"),
    ):
        with pytest.raises(FemorsError, match=words):
            deck_of(tmp_path, content)
    assert deck_of(tmp_path, "INCLUDE 'a.bdf'\n" + BDF.partition("BULK\n")[2]).notes == (
        "files that an INCLUDE names are not read",
        "elements of type CBAR are kept as they are",
    )


def test_elements_that_take_no_part_are_told(tmp_path):
    more = "RBE2*,21,1,123,2\n*,3\nrbe3,22,,3,123\nCORD2R,5,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\nENDDATA"
    assert deck_of(tmp_path, BDF.replace("ENDDATA", more)).notes == (
        "elements of type CBAR, RBE2, RBE3 are kept as they are",
    )
    assert deck_of(tmp_path, BDF.replace("CBAR ", "$    ")).notes == ()


@pytest.mark.parametrize("wide", [0, 10**9])
def test_every_kind_there_and_back(tmp_path, wide):
    rng = np.random.default_rng(0)
    nodes = rng.normal(scale=100, size=(30, 3))
    blocks = [
        Block(kind, rng.permutation(30)[: KINDS[kind].size][None], np.array([wide + number + 1]))
        for number, kind in enumerate(KINDS)
    ]
    mesh = VolumeMesh(nodes, tuple(blocks), np.arange(1, 31) + wide)
    (tmp_path / "out.bdf").write_bytes(nastran.fresh(mesh, {"a": np.arange(4)}))
    deck = deckfiles.read_deck(tmp_path / "out.bdf")
    assert np.allclose(deck.coordinates, nodes, rtol=1e-12, atol=1e-12)
    assert np.array_equal(deck.mesh.node_ids, mesh.node_ids)
    again = {int(block.ids[0]) - wide - 1: block for block in deck.mesh.blocks}
    for number, block in enumerate(blocks):
        assert again[number].kind == block.kind
        assert np.array_equal(again[number].nodes, block.nodes)
    assert {name: len(part.elements) for name, part in deck.parts.items()} == {"PID 1": 4, "PID 2": 8}


MIDS = "".join(f"GRID,{11 + index},,{index}.,9.,9.\n" for index in range(12))


@pytest.mark.parametrize(
    ("card", "kind"),
    [
        ("CTETRA,1,7,1,2,3,4,11,12\n,13,14,15,16", "tet10"),
        ("CTETRA,1,7,1,2,3,4,,\n,,,,", "tet4"),
        ("CTETRA  1       7       1       2       3       4       $ 9", "tet4"),
        ("CTRIA6,1,7,1,2,3,11,12,13\n,45.", "tri6"),
        ("CTRIA6,1,7,1,2,3,,,\n,45.", "tri3"),
        ("CTETRA,1,7,1,2,3,4,11,12\n,13,,15,16", "element 1 (CTETRA) has 5 of its 6 mid-side nodes; give it"),
        ("CQUAD8,1,7,1,2,3,4,11,\n,,", "element 1 (CQUAD8) has 1 of its 4 mid-side nodes; give it all of"),
        ("CTRIA6,1,7,1,2,3,x,,", "element 1 (CTRIA6) has 1 of its 3 mid-side nodes"),
        ("CTRIA6,1,7,1,2,3,11,x,12", "the id of a node was expected, not 'x'"),
    ],
)
def test_mid_side_nodes_are_there_all_or_none(tmp_path, card, kind):
    content = BDF.partition("CTETRA")[0] + MIDS + card + "\nENDDATA\n"
    if kind in KINDS:
        assert [block.kind for block in deck_of(tmp_path, content).mesh.blocks] == [kind]
        return
    with pytest.raises(FemorsError) as caught:
        deck_of(tmp_path, content)
    assert str(caught.value).startswith(f"{tmp_path / 'deck.bdf'}: line 26: ")
    assert kind in str(caught.value) and "\n" not in str(caught.value)
