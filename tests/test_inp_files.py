# SPDX-License-Identifier: GPL-3.0-or-later
"""Abaqus decks of several files, and of a million lines."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from decktexts import TETS, deck_of, refused
from growth import LINEAR, growth

from femors_addon import deckfiles, inp_table
from femors_addon.progress import FemorsError


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
