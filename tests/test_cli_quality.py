# SPDX-License-Identifier: GPL-3.0-or-later
"""``femors quality``, and the pages that commands write with ``--report R.html``."""

from __future__ import annotations

import json

import numpy as np
import pytest
from commands import run

from femors_addon import meshfiles
from femors_addon.meshfiles import MeshFile
from femors_addon.shapes import pair


@pytest.fixture(scope="module")
def bones(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bones")
    made = pair(500, 550)
    for name, surface in (("a.obj", made.source), ("b.stl", made.target)):
        sizes = np.full(len(surface.faces), 3)
        meshfiles.write(folder / name, MeshFile(surface.vertices, sizes, surface.faces.ravel()))
    return folder


def test_a_sound_mesh_beside_another(bones, capsys):
    report = bones / "q.json"
    code, out, err = run(capsys, "quality", bones / "a.obj", bones / "b.stl", "--report", report)
    assert code == 0, err
    assert "XOR volume" in out and "self-intersecting faces     0" in out
    data = json.loads(report.read_text())
    assert data["against"]["overlap"]["dice"] > 0.5 and data["faults"] == []
    assert data["faults_counted"]["self_intersecting"] == 0 and data["femors"]


def test_faults_give_code_1_and_a_line_each(bones, capsys):
    made = pair(500, 500).source
    moved = np.array(made.vertices)
    moved[10] += 3.0 * (moved.mean(axis=0) - moved[10])
    bad = bones / "bad.obj"
    meshfiles.write(bad, MeshFile(moved, np.full(len(made.faces), 3), made.faces.ravel()))
    code, _, err = run(capsys, "quality", bad, "--quiet")
    assert code == 1
    assert "faces cross others (first: at (" in err


def test_notes_name_the_file(bones, capsys):
    """The core speaks of the "mesh"; who has given two files wants to know which one."""
    made = pair(500, 500).source
    twice = np.vstack((made.faces, made.faces[:1]))
    mesh = bones / "twice.obj"
    meshfiles.write(mesh, MeshFile(made.vertices, np.full(len(twice), 3), twice.ravel()))
    code, _, err = run(capsys, "quality", mesh, "--report", bones / "t.json")
    assert code == 0 and err == f"femors: note: {mesh}: 1 face stands twice and was counted once\n"
    assert json.loads((bones / "t.json").read_text())["notes"] == [
        f"{mesh}: 1 face stands twice and was counted once"
    ]


def test_a_mesh_in_metres_beside_one_in_millimetres_is_asked_about(bones, capsys):
    small = meshfiles.read(bones / "b.stl")
    meshfiles.write(bones / "metres.stl", small.with_vertices(small.vertices / 1000.0))
    for one, two, kind in (("b.stl", "metres.stl", "smaller"), ("metres.stl", "b.stl", "larger")):
        code, _, err = run(capsys, "quality", bones / one, bones / two)
        words = f"is 1000 times {kind} than the mesh: are both in one unit of length?"
        assert code == 0 and err == f"femors: note: {bones / two}: {words}\n"


def test_a_page_of_a_mesh_and_of_a_morph(bones, capsys):
    page = bones / "q.html"
    assert run(capsys, "quality", bones / "a.obj", "--report", page, "--quiet")[0] == 0
    assert "Quality of a.obj" in page.read_text(encoding="utf-8")
    page = bones / "m.html"
    code, _, err = run(
        capsys, "morph", bones / "a.obj", bones / "b.stl", "-o", bones / "o.obj", "--report", page, "--quiet"
    )
    assert code in (0, 1), err
    text = page.read_text(encoding="utf-8")
    for words in ("Morph of a.obj to b.stl", "Source, aligned", "Convergence", "data:image/png;base64,"):
        assert words in text


def test_what_is_refused_is_one_line_and_writes_nothing(bones, capsys):
    before = sorted(bones.iterdir())
    for argv, words in (
        (("quality", bones / "a.obj", "--report", bones / "q.pdf"), "a report ends in .html"),
        (("quality", bones / "gone.obj"), "gone.obj"),
        (("quality", bones / "a.obj", "--worst-aspect", "0.5"), "--worst-aspect"),
        (("quality", bones / "a.obj", "--report", bones / "a.obj"), "is also an input"),
        (("morph", bones / "a.obj", bones / "b.stl", "-o", bones / "n.obj", "--report", "r.txt"), "ends in"),
    ):
        code, out, err = run(capsys, *argv)
        assert (code, out, err.count("\n")) == (2, "", 1) and words in err, err
    assert sorted(bones.iterdir()) == before
