# SPDX-License-Identifier: GPL-3.0-or-later
"""Abaqus decks: what is read, that all but coordinates is kept, and what is refused in one line."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest
from decktexts import ASSEMBLY, TETS, deck_of

from femors_addon import deckfiles
from femors_addon.progress import FemorsError

KNEE = Path(os.environ.get("FEMORS_DATA", Path(__file__).parent.parent.parent / "shared" / "data")) / "knee"
pytestmark = pytest.mark.filterwarnings("error::DeprecationWarning")
DECKS = sorted(KNEE.glob("*.inp"))


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
