# SPDX-License-Identifier: GPL-3.0-or-later
"""`femors morph` with decks: a part is morphed, and all else stays."""

from __future__ import annotations

import json

import numpy as np
import pytest
from commands import refused, run

from femors_addon import cli_morph, deckfiles, meshfiles
from femors_addon.meshfiles import MeshFile
from femors_addon.morph import MorphResult
from femors_addon.morph_settings import MorphSettings
from femors_addon.volume_quality import scaled_jacobians


def ball(count: int, radii: tuple[float, float, float]) -> MeshFile:
    """Return an ellipsoid of triangles over a cube's grid."""
    axis = np.linspace(-1, 1, count + 1)
    vertices, corners = [], []
    for side in range(6):
        u, v = np.meshgrid(axis, axis, indexing="ij")
        sign = 1.0 if side % 2 else -1.0
        face = np.stack([np.full_like(u, sign), u if sign > 0 else v, v if sign > 0 else u], -1)
        vertices.append(np.roll(face, side // 2, axis=-1).reshape(-1, 3))
        index = np.arange((count + 1) ** 2).reshape(count + 1, count + 1) + side * (count + 1) ** 2
        a, b, c, d = (
            index[i : i + count, j : j + count].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))
        )
        corners += [np.column_stack((a, b, c)), np.column_stack((a, c, d))]
    points = np.concatenate(vertices)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points, index = np.unique(np.round(points, 12), axis=0, return_inverse=True)
    faces = index.ravel()[np.concatenate(corners)]
    return MeshFile(points * radii, np.full(len(faces), 3), faces)


def node_lines(points: np.ndarray, first: int) -> str:
    return "".join(f"{i}, {x!r}, {y!r}, {z!r}\n" for i, (x, y, z) in enumerate(points.tolist(), first))


@pytest.fixture()
def shells(tmp_path):
    """A deck of R3D3 shells with two parts, its target, and the source's surface."""
    source, target = ball(8, (30, 24, 50)), ball(9, (36, 26, 55))
    nodes = "".join(
        f"{i}, {x!r}, {y!r}, {z!r}\n" for i, (x, y, z) in enumerate(source.vertices.tolist(), 101)
    )
    rows = (source.corners.reshape(-1, 3) + 101).tolist()
    elements = "".join(f"{i}, {a}, {b}, {c}\n" for i, (a, b, c) in enumerate(rows, 1))
    far = "9001, 500,500,500\n9002, 501,500,500\n9003, 500,501,500\n9999, 1,2,3\n"
    text = f"*NODE, NSET=N\n{nodes}{far}*ELEMENT, TYPE=R3D3, ELSET=BONE\n{elements}"
    text += (
        "*ELEMENT, TYPE=S3, ELSET=PLATE\n90001, 9001, 9002, 9003\n*RIGID BODY, REF NODE=9999, ELSET=BONE\n"
    )
    (tmp_path / "bone.inp").write_text(text)
    meshfiles.write(tmp_path / "target.stl", target)
    return tmp_path / "bone.inp", tmp_path / "target.stl"


def test_a_part_of_shells_is_morphed_and_all_else_stays(shells, tmp_path, capsys):
    source, target = shells
    out, report = tmp_path / "out.inp", tmp_path / "r.json"
    code, said, err = run(capsys, "morph", source, target, "-o", out, "--part", "bone", "--report", report)
    assert code == 0, err
    assert "surface, target to source" in said
    before, after = deckfiles.read_deck(source), deckfiles.read_deck(out)
    assert np.array_equal(before.coordinates[-4:], after.coordinates[-4:])
    radius = np.linalg.norm(after.coordinates[:-4] / [36, 26, 55], axis=1)
    assert np.abs(radius - 1).max() < 0.03
    old, new = (path.read_text().split("*ELEMENT", 1) for path in (source, out))
    assert old[1] == new[1]
    assert [line.split(",")[0] for line in old[0].splitlines()] == [
        line.split(",")[0] for line in new[0].splitlines()
    ]
    assert old[0].splitlines()[-4:] == new[0].splitlines()[-4:]
    assert json.loads(report.read_text())["converged"]


def test_a_deck_as_the_target_and_a_surface_as_the_output(shells, tmp_path, capsys, monkeypatch):
    source, target = shells
    called = []

    def morph(one, two, settings=None, progress=None, **landmarks):
        called.append((len(one.vertices), len(two.vertices)))
        return cli_morph.MorphResult(**(vars(result) | {"vertices": one.vertices + 1.0}))

    result = real_result()
    monkeypatch.setattr(cli_morph, "morph", morph)
    argv = ("morph", target, source, "-o", tmp_path / "o.ply", "--target-part", "BONE", "--quiet")
    assert run(capsys, *argv)[0] == 0
    assert meshfiles.read(tmp_path / "o.ply").vertices[0] == pytest.approx(
        meshfiles.read(target).vertices[0] + 1
    )
    argv = ("morph", source, target, "-o", tmp_path / "o.obj", "--part", "BONE")
    code, _, err = run(capsys, *argv)
    assert code == 0
    assert "not written" in err
    assert called[0][1] == called[1][0] == 6 * 8 * 8 + 2


def real_result() -> MorphResult:
    return cli_morph.morph(
        ball(4, (3, 4, 5)).surface(), ball(4, (3, 4, 5)).surface(), MorphSettings(alignment="none")
    )


def test_what_morph_refuses_of_decks(shells, tmp_path, capsys, monkeypatch):
    def never(*args, **kwargs):
        raise AssertionError("the morph was started")

    monkeypatch.setattr(cli_morph, "morph", never)
    source, target = shells
    files = sorted(tmp_path.iterdir())
    out = ("-o", tmp_path / "o.inp")
    assert "choose one with --part, or 'all'" in refused(capsys, "morph", source, target, *out)
    assert "choose one with --target-part" in refused(capsys, "morph", target, source, *out)
    assert "no part or set 'X'" in refused(capsys, "morph", source, target, *out, "--part", "X")
    assert "a surface mesh has no parts" in refused(
        capsys, "morph", source, target, *out, "--part", "BONE", "--target-part", "X"
    )
    # an include in the way is found before the long computation
    head, tail = source.read_text().split("*ELEMENT", 1)
    (tmp_path / "nodes.inc").write_text(head)
    (tmp_path / "main.inp").write_text("*INCLUDE, INPUT=nodes.inc\n*ELEMENT" + tail)
    argv = ("morph", tmp_path / "main.inp", target, *out, "--part", "BONE")
    assert "write into another folder" in refused(capsys, *argv)
    (tmp_path / "nodes.inc").unlink()
    (tmp_path / "main.inp").unlink()
    assert sorted(tmp_path.iterdir()) == files


def test_a_solid_follows(tmp_path, capsys):
    """A box of hexahedra onto a longer box; every element stays valid."""
    axis = np.arange(7)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3).astype(float)
    index = np.arange(len(points)).reshape(7, 7, 7) + 1
    steps = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
    rows = np.stack([index[i : i + 6, j : j + 6, k : k + 6] for i, j, k in steps], -1).reshape(-1, 8)
    for name, scale in (("box", (5.0, 6.0, 7.0)), ("long", (5.5, 6.5, 9.0))):
        nodes = "".join(
            f"{i}, {x!r}, {y!r}, {z!r}\n" for i, (x, y, z) in enumerate((points * scale).tolist(), 1)
        )
        elements = "".join(f"{i}, {', '.join(map(str, row))}\n" for i, row in enumerate(rows.tolist(), 1))
        (tmp_path / f"{name}.inp").write_text(f"*NODE\n{nodes}*ELEMENT, TYPE=C3D8R, ELSET=E\n{elements}")
    argv = (
        tmp_path / "box.inp",
        tmp_path / "long.inp",
        "-o",
        tmp_path / "out.inp",
        "--report",
        tmp_path / "r.json",
    )
    code, _, err = run(capsys, "morph", *argv, "--field", tmp_path / "f.npz")
    assert code in (0, 1), err
    after, goal = (deckfiles.read_deck(tmp_path / f"{name}.inp").mesh for name in ("out", "long"))
    assert (scaled_jacobians(after) > 0).all()
    size = np.ptp(after.nodes, axis=0) / np.ptp(goal.nodes, axis=0)
    assert np.allclose(np.sort(size), 1, atol=0.05)
    assert json.loads((tmp_path / "r.json").read_text())["volume"]["newly_inverted"] == []
    assert (tmp_path / "f.npz").exists()
