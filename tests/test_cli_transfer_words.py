# SPDX-License-Identifier: GPL-3.0-or-later
"""What the command line says of landmarks and meshes that do not belong where a field carries them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from commands import run
from fieldcases import BONE, STEPS, field, write_files

from femors_addon import keptfield, meshfiles, shapes
from femors_addon.carry import Carrier
from femors_addon.mesh import Surface
from femors_addon.meshfiles import MeshFile
from femors_addon.transfer import Transfer
from femors_addon.transfer_settings import TransferSettings


@pytest.fixture()
def files(tmp_path: Path) -> Path:
    """A field, a site, a deck and landmarks, in a folder."""
    return write_files(tmp_path)


@pytest.mark.parametrize("factor", [0.001, 1000.0])
def test_landmarks_in_another_unit_are_written_and_told(files, capsys, factor):
    """In one line: it explains all else that is odd of them."""
    lines = [f"{x!r},{y!r},{z!r}" for x, y, z in (factor * BONE.vertices[::150]).tolist()]
    (files / "odd.csv").write_text("\n".join([*lines, ""]))
    words = f"were they 1000 times {'larger' if factor < 1 else 'smaller'}"
    code, _, err = run(capsys, "transfer", files / "f.npz", files / "odd.csv", "-o", files / "out")
    assert code == 1 and words in err and err.count("\n") == 1, err
    assert (files / "out" / "odd.csv").exists()
    unseen = np.full(len(BONE.vertices), 0.3 * BONE.diagonal)  # nor whether the target shows what is there
    dataclasses.replace(field(), residual=unseen).save(files / "part.npz")
    code, _, err = run(capsys, "transfer", files / "part.npz", files / "odd.csv", "-o", files / "out")
    assert code == 1 and words in err and err.count("\n") == 1, err
    code, _, err = run(
        *(capsys, "landmarks", files / "bone.ply", files / "target.ply", files / "odd.csv"),
        *("-o", files / "found.csv"),
    )
    assert code == 1 and f"odd.csv: the landmarks would lie on the template, {words}" in err, err
    assert "less certain" not in err and "out of its reach" not in err, err
    assert (files / "found.csv").exists()


def test_what_the_target_does_not_show_is_told(files, capsys):
    """Its upper third: landmarks there by name, in the report too, and a mesh as a whole."""
    kept = field()
    high = BONE.vertices[:, 2] > np.quantile(BONE.vertices[:, 2], 0.66)
    dataclasses.replace(kept, residual=np.where(high, 0.3 * BONE.diagonal, 0.25)).save(files / "f.npz")
    for name, rows in (("up", np.flatnonzero(high)[::20]), ("low", np.flatnonzero(~high)[::20])):
        lines = [f"{name}{n},{x!r},{y!r},{z!r}" for n, (x, y, z) in enumerate(BONE.vertices[rows].tolist())]
        (files / f"{name}.csv").write_text("\n".join([*lines, ""]))
        there = BONE.faces[(high[BONE.faces] == (name == "up")).all(axis=1)]
        meshfiles.write(files / f"{name}.stl", MeshFile.of(Surface(BONE.vertices, there)))
    page = files / "r.html"
    start = capsys, "transfer", files / "f.npz"
    code, _, err = run(*start, files / "low.csv", files / "low.stl", "-o", files / "out", "--report", page)
    assert code == 0 and "shows nothing" not in err and "does not show it" not in page.read_text(), err
    code, _, err = run(*start, files / "up.csv", files / "up.stl", "-o", files / "out", "--report", page)
    assert code == 1 and "up.csv: " in err and "are guesses: 'up" in err
    assert "up.stl: the target shows nothing of the source there" in err
    assert "no, the target does not show it" in page.read_text()


def test_landmarks_carried_already_are_not_in_another_unit():
    """They lie on a target ten times as large: what is to be done is to go the other way."""
    centres, goal = 10.0 * BONE.vertices, 10.0 * shapes.warp(BONE.vertices, *STEPS)
    scale, residual = np.diag([10.0, 10.0, 10.0, 1.0]), np.full(len(goal), 0.25)
    kept = keptfield.KeptField(scale, centres, goal - centres, BONE.faces, residual, 5.0, "bone", "other")
    transfer = Transfer(Carrier(kept), TransferSettings())
    marks, names = goal[::150], [str(number) for number in range(len(goal[::150]))]
    assert transfer.unit.of_landmarks(marks), "so it would be told"
    (fault,) = transfer.of_landmarks(transfer.points(marks), marks, names).faults
    assert "already" in fault and "inverse" in fault


def test_of_several_templates_the_wrong_one_is_named(files, capsys):
    meshfiles.write(files / "metres.ply", MeshFile.of(BONE.moved(0.001 * BONE.vertices)))
    marks = files / "marks.csv"
    code, _, err = run(
        *(capsys, "landmarks", files / "target.ply", "--template", files / "bone.ply", marks),
        *("--template", files / "metres.ply", marks, "-o", files / "found.csv"),
    )
    assert code == 2 and "metres.ply: the source seems to be in another unit" in err, err
    assert not (files / "found.csv").exists()


def test_templates_that_disagree_are_told(files, capsys):
    rows = [10, 400, 1200]  # the third elsewhere than in marks.csv
    lines = [
        f"{name},{x!r},{y!r},{z!r}"
        for name, (x, y, z) in zip("abc", BONE.vertices[rows].tolist(), strict=True)
    ]
    (files / "other.csv").write_text("\n".join(["name,x,y,z", *lines, ""]))
    code, _, err = run(
        *(capsys, "landmarks", files / "target.ply", "--template", files / "bone.ply", files / "marks.csv"),
        *("--template", files / "bone.ply", files / "other.csv", "-o", files / "found.csv"),
    )
    assert code == 1 and "1 landmark is put in quite different places by the templates: 'c' (" in err, err
    assert (files / "found.csv").exists()
