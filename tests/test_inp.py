# SPDX-License-Identifier: GPL-3.0-or-later
"""Abaqus decks: what is read, that all but coordinates is kept, and what is refused in one line."""

from __future__ import annotations

import os
import re
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from growth import LINEAR, growth
from hypothesis import given
from hypothesis import strategies as st

from femors_addon import deckfiles, inp_table
from femors_addon.deck import Deck
from femors_addon.fields import number
from femors_addon.inp_write import replaced
from femors_addon.progress import FemorsError

KNEE = Path(os.environ.get("FEMORS_DATA", Path(__file__).parent.parent.parent / "shared" / "data")) / "knee"
pytestmark = pytest.mark.filterwarnings("ignore:string or file could not be read:DeprecationWarning")
DECKS = sorted(KNEE.glob("*.inp"))

TETS = """*HEADING
Two tetrahedra, and what else a deck has
** a comment
*Node, nset=All
      1,           0.,           0.,           0.
      2,           1.,           0.,  0.000
** a comment among nodes, 1, 2, 3

\t3,\t0.0\t,\t1.0D+00,\t-0.
  4, 0, 0, 1.e0 ,
      5,  1 , 1,  1
*ELEMENT, TYPE=C3D4, ELSET=Body
1, 1, 2, 3, 4
2, 2,
** a comment within an element
  3, 4,
 5
*Nset, nset=Even, generate
2, 4, 2
*NSET,NSET="with blank"
Even, 5
*Elset, elset=both
1, 2
*Elset, elset=_top_S3, internal
2
*Surface, type=ELEMENT, name=Top
_top_S3, S3
*Material, name=Steel
*Elastic
210000., 0.3
*Step
*Static
*Node Output
U,
*End Step
"""


def deck_of(path: Path, content: str | bytes, name: str = "deck.inp") -> Deck:
    path = path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return deckfiles.read_deck(path)


def refused(path: Path, content: str | bytes, *words: str) -> str:
    """Assert that reading fails in one line that names the file and says the words."""
    with pytest.raises(FemorsError) as caught:
        deck_of(path, content)
    text = str(caught.value)
    assert text.startswith(str(path / "deck.inp")), text
    assert "\n" not in text
    for word in words:
        assert word in text, text
    return text


# --- reading --------------------------------------------------------------------------------------
def test_what_a_deck_has(tmp_path):
    deck = deck_of(tmp_path, TETS)
    mesh = deck.mesh
    assert mesh.node_ids.tolist() == [1, 2, 3, 4, 5]
    assert deck.coordinates.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]
    assert [(b.kind, b.type, b.nodes.tolist(), b.ids.tolist()) for b in mesh.blocks] == [
        ("tet4", "C3D4", [[0, 1, 2, 3], [1, 2, 3, 4]], [1, 2])
    ]
    assert {name: members.tolist() for name, members in mesh.node_sets.items()} == {
        "All": [0, 1, 2, 3, 4],
        "Even": [1, 3],
        "with blank": [1, 3, 4],
    }
    assert {name: members.tolist() for name, members in mesh.element_sets.items()} == {
        "Body": [0, 1],
        "both": [0, 1],
        "_top_S3": [1],
    }
    assert mesh.surfaces["Top"].tolist() == [2, 3, 4]
    assert list(deck.parts) == ["Body"]
    assert deck.parts["Body"].nodes.tolist() == [0, 1, 2, 3, 4]
    assert deck.notes == ()


@pytest.mark.parametrize("change", [str.upper, str.lower])
def test_upper_and_lower_case(tmp_path, change):
    one, two = deck_of(tmp_path, TETS), deck_of(tmp_path, change(TETS), "two.inp")
    assert np.array_equal(one.coordinates, two.coordinates)
    assert [name.upper() for name in two.mesh.node_sets] == [name.upper() for name in one.mesh.node_sets]
    assert two.mesh.surfaces[change("Top")].tolist() == [2, 3, 4]


ALIKE = {
    "CRLF": TETS.replace("\n", "\r\n"),
    "no newline at the end": TETS.rstrip("\n"),
    "no newline behind a node": "*ELEMENT, TYPE=C3D4\n1,1,2,3,4\n*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1",
    "latin-1": TETS.encode().replace(b"a comment", b"Sch\xe4del \xb5m"),
    "UTF-8": TETS.encode().replace(b"a comment", "Schädel ☃".encode()),
    "byte order mark": b"\xef\xbb\xbf" + TETS.encode(),
    "tabs": TETS.replace(" ", "\t").replace("*END\tSTEP", "*END STEP"),
    "blank lines": TETS.replace("\n", "\n\n"),
    "keywords indented": re.sub(r"(?m)^\*(?!\*)", "  *", TETS),
    "form feeds": TETS.replace("** a comment\n", "** a comment\f\n"),
}


@pytest.mark.parametrize("content", ALIKE.values(), ids=ALIKE)
def test_unchanged_it_is_the_same_file(tmp_path, content):
    content = content if isinstance(content, bytes) else content.encode()
    deck = deck_of(tmp_path, content)
    assert deck.encoded() == content
    assert deck.with_coordinates(deck.coordinates + 0.0).encoded() == content
    # and moved, every line but the nodes' is the same, and the nodes are where they should be
    moved = deck.with_coordinates(deck.coordinates + np.pi)
    moved.write(tmp_path / "out.inp")
    out = (tmp_path / "out.inp").read_bytes()
    before, after = content.split(b"\n"), out.split(b"\n")
    assert len(before) == len(after)
    changed = [i for i, (one, two) in enumerate(zip(before, after, strict=True)) if one != two]
    assert len(changed) == len(deck.coordinates)
    for i in changed:
        assert before[i].split(b",")[0] == after[i].split(b",")[0]
        assert before[i].endswith(b"\r") == after[i].endswith(b"\r")
        assert before[i].count(b",") == after[i].count(b",")
    again = deckfiles.read_deck(tmp_path / "out.inp")
    assert np.array_equal(again.coordinates, moved.coordinates)
    assert again.mesh.node_sets.keys() == deck.mesh.node_sets.keys()


def test_only_what_moved_is_written_anew(tmp_path):
    deck = deck_of(tmp_path, TETS)
    moved = np.array(deck.coordinates)
    moved[2, 2] = 0.1 + 0.2  # node 3, whose other coordinates are spelled in an odd way
    moved[3, 2] = 2.0
    out = deck.with_coordinates(moved).encoded().decode()
    assert out == TETS.replace("1.0D+00,\t-0.", "1.0D+00,\t0.30000000000000004").replace("1.e0 ,", "2.0 ,")


def test_coordinates_that_are_left_out_are_zero_and_can_move(tmp_path):
    deck = deck_of(
        tmp_path, "*NODE\n1,0,0\n2,1,\n3,0,1,\n4,,,1\n5,1,1, \r\n*ELEMENT,TYPE=CPS3\n1,1,2,3\n2,2,3,4\n"
    )
    assert deck.coordinates.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]]
    assert deck.notes == ("4 nodes have fewer coordinates than others; what is missing is 0",)
    moved = deck.with_coordinates(deck.coordinates + 0.5)
    moved.write(tmp_path / "out.inp")
    assert np.array_equal(deckfiles.read_deck(tmp_path / "out.inp").coordinates, moved.coordinates)
    up = deck.with_coordinates(deck.coordinates + [0, 0, 0.5]).encoded()
    assert up.startswith(b"*NODE\n1,0,0,0.5\n2,1,,0.5\n3,0,1,0.5\n4,,,1.5\n5,1,1,0.5 \r\n")


def test_element_types_and_lines(tmp_path):
    nodes = "*NODE\n" + "".join(f"{i},{i % 7},{i % 5},{i % 3}\n" for i in range(1, 21))
    text = (
        nodes
        + "*ELEMENT, TYPE=C3D20R, ELSET=A\n1, 1,2,3,4,5,6,7,8,9,10,11,12,13,14,15\n16,17,18,19,20\n"
        + "2,1,2,3,4,5,6,7,8,9,10,11,12,13,14,15,\n 16 , 17,18,19 , 20\n"
        + "*ELEMENT, ELSET=A, TYPE=C3D20R\n3, 1,2,3,4,\n5,6,7,8,\n9,10,11,12,13,14,15,16,17,18,19,20,\n"
        + "*ELEMENT, TYPE=STRI65, ELSET=B\n4,1,2,3,4,5,6\n*ELEMENT, TYPE=T3D2\n5, 1, 2\n"
        + "*ELEMENT, TYPE=C3D8I\n6,1,2,3,4,5,6,7,8\n*ELSET, ELSET=ALL\nA, B, 5, 6\n"
    )
    deck = deck_of(tmp_path, text)
    assert [(b.kind, b.type, len(b)) for b in deck.mesh.blocks] == [
        *(("hex20", "C3D20R", 3), ("tri6", "STRI65", 1), ("hex8", "C3D8I", 1)),
    ]
    assert (deck.mesh.blocks[0].nodes == np.arange(20)).all()
    assert deck.mesh.element_sets["ALL"].tolist() == [0, 1, 2, 3, 4]
    assert list(deck.parts) == ["A", "B", "deck"]
    assert deck.notes == ("elements without a surface are kept as they are (of type T3D2)",)
    assert deck.encoded() == text.encode()


def test_parts_and_their_sets(tmp_path):
    deck = deck_of(tmp_path, TETS.replace("*ELEMENT, TYPE=C3D4, ELSET=Body\n", "*ELEMENT, TYPE=C3D4\n"))
    assert deck.part(None) is deck.parts["deck"]
    deck = deck_of(tmp_path, TETS)
    assert deck.part("body") is deck.part(None)
    assert deck.part("_TOP_s3").elements.tolist() == [1]
    assert deck.part("_top_s3").nodes.tolist() == [1, 2, 3, 4]
    assert deck.part("All").elements.tolist() == [0, 1]
    with pytest.raises(FemorsError, match="no element has all its nodes in the node set 'Even'"):
        deck.part("even")
    with pytest.raises(FemorsError, match="has no part or set 'nope'; it has the parts 'Body' and"):
        deck.part("nope")
    mesh, nodes = deck.submesh(deck.part("_top_s3"))
    assert nodes.tolist() == [1, 2, 3, 4]
    assert mesh.node_sets["with blank"].tolist() == [0, 2, 3]


ASSEMBLY = """*Heading
*Part, name=Femur
*Node
1, 0, 0, 0
2, 1, 0, 0
3, 0, 1, 0
4, 0, 0, 1
9, 9, 9, 9
*Element, type=C3D4
1, 1, 2, 3, 4
*Nset, nset=tip
4
*Elset, elset=solid
1
*End Part
*Part, name=Plate
*Node
1, 0, 0, 0
2, 2, 0, 0
3, 0, 2, 0
*Element, type=S3
1, 1, 2, 3
*Nset, nset=tip
3
*End Part
*Assembly, name=A
*Instance, name=Femur-1, part=Femur
 10., 0., 0.
 10., 0., 0., 10., 0., 1., 90.
*End Instance
*Instance, name=Plate-1, part=plate
*End Instance
*Node
1, 5, 5, 5
*Nset, nset=point
1,
*Nset, nset=far, instance=Femur-1
2, 3
*Nset, nset=both
Femur-1.tip, Plate-1.tip
*Elset, elset=e, instance=Plate-1, generate
1, 1, 1
*Surface, type=element, name=under, instance=Femur-1
1, S1
*Surface, type=element, name=skin
Femur-1.solid,
*End Assembly
"""


def test_parts_instances_and_the_assembly(tmp_path):
    deck = deck_of(tmp_path, ASSEMBLY)
    mesh = deck.mesh
    assert {name: (p.nodes.tolist(), p.elements.tolist()) for name, p in deck.parts.items()} == {
        "Femur": ([0, 1, 2, 3, 4], [0]),
        "Plate": ([5, 6, 7], [1]),
    }
    assert mesh.node_ids.tolist() == [1, 2, 3, 4, 9, 1, 2, 3, 1]
    assert {name: members.tolist() for name, members in mesh.node_sets.items()} == {
        "Femur.tip": [3],
        "Plate.tip": [7],
        "point": [8],
        "far": [1, 2],
        "both": [3, 7],
    }
    assert mesh.element_sets["e"].tolist() == [1]
    assert mesh.surfaces["under"].tolist() == [0, 1, 2]
    assert mesh.surfaces["skin"].tolist() == [0, 1, 2, 3]
    one, two = deck.instances
    assert (one.name, one.part, two.part) == ("Femur-1", "Femur", "plate")
    # moved by 10 along x, then turned by 90 degrees about the axis through (10, 0, z)
    points = np.column_stack((deck.coordinates[:4], np.ones(4))) @ one.matrix.T
    assert np.allclose(points[:, :3], [[10, 0, 0], [10, 1, 0], [9, 0, 0], [10, 0, 1]])
    assert np.array_equal(two.matrix, np.eye(4))
    assert deck.part("femur-1") is deck.parts["Femur"]
    with pytest.raises(FemorsError, match=r"has 2 parts \('Femur', 'Plate'\); choose one with --part"):
        deck.part(None)
    assert deck.part("ALL").elements.tolist() == [0, 1]
    assert deck.encoded() == ASSEMBLY.encode()
    moved = np.array(deck.coordinates)
    moved[5] = 7.25  # node 1 of the second part
    out = deck.with_coordinates(moved).encoded().decode()
    head, tail = ASSEMBLY.split("*Part, name=Plate\n*Node\n1, 0, 0, 0\n")
    assert out == head + "*Part, name=Plate\n*Node\n1, 7.25, 7.25, 7.25\n" + tail


def test_sets_in_all_spellings(tmp_path):
    text = TETS + (
        "*NSET, NSET=Of, ELSET=both\n*NSET, NSET=Even\n5\n*NSET, NSET=lacking\n1, 77, nobody\n"
        "*ELSET, ELSET=again, GENERATE\n1, 1000000000000\n*NSET,\nNSET=late\n1\n"
        "*NSET, NSET=unsorted, UNSORTED\n5, 1,\n"
    )
    deck = deck_of(tmp_path, text)
    sets = {name: members.tolist() for name, members in deck.mesh.node_sets.items()}
    assert sets["Of"] == [0, 1, 2, 3, 4]
    assert sets["Even"] == [1, 3, 4]
    assert sets["with blank"] == [1, 3, 4]  # as it was when it was named
    assert sets["lacking"] == sets["late"] == [0]
    assert sets["unsorted"] == [0, 4]
    assert deck.mesh.element_sets["again"].tolist() == [0, 1]
    assert deck.notes == ("the set 'lacking' names 2 that the deck lacks",)


# --- includes -------------------------------------------------------------------------------------
def with_includes(folder: Path) -> tuple[Path, dict[str, bytes]]:
    (folder / "mesh").mkdir(parents=True, exist_ok=True)
    files = {
        "main.inp": b"*HEADING\n*NODE\n1,0,0,0\n*INCLUDE, INPUT=mesh/nodes.txt\n4,0,0,1\n"
        b"*Include, input=mesh\\elements.inc\n*MATERIAL, NAME=A\n*INCLUDE,INPUT=material.inc\n",
        "mesh/nodes.txt": b"2,1,0,0\n3,0,1,0\n",
        "mesh/elements.inc": b"*ELEMENT, TYPE=C3D4\n1,1,2,3,4\n**\n*INCLUDE, INPUT=sets.inc",
        "mesh/sets.inc": b"*NSET, NSET=N\n1,2\n",
        "material.inc": b"*ELASTIC\n1., .3\n",
    }
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder / "main.inp", files


def test_includes_are_read_and_written_beside(tmp_path):
    path, files = with_includes(tmp_path / "in")
    deck = deckfiles.read_deck(path)
    assert deck.mesh.node_ids.tolist() == [1, 2, 3, 4]
    assert deck.mesh.node_sets["N"].tolist() == [0, 1]
    assert [p.relative_to(tmp_path / "in").as_posix() for p in deck.inputs] == [
        *("main.inp", "mesh/nodes.txt", "mesh/elements.inc", "mesh/sets.inc", "material.inc"),
    ]
    moved = deck.with_coordinates(deck.coordinates + [[0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 0, 1]])
    # beside the original, its includes stay as they are: only what did not move can be written there
    with pytest.raises(FemorsError, match=r"nodes.txt' has nodes that moved.*another folder"):
        moved.outputs(tmp_path / "in" / "out.inp")
    assert list(deck.outputs(tmp_path / "in" / "out.inp")) == [tmp_path / "in" / "out.inp"]
    (tmp_path / "out" / "mesh").mkdir(parents=True)
    moved.write(tmp_path / "out" / "new.inp")
    written = {
        p.relative_to(tmp_path / "out").as_posix(): p.read_bytes() for p in (tmp_path / "out").rglob("*.*")
    }
    assert written == {
        "new.inp": files["main.inp"].replace(b"4,0,0,1", b"4,0,0,2.0"),
        "mesh/nodes.txt": b"2,2.0,0,0\n3,0,1,0\n",
        **{name: files[name] for name in ("mesh/elements.inc", "mesh/sets.inc", "material.inc")},
    }
    assert np.array_equal(deckfiles.read_deck(tmp_path / "out" / "new.inp").coordinates, moved.coordinates)
    (tmp_path / "flat").mkdir()
    with pytest.raises(FemorsError, match=r"there is no folder .*mesh"):
        moved.write(tmp_path / "flat" / "new.inp")
    assert list((tmp_path / "flat").iterdir()) == []


def test_a_file_that_is_included_twice(tmp_path):
    (tmp_path / "tet.inc").write_text(
        "*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n*ELEMENT,TYPE=C3D4\n1,1,2,3,4\n"
    )
    text = "".join(f"*PART, NAME=P{i}\n*INCLUDE, INPUT=tet.inc\n*END PART\n" for i in (1, 2))
    deck = deck_of(tmp_path, text)
    assert list(deck.parts) == ["P1", "P2"]
    (tmp_path / "out").mkdir()
    both = deck.with_coordinates(deck.coordinates + 1)
    assert len(both.outputs(tmp_path / "out" / "o.inp")) == 2
    moved = np.array(deck.coordinates)
    moved[0] += 1
    with pytest.raises(FemorsError, match="included twice"):
        deck.with_coordinates(moved).outputs(tmp_path / "out" / "o.inp")


def test_includes_that_cannot_be_read(tmp_path):
    refused(tmp_path, TETS + "*INCLUDE, INPUT=none.inc\n", "line 36", "'none.inc' is not there")
    refused(tmp_path, TETS + "*INCLUDE\n", "line 36", "needs INPUT=")
    refused(tmp_path, TETS + "*INCLUDE, INPUT=deck.inp\n", "line 36", "includes itself")
    (tmp_path / "one.inc").write_text("*INCLUDE, INPUT=two.inc\n")
    (tmp_path / "two.inc").write_text("**\n*INCLUDE, INPUT=one.inc\n")
    with pytest.raises(FemorsError, match=r"two.inc: line 2: 'one.inc' includes itself"):
        deck_of(tmp_path, TETS + "*INCLUDE, INPUT=one.inc\n")
    (tmp_path / "bad.inc").write_text("**\n7, 0, zero, 0\n")
    with pytest.raises(FemorsError, match=r"bad.inc: line 2: 'zero' is not a number"):
        deck_of(tmp_path, "*NODE\n1,0,0,0\n*INCLUDE, INPUT=bad.inc\n")
    (tmp_path / "twin.inc").write_text("3,0,0,0\n")
    with pytest.raises(
        FemorsError, match=r"deck.inp: line 4: node 3 is there already, on line 1 of twin.inc"
    ):
        deck_of(tmp_path, "*NODE\n1,0,0,0\n*INCLUDE, INPUT=twin.inc\n3, 1,1,1\n*ELEMENT,TYPE=S3\n1,1,1,3\n")
    (tmp_path / "many.inc").write_text("**\n")
    refused(tmp_path, TETS + "*INCLUDE, INPUT=many.inc\n" * 1100, "more than 1000 includes")
    (tmp_path / "folder.inc").mkdir()
    with pytest.raises(FemorsError, match="folder"):
        deck_of(tmp_path, TETS + "*INCLUDE, INPUT=folder.inc\n")


def test_a_deck_from_elsewhere_than_the_disk(tmp_path):
    path, files = with_includes(tmp_path)
    stored = {tmp_path / name: data for name, data in files.items()}
    stored[path] = stored[path].replace(b"1,0,0,0", b"1,0,0,-1")
    deck = deckfiles.read_deck(path, stored.__getitem__)
    assert deck.coordinates[0].tolist() == [0, 0, -1]


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


# --- size -----------------------------------------------------------------------------------------
def generated(count: int) -> bytes:
    """Return a deck of `count` nodes and as many tetrahedra."""
    rng = np.random.default_rng(0)
    nodes = np.column_stack((np.arange(1, count + 1), rng.normal(scale=50, size=(count, 3))))
    rows = np.column_stack((np.arange(1, count + 1), rng.integers(1, count + 1, size=(count, 4))))
    text = "%7d,  %.12g,  %.12g,  %.12g\n" * count % tuple(nodes.ravel().tolist())
    more = "%7d,  %d,  %d,  %d,  %d\n" * count % tuple(rows.ravel().tolist())
    return f"*NODE\n{text}*ELEMENT, TYPE=C3D4, ELSET=E\n{more}".encode()


def test_large_decks_are_read_in_pieces_and_grow_with_their_size(tmp_path):
    data = generated(150_000)  # 13 MB
    assert growth(lambda content: deck_of(tmp_path, content), generated(18_750), data) < LINEAR
    deck = deck_of(tmp_path, data)
    assert deck.encoded() is not None
    tracemalloc.start()
    deckfiles.read_deck(tmp_path / "deck.inp")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5 * len(data)


@pytest.mark.parametrize("chunk", [1, 7, 40, 1000])
def test_the_pieces_do_not_matter(tmp_path, monkeypatch, chunk):
    whole = deck_of(tmp_path, TETS)
    monkeypatch.setattr(inp_table, "CHUNK", chunk)
    pieces = deck_of(tmp_path, TETS)
    assert np.array_equal(whole.coordinates, pieces.coordinates)
    assert np.array_equal(whole.mesh.blocks[0].nodes, pieces.mesh.blocks[0].nodes)
    moved = whole.coordinates + 1
    assert whole.with_coordinates(moved).encoded() == pieces.with_coordinates(moved).encoded()


def test_many_comments_are_no_hang(tmp_path):
    def commented(count: int) -> str:
        rows = "".join(f"{i}, {i}, 0, 1\n** comment, 1, 2, 3\n" for i in range(1, count + 1))
        return f"*NODE\n{rows}*ELEMENT, TYPE=S3\n1, 1, 2, 3\n"

    text = commented(40_000)
    assert growth(lambda content: deck_of(tmp_path, content), commented(5_000), text) < LINEAR
    assert len(deck_of(tmp_path, text).coordinates) == 40_000


# --- the knee -------------------------------------------------------------------------------------
@pytest.mark.skipif(not DECKS, reason=f"there are no decks in {KNEE}")
@pytest.mark.parametrize("path", DECKS or [None], ids=lambda path: path and path.stem)
def test_decks_of_the_knee(path, tmp_path):
    deck = deckfiles.read_deck(path)
    content = path.read_bytes()
    assert deck.encoded() == content
    moved = deck.with_coordinates(deck.coordinates * 1.1 + 0.3)
    moved.write(tmp_path / "out.inp")
    again = deckfiles.read_deck(tmp_path / "out.inp")
    assert np.abs(again.coordinates - moved.coordinates).max() < 1e-18
    assert again.with_coordinates(deck.coordinates).mesh.node_sets.keys() == deck.mesh.node_sets.keys()
    out = (tmp_path / "out.inp").read_bytes().split(b"\n")
    changed = [two for one, two in zip(content.split(b"\n"), out, strict=True) if one != two]
    assert len(changed) == len(deck.coordinates)


COUNTS = {
    "bone_femur": (18782, 37560),
    "bone_patella": (1987, 3970),
    "bone_tibia_fibula": (18339, 36566),
    "cartilage_femur_hex": (20584, 14775),
    "cartilage_femur_tet": (11016, 49455),
    "cartilage_patella_hex": (9975, 8064),
    "cartilage_tibia_tet": (1597, 4846),
}


@pytest.mark.skipif(not DECKS, reason=f"there are no decks in {KNEE}")
def test_counts_of_the_knee():
    found = {path.stem: deckfiles.read_deck(path) for path in DECKS}
    assert {name: (len(d.coordinates), d.mesh.element_count) for name, d in found.items()} == COUNTS
    assert [(n, len(p.elements)) for n, p in found["cartilage_tibia_tet"].parts.items()] == [
        *(("CART-TIBIA-LAT", 3057), ("CART-TIBIA-MED", 1789)),
    ]
    assert len(found["cartilage_femur_hex"].mesh.surfaces["FEMUR-ART-SURF"]) == 5146
    assert np.array_equal(np.unique(found["cartilage_tibia_tet"].mesh.bodies), [0, 1])
