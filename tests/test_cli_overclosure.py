# SPDX-License-Identifier: GPL-3.0-or-later
"""``femors overclosure``: what goes in comes out under its own name, and nothing else is touched."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path

import numpy as np
import pytest
from solids import hexes, moved, sphere

from femors_addon import deckfiles, meshfiles
from femors_addon.cli import main
from femors_addon.meshfiles import MeshFile
from femors_addon.volume import Block, VolumeMesh


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two spheres that overlap, one that does not, and a deck of two plates that do."""
    for name, by in (("one", (0, 0, 0)), ("two", (17, 1, 2)), ("far", (0, 60, 0))):
        meshfiles.write(tmp_path / f"{name}.stl", MeshFile.of(moved(sphere(2), by)))
    low = hexes((8, 8, 3), (20, 20, 2))
    high = hexes((7, 7, 3), (20, 20, 2), centre=(1.0, 0.5, 1.7))
    count = len(low.nodes)
    blocks = (low.blocks[0], Block("hex8", high.blocks[0].nodes + count, high.blocks[0].ids + 10_000))
    nodes = np.concatenate((low.nodes, high.nodes))
    both = VolumeMesh(nodes, blocks, np.arange(len(nodes)) + 1)
    parts = {
        "LOW": np.arange(len(low.blocks[0])),
        "HIGH": len(low.blocks[0]) + np.arange(len(high.blocks[0])),
    }
    (tmp_path / "plates.inp").write_bytes(deckfiles.WRITERS[".inp"](both, parts, ".inp"))
    return tmp_path


def run(*words: object) -> int:
    return main(["overclosure", *map(str, words)])


def test_a_doubt_about_units_comes_after_the_verdict_of_a_check(folder):
    meshfiles.write(folder / "vast.stl", MeshFile.of(moved(sphere(2, 10_000.0), (0, 20_000, 0))))
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        assert run("--check", folder / "one.stl", folder / "vast.stl") == 0
    lines = said.getvalue().splitlines()
    verdict = lines.index("no overclosure among 2 bodies")
    assert any("in one unit of length?" in line for line in lines[verdict + 1 :])


@pytest.mark.parametrize("quiet", [[], ["--quiet"]])
def test_a_body_that_lost_much_is_named_though_the_exit_code_is_0(folder, capsys, quiet):
    meshfiles.write(folder / "deep.stl", MeshFile.of(moved(sphere(2), (13, 1, 2))))
    files = (folder / "one.stl", folder / "deep.stl", "--rigid", "one", "-o", folder / "out")
    assert run(*files, "--report", folder / "r.json", *quiet) == 0
    (line,) = (line for line in capsys.readouterr().err.splitlines() if "WARNING" in line)
    report = json.loads((folder / "r.json").read_text())
    volume = report["bodies"][1]["volume"]
    share = 100 * (1 - volume["after"] / volume["before"])
    assert share > 10 and line.startswith(f"femors: WARNING: 'deep' has lost {share:.1f} % of its volume (")
    assert f"femors: WARNING: {report['warnings'][0]}" == line


def test_two_files_come_back_apart(folder, capsys):
    out = folder / "out"
    assert run(folder / "one.stl", folder / "two.stl", "-o", out, "--report", folder / "r.json") == 0
    said = capsys.readouterr()
    assert "CERTIFIED" in said.out and "WARNING" not in said.err
    assert sorted(path.name for path in out.iterdir()) == ["one.stl", "two.stl"]
    report = json.loads((folder / "r.json").read_text())
    assert report["certified"] is True
    assert report["pairs"]["before"][0]["crossings"] > 0
    assert report["pairs"]["after"][0]["least"] >= 0.01 - 1e-5
    before, after = (meshfiles.read(path / "one.stl") for path in (folder, out))
    assert np.array_equal(before.corners, after.corners)
    assert (before.vertices != after.vertices).any()
    # what came out is clear, and goes through unchanged to the byte
    again = folder / "again"
    assert run(out / "one.stl", out / "two.stl", "-o", again) == 0
    assert "nothing had to be moved" in capsys.readouterr().out
    for name in ("one.stl", "two.stl"):
        assert (again / name).read_bytes() == (out / name).read_bytes()


def test_a_rigid_body_is_written_as_it_came(folder):
    out = folder / "out"
    assert run(folder / "one.stl", folder / "two.stl", "--rigid", "one", "-o", out) == 0
    assert (out / "one.stl").read_bytes() == (folder / "one.stl").read_bytes()
    assert (out / "two.stl").read_bytes() != (folder / "two.stl").read_bytes()


def test_the_parts_of_a_deck_are_bodies_and_come_back_as_one_deck(folder, capsys):
    out = folder / "out"
    deck = folder / "plates.inp"
    assert run(deck, "--rigid", "plates:LOW", "-o", out, "--report", folder / "r.json") == 0
    report = json.loads((folder / "r.json").read_text())
    assert [body["name"] for body in report["bodies"]] == ["plates:LOW", "plates:HIGH"]
    before, after = (deckfiles.read_deck(path / "plates.inp") for path in (folder, out))
    moved_nodes = (before.coordinates != after.coordinates).any(axis=1)
    assert not moved_nodes[before.parts["LOW"].nodes].any()
    assert moved_nodes[before.parts["HIGH"].nodes].any()
    lines = [path.read_text().splitlines() for path in (deck, out / "plates.inp")]
    assert len(lines[0]) == len(lines[1])
    assert sum(a != b for a, b in zip(*lines, strict=True)) == moved_nodes.sum()
    capsys.readouterr()
    assert run("--check", out / "plates.inp") == 0
    assert "no overclosure among 2 bodies" in capsys.readouterr().out


def test_the_name_of_a_deck_means_all_of_its_parts(folder, capsys):
    """Excluded from another body, from itself, or all rigid."""
    deck, report = folder / "plates.inp", folder / "r.json"
    low = deckfiles.read_deck(deck)
    mesh, _ = low.submesh(low.parts["LOW"])
    across, _ = mesh.surface()
    meshfiles.write(folder / "wall.stl", MeshFile.of(across.moved(across.vertices[:, [2, 1, 0]])))
    check = "--check", deck, folder / "wall.stl", "--report", report

    def pairs() -> set[tuple[str, str]]:
        return {(pair["one"], pair["two"]) for pair in json.loads(report.read_text())["pairs"]}

    run(*check)
    inside = ("plates:LOW", "plates:HIGH")
    assert pairs() == {inside, ("plates:LOW", "wall"), ("plates:HIGH", "wall")}
    run(*check, "--exclude", "plates,wall")
    assert pairs() == {inside}
    run(*check, "--exclude", "plates,plates")
    assert pairs() == {("plates:LOW", "wall"), ("plates:HIGH", "wall")}
    run(*check, "--pair-gap", "wall,plates=0.125")
    gaps = {pair["gap"] for pair in json.loads(report.read_text())["pairs"] if "wall" in pair.values()}
    assert gaps == {0.125}
    capsys.readouterr()
    assert run(deck, "--rigid", "plates", "-o", folder / "out") == 2
    assert "every body is rigid" in capsys.readouterr().err


def test_shares_and_exclusions(folder, capsys):
    report = folder / "r.json"
    files = folder / "one.stl", folder / "two.stl"
    assert run(*files, "--share", "one=0.2", "-o", folder / "a", "--report", report) == 0
    one, two = json.loads(report.read_text())["bodies"]
    assert (one["share"], two["share"]) == (0.2, 0.8)
    assert one["movement"]["maximum"] < 0.4 * two["movement"]["maximum"]
    assert run(*files, "--exclude", "two,one", "-o", folder / "b") == 0
    assert (folder / "b" / "two.stl").read_bytes() == (folder / "two.stl").read_bytes()
    out = capsys.readouterr().out
    assert "no two other bodies are near each other; 1 excluded pair may overlap" in out
    page = folder / "r.html"
    assert run("--check", *files, "--exclude", "two,one", "--report", page) == 0
    assert "no overclosure among 2 bodies (1 excluded pair not looked at)" in capsys.readouterr().out
    assert "Overclosure of 2 bodies" in page.read_text() and "Excluded" in page.read_text()
    assert run(*files, "--pair-gap", "one,two=0.5", "-o", folder / "c", "--report", report) == 0
    assert json.loads(report.read_text())["pairs"]["after"][0]["least"] >= 0.5 - 1e-5
    capsys.readouterr()


def test_the_page_shows_the_bodies_before_and_after(folder, capsys):
    """Surfaces and decks: pictures of all, of what moved and of gaps, and histograms."""
    page = folder / "r.html"
    for inputs, names in (
        (["one.stl", "two.stl"], ["one", "two"]),
        (["plates.inp"], ["plates:LOW", "plates:HIGH"]),
    ):
        files = [folder / name for name in inputs]
        assert run(*files, "-o", folder / "out", "--report", page) == 0
        text = page.read_text()
        assert text.count("<img") == 2 * 2 + len(names) * 3 * 2
        assert "All bodies before" in text and "All bodies after, a quarter turn on" in text
        assert "Which is which." in text
        for name in names:
            assert f"{name}: how far its nodes were moved." in text
            assert f"{name}, after: gap to the nearest other body" in text
        assert run("--check", *files, "--report", page) == 1
        assert page.read_text().count("<img") == 2 + len(names) * 2
    capsys.readouterr()


def test_the_check_writes_nothing_but_its_report(folder, capsys):
    before = sorted(folder.iterdir())
    names = [folder / f"{name}.stl" for name in ("one", "two", "far")]
    assert run("--check", *names, "--report", folder / "r.json") == 1, "a script has to see it"
    said = capsys.readouterr()
    assert "one - two: overlap" in said.out and said.err.endswith("femors: 1 pair overlaps or is too near\n")
    assert "far" not in said.out
    assert sorted(folder.iterdir()) == sorted([*before, folder / "r.json"])
    report = json.loads((folder / "r.json").read_text())
    assert report["clear"] is False and report["verdict"] == "1 pair overlaps or is too near"
    assert report["settings"] == {"gap": 0.01}
    assert report["pairs"][0]["depth"] == pytest.approx(2.8, abs=0.4)  # of flat faces


def test_what_is_not_reached_is_written_and_told(folder, capsys):
    meshfiles.write(folder / "in.stl", MeshFile.of(sphere(2, 3.0)))
    assert run(folder / "one.stl", folder / "in.stl", "-o", folder / "out") == 1
    caught = capsys.readouterr()
    assert "not reached: 'one' and 'in'" in caught.err
    assert "lies inside" in caught.err
    assert (folder / "out" / "in.stl").read_bytes() == (folder / "in.stl").read_bytes()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["one.stl", "two.stl"], "-o OUTDIR is needed"),
        (["one.stl", "-o", "out"], "at least two"),
        (["one.stl", "one.stl", "-o", "out"], "one"),
        (["one.stl", "two.stl", "-o", "out", "--gap", "-1"], "--gap: -1.0 is outside"),
        (["one.stl", "two.stl", "-o", "out", "--rigid", "three"], "there is no such body"),
        (["one.stl", "two.stl", "-o", "out", "--share", "one"], "NAME=S is needed"),
        (["one.stl", "two.stl", "-o", "out", "--share", "one=x"], "is not a number"),
        (["one.stl", "two.stl", "-o", "out", "--share", "one=2"], "from 0"),
        (["one.stl", "two.stl", "-o", "out", "--exclude", "one"], "two names with a comma"),
        (["one.stl", "two.stl", "-o", "out", "--exclude", "one,x"], "no body 'x'"),
        (["one.stl", "two.stl", "-o", "out", "--rigid", "one", "--rigid", "two"], "every body is rigid"),
        (["one.stl", "none.stl", "-o", "out"], "none.stl"),
        (["one.stl", "two.xyz", "-o", "out"], "not a known kind"),
        (["one.stl", "two.stl", "-o", "out", "--check"], "leave out -o, or --check"),
        (["one.stl", "two.stl", "-o", "one.stl"], "one.stl: is a file; name a folder"),
        (["one.stl", "two.stl", "-o", "."], "is also an input"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(folder, monkeypatch, capsys, words, said):
    monkeypatch.chdir(folder)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert run(*words) == 2
    caught = capsys.readouterr()
    assert said in caught.err
    assert caught.err.count("\n") == 1
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
