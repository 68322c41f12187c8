# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the command line writes to, when that is full or may not be written to."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import told

from femors_addon import cli, meshfiles
from femors_addon.meshfiles import MeshFile
from femors_addon.shapes import pair

QUICK = ("--iterations", "2", "--quiet")
ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture()
def folder(tmp_path, monkeypatch):
    """A folder with two bones, to be in."""
    bones = pair(500, 550)
    for name, bone in (("a.obj", bones.source), ("b.obj", bones.target)):
        meshfiles.write(
            tmp_path / name, MeshFile(bone.vertices, np.full(len(bone.faces), 3), bone.faces.ravel())
        )
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture()
def field(folder):
    assert cli.main(["morph", "a.obj", "b.obj", "-o", "o.obj", "--field", "f.npz", "--quiet"]) == 0
    return "f.npz"


def refused(capsys, *argv: str) -> str:
    capsys.readouterr()
    assert cli.main(list(argv)) == 2
    out, err = capsys.readouterr()
    err = told(err)
    assert out == "" and err.startswith("femors: ") and err.count("\n") == 1, err
    return err


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is always full")
@pytest.mark.parametrize(
    ("argv", "end"),
    [
        (["morph", "a.obj", "b.obj", "-o", "o.obj"], "; the result is written\n"),
        (["quality", "a.obj"], "(no space left on device)\n"),
    ],
)
def test_a_disk_that_is_full_below_stdout(folder, argv, end):
    """Not a defect of FEMORS, and not a success: a log without its figures."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    with open("/dev/full", "w", encoding="utf-8") as full:
        done = subprocess.run(
            [sys.executable, "-m", "femors_addon", *argv],
            env=environment,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=60,
            check=False,
        )
    assert done.returncode == 1
    said = told(done.stderr)
    assert said.startswith("femors: the figures could not be written to stdout"), done.stderr
    assert said.endswith(end) and said.count("\n") == 1
    assert (folder / "o.obj").exists() == ("morph" in argv)


@pytest.mark.parametrize("full", ["o.obj", "r.json", "f.npz"])
def test_a_disk_that_is_full_below_a_file_names_it(folder, capsys, monkeypatch, full):
    write = Path.write_bytes

    def nearly(path: Path, data: bytes) -> int:
        if path.suffix != Path(full).suffix:
            return write(path, data)
        write(path, data[:10])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", nearly)
    err = refused(
        capsys, *("morph", "a.obj", "b.obj", "-o", "o.obj", "--report", "r.json", "--field", "f.npz")
    )
    assert err.startswith(f"femors: {full}: cannot be written (no space left"), err
    assert sorted(os.listdir()) == ["a.obj", "b.obj"]


def test_a_folder_that_cannot_be_made_is_told_before_the_work(folder, field, capsys, monkeypatch):
    """As root may write anywhere, the folder is asked for below a file."""
    (folder / "file").write_text("no folder")

    def never(*args, **kwargs):
        raise AssertionError("the work was begun")

    monkeypatch.setattr(cli.cli_overclosure, "remove_overclosure", never)
    monkeypatch.setattr(cli.cli_transfer, "Transfer", never)
    for argv in (["overclosure", "a.obj", "b.obj"], ["transfer", field, "a.obj"]):
        assert "file/out: cannot be made" in refused(capsys, *argv, "-o", "file/out")


@pytest.mark.parametrize(
    "argv",
    [
        ["morph", "a.obj", "b.obj", "-o", "none/o.obj"],
        ["morph", "a.obj", "b.obj", "-o", "o.obj", "--field", "none/f.npz"],
        ["convert", "a.obj", "-o", "none/o.stl"],
        ["quality", "a.obj", "--report", "none/r.json"],
        ["landmarks", "a.obj", "b.obj", "m.csv", "-o", "none/o.csv"],
        ["overclosure", "a.obj", "b.obj", "-o", "new", "--report", "none/r.json"],
        ["transfer", "f.npz", "a.obj", "-o", "new", "--table", "none/t.csv"],
    ],
)
def test_only_a_folder_that_is_asked_for_is_made(folder, capsys, argv):
    """`-o OUTDIR` makes one; a file in a missing folder is refused in the same words everywhere."""
    Path("m.csv").write_text("a,1,2,3\n")
    before = sorted(folder.rglob("*"))
    assert f"there is no folder {folder / 'none'}; make it first" in refused(capsys, *argv)
    assert sorted(folder.rglob("*")) == before


def test_a_report_may_stand_in_the_folder_that_is_made(folder, field):
    argv = ["transfer", field, "a.obj", "-o", "new", "--report", "new/r.json", "--quiet"]
    assert cli.main(argv) == 0
    assert sorted(os.listdir("new")) == ["a.obj", "r.json"]


def test_a_folder_that_was_made_goes_again(folder, capsys, monkeypatch):
    def fails(path: Path, data: bytes) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", fails)
    assert "no space left" in refused(capsys, "overclosure", "a.obj", "b.obj", "-o", "new", *QUICK)
    assert not (folder / "new").exists()


@pytest.mark.parametrize(
    "argv",
    [
        ("quality", "huge.obj"),
        ("quality", "a.obj", "huge.obj"),
        ("morph", "huge.obj", "b.obj", "-o", "o.obj"),
        ("morph", "a.obj", "huge.obj", "-o", "o.obj"),
        ("overclosure", "a.obj", "huge.obj", "-o", "out"),
        ("transfer", "FIELD", "huge.obj", "-o", "out"),
        ("transfer", "FIELD", "huge.csv", "-o", "out"),
        ("quality", "huge.inp"),
        ("morph", "huge.inp", "b.obj", "-o", "o.inp"),
        ("overclosure", "a.obj", "huge.inp", "-o", "out"),
    ],
)
def test_coordinates_that_cannot_be_squared_are_refused(folder, field, capsys, argv):
    """One line, and no warning of NumPy (pytest makes it an error)."""
    bone = meshfiles.read("a.obj")
    vertices = np.array(bone.vertices)
    vertices[5, 1] = -1e120
    meshfiles.write("huge.obj", bone.with_vertices(vertices))
    Path("huge.csv").write_text("a,1,2,3\nb,4,5,1e120\n")
    nodes = "1, 0, 0, 0\n2, 1, 0, 0\n3, 0, 1, 0\n4, 0, 0, 1e120\n"
    Path("huge.inp").write_text(f"*NODE\n{nodes}*ELEMENT, TYPE=C3D4, ELSET=A\n1, 1, 2, 3, 4\n")
    before = sorted(folder.rglob("*"))
    err = refused(capsys, *(field if word == "FIELD" else word for word in argv))
    assert "with coordinates beyond 1e+30 (first: " in err
    assert sorted(folder.rglob("*")) == before
