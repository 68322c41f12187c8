# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of decks where they stand, and what shares nodes with them; includes that cannot be followed."""

from __future__ import annotations

import numpy as np
import pytest

from femors_addon import cli, inp, meshfiles
from femors_addon.deck_morph import morph_part
from femors_addon.mesh import Surface
from femors_addon.morph_settings import MorphSettings
from femors_addon.progress import FemorsError
from femors_addon.transforms import transformed
from femors_addon.volume_quality import scaled_jacobians


def grid(cells=(6, 4, 4), size=(30.0, 20.0, 9.0)):
    """Nodes (n, 3) and hexes (k, 8) of a bent block."""
    nx, ny, nz = (c + 1 for c in cells)
    number = np.arange(nx * ny * nz).reshape(nx, ny, nz)
    axes = np.meshgrid(*(np.linspace(-0.5, 0.5, n) for n in (nx, ny, nz)), indexing="ij")
    nodes = np.column_stack([axis.ravel() for axis in axes]) * size
    nodes[:, 2] += 0.01 * nodes[:, 0] ** 2 + 0.004 * nodes[:, 0] * nodes[:, 1]
    low = [number[i : i + nx - 1, j : j + ny - 1, :-1] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    high = [number[i : i + nx - 1, j : j + ny - 1, 1:] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    return nodes, np.column_stack([corner.ravel() for corner in (*low, *high)])


def text(nodes, blocks, head="", tail=""):
    lines = [head + "*NODE"]
    lines += [f"{i + 1}, {x!r}, {y!r}, {z!r}" for i, (x, y, z) in enumerate(nodes.tolist())]
    first = 1
    for name, hexes in blocks.items():
        lines.append(f"*ELEMENT, TYPE=C3D8, ELSET={name}")
        rows = (hexes + 1).tolist()
        lines += [f"{first + i}, " + ", ".join(map(str, row)) for i, row in enumerate(rows)]
        first += len(hexes)
    return "\n".join(lines) + "\n" + tail


@pytest.fixture
def halves(tmp_path):
    """A deck of two element sets that share nodes."""
    nodes, hexes = grid()
    left = nodes[hexes].mean(axis=1)[:, 0] < 0
    path = tmp_path / "halves.inp"
    path.write_text(text(nodes, {"LEFT": hexes[left], "RIGHT": hexes[~left]}))
    return inp.read(path)


def stretched(deck, name, factor):
    surface = deck.submesh(deck.part(name))[0].surface()[0]
    centre = surface.vertices.mean(axis=0)
    return surface.moved(centre + (surface.vertices - centre) * [factor, 1, 1])


def test_elements_outside_a_part_are_never_inverted(halves):
    settings = MorphSettings(alignment="none")
    with pytest.raises(
        FemorsError, match="elements outside 'LEFT' would be inverted, by nodes shared with it"
    ):
        morph_part(halves, halves.part("LEFT"), stretched(halves, "LEFT", 2.0), settings)
    small = stretched(halves, "LEFT", 1.05)
    deck, _ = morph_part(halves, halves.part("LEFT"), small, settings)
    assert scaled_jacobians(deck.mesh).min() > 0
    assert not np.array_equal(deck.coordinates, halves.coordinates)


@pytest.fixture
def assembly(tmp_path):
    """A part that stands in two places, the second moved by a Fortran number and turned."""
    nodes, hexes = grid()
    tail = (
        "*END PART\n*ASSEMBLY, NAME=All\n*INSTANCE, NAME=Brick-1, PART=Brick\n*END INSTANCE\n"
        "*INSTANCE, NAME=Brick-2, PART=Brick\n 1.D2, 0., 0.\n 100., 0., 0., 100., 0., 1., 90.\n"
        "*END INSTANCE\n"
        "*END ASSEMBLY\n"
    )
    path = tmp_path / "assembly.inp"
    path.write_text(text(nodes, {"ALL": hexes}, "*PART, NAME=Brick\n", tail))
    return path


def test_an_instance_is_morphed_where_it_stands(assembly, tmp_path):
    deck = inp.read(assembly)
    matrix = next(one.matrix for one in deck.instances if one.name.upper() == "BRICK-2")
    mesh = deck.submesh(deck.part("Brick"))[0]
    surface, at = mesh.surface()
    own = surface.vertices * [1.1, 1.0, 0.95] + [1.0, 2.0, -1.0]
    target, out = tmp_path / "target.ply", tmp_path / "out.inp"
    meshfiles.write(target, meshfiles.MeshFile.of(Surface(transformed(matrix, own), surface.faces)))
    common = ["morph", str(assembly), str(target), "-o", str(out), "--quiet", "--align", "none"]
    assert cli.main([*common, "--part", "Brick"]) == 2  # which of the two?
    assert not out.exists()
    assert cli.main([*common, "--part", "Brick-2"]) == 0
    found = inp.read(out).submesh(inp.read(out).part("Brick"))[0].nodes[at]
    assert np.abs(found - own).max() < 1.0
    assert np.percentile(np.linalg.norm(found - own, axis=1), 90) < 0.5


def test_includes_that_cannot_be_followed_are_one_line(tmp_path):
    deck = tmp_path / "deck.inp"
    deck.write_text("*INCLUDE, INPUT=" + "x" * 5000 + "\n")
    with pytest.raises(FemorsError, match="is not there"):
        inp.read(deck)
    for number in range(70):
        (tmp_path / f"i{number}.inp").write_text(f"*INCLUDE, INPUT=i{number + 1}.inp\n")
    deck.write_text("*INCLUDE, INPUT=i0.inp\n")
    with pytest.raises(FemorsError, match="nested more than"):
        inp.read(deck)
