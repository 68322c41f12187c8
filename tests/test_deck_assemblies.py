# SPDX-License-Identifier: GPL-3.0-or-later
"""Sets, "all" and parts of an Abaqus deck stand where the assembly places their parts, in every command."""

from __future__ import annotations

import json

import numpy as np
import pytest
from commands import refused, run
from solids import hexes

from femors_addon import cli_bodies, inp, meshfiles
from femors_addon.meshfiles import MeshFile
from femors_addon.progress import FemorsError
from femors_addon.transforms import transformed

FAR = "100., 20., 0.\n100., 20., 0., 100., 20., 1., 30."
BLOCK = hexes((4, 4, 4), (10, 12, 14), bend=0.02)
BOTH = ("*ELSET, ELSET=BOTH", "P-1.HALFP, Q-1.HALFQ")
STRETCH = np.array([1.1, 1.0, 0.9])


def mesh(name, block=BLOCK):
    """The lines of nodes and of elements in the sets E<name> and, for half of them, HALF<name>."""
    count = len(block.blocks[0])
    return [
        f"*NODE, NSET=N{name}",
        *(f"{i + 1}, {x!r}, {y!r}, {z!r}" for i, (x, y, z) in enumerate(block.nodes.tolist())),
        f"*ELEMENT, TYPE=C3D8, ELSET=E{name}",
        *(f"{i + 1}, " + ", ".join(map(str, row)) for i, row in enumerate(block.blocks[0].nodes + 1)),
        f"*ELSET, ELSET=HALF{name}, GENERATE",
        f"1, {count // 2}",
    ]


def part(name):
    return [f"*PART, NAME={name}", *mesh(name), "*END PART"]


def placed(name, of, where=""):
    return [f"*INSTANCE, NAME={name}, PART={of}", *where.splitlines(), "*END INSTANCE"]


def assembly(path, parts, instances, sets=()):
    lines = [line for name in parts for line in part(name)] + ["*ASSEMBLY, NAME=A"]
    lines += [line for one in instances for line in placed(*one)] + [*sets, "*END ASSEMBLY"]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def one(tmp_path):
    """A part that stands far from where its own coordinates are, turned."""
    return assembly(tmp_path / "one.inp", "P", [("P-1", "P", FAR)])


@pytest.fixture
def two(tmp_path):
    """Two parts that stand in different places, and a set of elements of both."""
    return assembly(tmp_path / "two.inp", "PQ", [("P-1", "P", FAR), ("Q-1", "Q", "0., 50., 0.")], BOTH)


def place(path, name):
    deck = inp.read(path)
    return deck.placement(name, deck.part(name))


def surface_file(path, vertices):
    meshfiles.write(path, MeshFile.of(BLOCK.surface()[0].moved(vertices)))
    return path


@pytest.mark.parametrize("name", ["P", "p-1", "EP", "halfp", "NP", "all", None])
def test_whatever_lies_in_one_part_stands_where_that_part_stands(one, name):
    (instance,) = inp.read(one).instances
    assert not np.array_equal(instance.matrix, np.eye(4))
    assert np.array_equal(place(one, name), instance.matrix)


def test_sets_of_several_parts_stand_where_theirs_does(two):
    first, second = inp.read(two).instances
    for name, instance in {"P": first, "EP": first, "HALFP": first, "EQ": second, "NQ": second}.items():
        assert np.array_equal(place(two, name), instance.matrix), name


@pytest.mark.parametrize("name", ["all", "BOTH"])
def test_what_spans_parts_in_different_places_is_refused(two, name):
    with pytest.raises(FemorsError) as told:
        place(two, name)
    words = f"'{name}' is of parts that stand in different places ('P', 'Q'); name one of these parts"
    assert str(told.value) == f"{two}: {words} with --part"


@pytest.mark.parametrize("name", ["all", "BOTH"])
def test_what_spans_parts_in_one_place_stands_there(tmp_path, name):
    path = assembly(tmp_path / "same.inp", "PQ", [("P-1", "P", FAR), ("Q-1", "Q", FAR)], BOTH)
    assert np.array_equal(place(path, name), inp.read(path).instances[0].matrix)


def test_a_part_without_an_instance_stays_and_so_is_elsewhere(tmp_path):
    path = assembly(tmp_path / "left.inp", "PQ", [("P-1", "P", FAR)])
    assert np.array_equal(place(path, "EQ"), np.eye(4))
    with pytest.raises(FemorsError, match="'all' is of parts that stand in different places"):
        place(path, "all")


@pytest.mark.parametrize("name", ["P", "EP", "HALFP", "NP", "all"])
def test_a_set_of_a_part_in_several_places_is_as_ambiguous_as_the_part(tmp_path, name):
    path = assembly(tmp_path / "twice.inp", "P", [("P-1", "P", FAR), ("P-2", "P")])
    with pytest.raises(FemorsError, match=r"stands in 2 places \('P-1', 'P-2'\); choose one of these"):
        place(path, name)
    for instance in inp.read(path).instances:
        assert np.array_equal(place(path, instance.name), instance.matrix)
    there = assembly(tmp_path / "there.inp", "P", [("P-1", "P", FAR), ("P-2", "P", FAR)])
    assert np.array_equal(place(there, name), inp.read(there).instances[0].matrix)


def test_an_instance_with_a_mesh_of_its_own_is_placed(tmp_path):
    """As Abaqus/CAE writes independent instances: the part is empty."""
    *begin, end = placed("P-1", "P", FAR)
    lines = ["*PART, NAME=P", "*END PART", "*ASSEMBLY, NAME=A", *begin, *mesh("P"), end, "*END ASSEMBLY"]
    path = tmp_path / "own.inp"
    path.write_text("\n".join(lines) + "\n")
    for name in ("P-1", "EP", "all", None):
        assert np.array_equal(place(path, name), inp.read(path).instances[0].matrix), name


def test_decks_without_an_assembly_stay_as_they_are(tmp_path):
    path = tmp_path / "plain.inp"
    path.write_text("\n".join(mesh("P")) + "\n")
    for name in ("EP", "HALFP", "all", None):
        assert np.array_equal(place(path, name), np.eye(4)), name


@pytest.mark.parametrize("name", ["EP", "all"])
def test_a_morph_of_a_set_ends_where_the_target_is(one, tmp_path, capsys, name):
    matrix = inp.read(one).instances[0].matrix
    surface, at = BLOCK.surface()
    own = surface.vertices * STRETCH
    target, out = surface_file(tmp_path / "target.ply", transformed(matrix, own)), tmp_path / "out.inp"
    # the deck as source, then as target
    argv = ("morph", one, target, "-o", out, "--part", name, "--align", "none", "--quiet")
    assert run(capsys, *argv)[0] == 0
    assert np.abs(inp.read(out).coordinates[at] - own).max() < 0.5
    source, out = surface_file(tmp_path / "source.ply", transformed(matrix, own)), tmp_path / "out.ply"
    argv = ("morph", source, one, "-o", out, "--target-part", name, "--align", "none", "--quiet")
    assert run(capsys, *argv)[0] == 0
    assert np.abs(meshfiles.read(out).vertices - transformed(matrix, surface.vertices)).max() < 0.5


def test_a_morph_of_parts_in_different_places_is_refused_by_its_option(two, tmp_path, capsys):
    target = surface_file(tmp_path / "target.ply", BLOCK.surface()[0].vertices)
    out = tmp_path / "out.inp"
    err = refused(capsys, "morph", two, target, "-o", out, "--part", "all")
    assert "in different places ('P', 'Q'); name one of these parts with --part\n" in err
    err = refused(capsys, "morph", target, two, "-o", tmp_path / "out.ply", "--target-part", "BOTH")
    assert "name one of these parts with --target-part\n" in err
    assert not out.exists() and not (tmp_path / "out.ply").exists()


def test_what_is_carried_is_laid_onto_a_set_where_it_stands(one, tmp_path, capsys):
    matrix = inp.read(one).instances[0].matrix
    there = transformed(matrix, BLOCK.surface()[0].vertices)
    a, b = surface_file(tmp_path / "a.ply", there), surface_file(tmp_path / "b.ply", there + 0.5)
    field = tmp_path / "field.npz"
    argv = ("morph", a, b, "-o", tmp_path / "c.ply", "--field", field, "--align", "none", "--quiet")
    assert run(capsys, *argv)[0] in (0, 1)
    for name in ("EP", "all"):
        folder = tmp_path / name
        options = ("--project", one, "--project-part", name, "--quiet")
        code, _, err = run(capsys, "transfer", field, a, "-o", folder, *options)
        assert code in (0, 1), err
        (file,) = folder.glob("*.ply")
        assert np.abs(meshfiles.read(file).vertices - there).max() < 3.0, "the set stands at its instance"


def test_bodies_stand_where_their_parts_do_and_need_one_place(two, tmp_path):
    source = cli_bodies.read(str(two))
    for frame, instance in zip(source.frames, inp.read(two).instances, strict=True):
        assert np.array_equal(frame, instance.matrix)
    # an instance that is named like its part is one of two places all the same
    path = assembly(tmp_path / "twice.inp", "P", [("P", "P", FAR), ("P-2", "P")])
    with pytest.raises(FemorsError, match="'P' in several places; a body needs a part of its own"):
        cli_bodies.read(str(path))


def figures(capsys, folder, *argv):
    report = folder / "q.json"
    code, _, err = run(capsys, "quality", *argv, "--report", report, "--quiet")
    assert code == 0, err
    return json.loads(report.read_text())


@pytest.mark.parametrize("name", ["P", "P-1", "EP", "all"])
def test_quality_measures_a_part_where_it_stands(one, tmp_path, capsys, name):
    matrix = inp.read(one).instances[0].matrix
    other = surface_file(tmp_path / "other.ply", transformed(matrix, BLOCK.surface()[0].vertices))
    alone = figures(capsys, tmp_path, one, "--part", name)
    beside = figures(capsys, tmp_path, one, other, "--part", name)
    swapped = figures(capsys, tmp_path, other, one, "--other-part", name)
    for found in (beside["against"], swapped["against"]):
        assert found["mesh_to_other"]["maximum"] < 1e-4 and found["other_to_mesh"]["maximum"] < 1e-4
        assert found["overlap"]["dice"] > 0.99
    assert beside["mesh"] == alone["mesh"] and beside["elements"] == alone["elements"]
    plain = tmp_path / "plain.inp"
    plain.write_text("\n".join(mesh("P")) + "\n")
    own = figures(capsys, tmp_path, plain)
    assert beside["mesh"]["volume"] == pytest.approx(own["mesh"]["volume"], rel=1e-9)
    assert beside["shape"]["skewness"] == pytest.approx(own["shape"]["skewness"], rel=1e-9)
    assert beside["elements"] == own["elements"]


def test_quality_of_a_part_alone_needs_no_place(two, tmp_path, capsys):
    path = assembly(tmp_path / "twice.inp", "P", [("P-1", "P", FAR), ("P-2", "P")])
    assert figures(capsys, tmp_path, path, "--part", "EP")["elements"]
    other = surface_file(tmp_path / "other.ply", BLOCK.surface()[0].vertices)
    assert "'EP' stands in 2 places" in refused(capsys, "quality", path, other, "--part", "EP")
    err = refused(capsys, "quality", other, two, "--other-part", "all")
    assert "name one of these parts with --other-part\n" in err
    assert figures(capsys, tmp_path, two, "--part", "all")["elements"]
