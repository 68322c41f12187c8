# SPDX-License-Identifier: GPL-3.0-or-later
"""FEBio files: what is read, that all but coordinates is kept, and what is refused in one line."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from growth import LINEAR, growth

from femors_addon import deckfiles
from femors_addon.deck import Deck
from femors_addon.progress import FemorsError

pytestmark = pytest.mark.filterwarnings("error::DeprecationWarning")

FEB = """<?xml version="1.0" encoding="ISO-8859-1"?>
<febio_spec version="4.0">
\t<!-- Kn\xe9e <node id="1">9,9,9</node> -->
\t<Module type="solid"/>
\t<Material><material id="1" name="M"><E>1e3</E><node id="1">5,5,5</node></material></Material>
\t<Mesh>
\t\t<Nodes name="Object1">
\t\t\t<node id="1">0,0,0</node>
\t\t\t<node id='2' > 1.0e+00, 0.00 ,\t-0</node><node id="3">0,1,0</node>
\t\t</Nodes>
\t\t<Nodes>
\t\t\t<node id="40"
\t\t\t      name="a > b">0,0,1</node>
\t\t\t<node id="50">1,1,1</node>
\t\t</Nodes>
\t\t<Elements type="tet4" name="Part1">
\t\t\t<elem id="1"> 1, 2,3 , 40</elem>
\t\t\t<elem id="7">2,3,40,50</elem>
\t\t</Elements>
\t\t<Elements type="TRI3G3" name="Part2"><elem id="9">1,2,3</elem></Elements>
\t\t<Elements type="truss2" name="Line"><elem id="10">1,2</elem></Elements>
\t\t<NodeSet name="list">1,2,
\t\t\t40</NodeSet>
\t\t<NodeSet name="rows"><n id="3"/><n id="50"/></NodeSet>
\t\t<NodeSet name="range">1:3,40:50:10</NodeSet>
\t\t<ElementSet name="some">7</ElementSet>
\t\t<Surface name="skin"><tri3 id="1">1,3,2</tri3><tri3 id="2">3,2,50</tri3></Surface>
\t</Mesh>
\t<MeshData><ElementData elem_set="Part1"><e lid="1">1,2,3</e></ElementData></MeshData>
</febio_spec>
"""


def deck_of(path: Path, content: str | bytes) -> Deck:
    path = path / "deck.feb"
    path.write_bytes(content if isinstance(content, bytes) else content.encode("latin-1"))
    return deckfiles.read_deck(path)


def test_what_a_file_has(tmp_path):
    deck = deck_of(tmp_path, FEB)
    mesh = deck.mesh
    assert mesh.node_ids.tolist() == [1, 2, 3, 40, 50]
    assert deck.coordinates.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]
    assert [(b.kind, b.type, b.nodes.tolist(), b.ids.tolist()) for b in mesh.blocks] == [
        ("tet4", "tet4", [[0, 1, 2, 3], [1, 2, 3, 4]], [1, 7]),
        ("tri3", "TRI3G3", [[0, 1, 2]], [9]),
    ]
    assert {name: members.tolist() for name, members in mesh.node_sets.items()} == {
        "list": [0, 1, 3],
        "rows": [2, 4],
        "range": [0, 1, 2, 3, 4],
    }
    assert mesh.element_sets["some"].tolist() == [1]
    assert mesh.surfaces["skin"].tolist() == [0, 1, 2, 4]
    assert {name: part.elements.tolist() for name, part in deck.parts.items()} == {
        "Part1": [0, 1],
        "Part2": [2],
    }
    assert deck.notes == ("elements of type truss2 are kept as they are",)


VARIANTS = {
    "as it is": FEB,
    "CRLF": FEB.replace("\n", "\r\n"),
    "no newline at the end": FEB.rstrip(),
    "UTF-8": FEB.replace("ISO-8859-1", "UTF-8").encode("utf-8"),
    "no declaration": FEB.partition("\n")[2].encode("utf-8"),
    "byte order mark": b"\xef\xbb\xbf" + FEB.partition("\n")[2].encode("utf-8"),
    "specification 3": FEB.replace('version="4.0"', 'version="3.0"'),
    "specification 2.5": FEB.replace('version="4.0"', 'version="2.5"').replace("Mesh>", "Geometry>"),
    "one line": re.sub(r"[\t\n]+", " ", FEB).lstrip(),
}


@pytest.mark.parametrize("content", VARIANTS.values(), ids=VARIANTS)
def test_only_coordinates_change(tmp_path, content):
    content = content if isinstance(content, bytes) else content.encode("latin-1")
    deck = deck_of(tmp_path, content)
    assert deck.encoded() == content
    moved = np.array(deck.coordinates)
    moved[1, 2], moved[3] = 1 / 3, [0.1, np.pi, 1.0]
    deck.with_coordinates(moved).write(tmp_path / "out.feb")
    out = (tmp_path / "out.feb").read_bytes()
    tab = b" " if b"\t" not in content else b"\t"
    expected = content.replace(b"0.00 ," + tab + b"-0<", b"0.00 ," + tab + b"0.3333333333333333<")
    expected = expected.replace(b'b">0,0,1<', b'b">0.1,3.141592653589793,1<')
    assert out == expected
    assert np.array_equal(deckfiles.read_deck(tmp_path / "out.feb").coordinates, moved)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("1, 2,3 , 40<", "1, 2,3 , 41<", ("line 17", "element 1 names node 41, which the file lacks")),
        ("2,3,40,50<", "2,3,40<", ("line 18", "element 7 has 3 nodes, and tet4 needs 4")),
        ("2,3,40,50<", "2,3,40,x<", ("line 18", "ids of nodes were expected, not '2,3,40,x'")),
        ("2,3,40,50<", "2,3,,50<", ("line 18", "ids of nodes were expected")),
        ("2,3,40,50<", "2,3, ,50<", ("line 18", "ids of nodes were expected")),
        ('elem id="7"', 'elem id="1"', ("line 18", "element 1 is there already, on line 17")),
        ('elem id="7"', "elem", ("line 18", "the id of an element was expected")),
        ('node id="50"', 'node id="40"', ("line 14", "node 40 is there already, on line 12")),
        ('node id="50"', 'node id="0"', ("line 14", "the id of a node was expected")),
        (">1,1,1<", ">1,1<", ("line 14", "x,y,z of node 50 were expected, not '1,1'")),
        (">1,1,1<", ">1,,1<", ("line 14", "x,y,z of node 50 were expected")),
        (">1,1,1<", ">1, ,1<", ("line 14", "x,y,z of node 50 were expected")),
        (">1,1,1<", "><", ("line 14", "x,y,z of node 50 were expected, not ''")),
        (">1,1,1<", ">1,1,1e999<", ("line 14", "not finite")),
        (">1,1,1<", ">nan,1,1<", ("line 14", "x,y,z of node 50 were expected")),
        (">1,1,1<", ">1,<!-- 1 -->1,1<", ("line 14", "x,y,z of node 50 were expected")),
        (">1,1,1<", ">1,&#49;,1<", ("line 14", "x,y,z of node 50 were expected")),
        (">1,1,1</node>", ">1,1,1</nod>", ("line 14", "not proper XML (mismatched tag)")),
        ("</febio_spec>", "", ("not proper XML",)),
        ("febio_spec", "other_spec", ("line 2", "<febio_spec> was expected, not <other_spec>")),
        ("<Mesh>", '<Mesh from="mesh.feb">', ("line 6", "stands in the file 'mesh.feb'")),
        (
            '<?xml version="1.0" encoding="ISO-8859-1"?>',
            '<!DOCTYPE a [<!ENTITY b "c">]>',
            ("line 1", "DOCTYPE"),
        ),
        ("ISO-8859-1", "UTF-16", ("",)),
        ("ISO-8859-1", "klingon", ("",)),
        ("<Mesh>", "<Meshes>", ("",)),
    ],
)
def test_faults_are_named_with_their_line(tmp_path, old, new, words):
    assert old in FEB
    with pytest.raises(FemorsError) as caught:
        deck_of(tmp_path, FEB.replace(old, new))
    text = str(caught.value)
    assert text.startswith(str(tmp_path / "deck.feb")), text
    assert "\n" not in text
    for word in words:
        assert word in text, text


def test_files_that_are_no_decks(tmp_path):
    bomb = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
        f'<!ENTITY {chr(98 + i)} "{f"&{chr(97 + i)};" * 10}">' for i in range(20)
    )
    for content, words in (
        ("", "is empty"),
        ("text", "not proper XML"),
        (b"\x89PNG\0", "binary"),
        (FEB.encode("utf-16"), "UTF-16"),
        ("<febio_spec/>", "has no nodes"),
        ("<febio_spec><Mesh><Nodes/></Mesh></febio_spec>", "has no nodes"),
        (re.sub("(?s)<Elements.*</Elements>", "", FEB), "no elements with a surface"),
        (bomb + "]><febio_spec>&u;</febio_spec>", "DOCTYPE"),
        ("<a>" * 100_000, "<febio_spec> was expected"),
    ):
        with pytest.raises(FemorsError, match=words):
            deck_of(tmp_path, content)


def test_notes(tmp_path):
    assert deck_of(tmp_path, FEB.replace('"4.0"', '"9.9"')).notes[0].startswith("FEBio 9.9")
    deck = deck_of(tmp_path, FEB.replace("1:3,40", "1:3,77,40"))
    assert "the set 'range' names 1 that the file lacks" in deck.notes


def large(count: int) -> str:
    """Return a deck of `count` nodes."""
    nodes = "".join(f'<node id="{i}">{i},{i % 7}.25,{i % 11}e-2</node>\n' for i in range(1, count + 1))
    rows = "".join(f'<elem id="{i}">{i},{i + 1},{i + 2},{i + 3}</elem>\n' for i in range(1, count - 3))
    text = f'<febio_spec version="4.0"><Mesh><Nodes>{nodes}</Nodes><Elements type="tet4">{rows}</Elements>'
    return text + "</Mesh></febio_spec>"


def test_reading_grows_with_the_file_and_no_faster(tmp_path):
    small, big = large(5_000), large(40_000)
    assert growth(lambda text: deck_of(tmp_path, text), small, big) < LINEAR
    deck = deck_of(tmp_path, big)
    assert list(deck.parts) == ["elements"]
    assert deck.coordinates[-1].tolist() == [40_000, 40_000 % 7 + 0.25, (40_000 % 11) / 100]
