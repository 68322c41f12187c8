# SPDX-License-Identifier: GPL-3.0-or-later
"""Small FE decks as text, and how tests import, export and refuse them."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest


def grid(counts=(6, 5, 3), size=(30.0, 20.0, 9.0)):
    """Return nodes (n, 3), with more digits than single precision has, and hexes (e, 8)."""
    x, y, z = (np.linspace(0, length, k + 1) for length, k in zip(size, counts, strict=True))
    nodes = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3) + 1 / 3
    strides = np.array([(counts[1] + 1) * (counts[2] + 1), counts[2] + 1, 1])
    at = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
    offsets = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    return nodes, np.stack([(at + offset) @ strides for offset in offsets], axis=1)


def node_lines(nodes, first=1) -> str:
    return "".join(f"{first + i}, {x!r}, {y!r}, {z!r}\n" for i, (x, y, z) in enumerate(nodes.tolist()))


def element_lines(elements, first=1, offset=1) -> str:
    rows = (elements + offset).tolist()
    return "".join(f"{first + i}, {', '.join(map(str, row))}\n" for i, row in enumerate(rows))


def plain() -> str:
    """Return a deck of one block, ids from 1001, with sets of nodes and elements."""
    nodes, hexes = grid()
    return (
        "** a block\n*NODE, NSET=EVERY\n"
        + node_lines(nodes, 1001)
        + "*ELEMENT, TYPE=C3D8R, ELSET=BLOCK\n"
        + element_lines(hexes, 1, 1001)
        + "*NSET, NSET=TIP\n1001\n*NSET, NSET=END, GENERATE\n1001, 1024, 1\n"
        + "*ELSET, ELSET=HALF, GENERATE\n1, 45, 1\n"
        + "*MATERIAL, NAME=TISSUE\n*ELASTIC\n 12.0, 0.45\n"
    )


def halves() -> str:
    """Return a deck of two element sets that share the nodes between them."""
    nodes, hexes = grid()
    return (
        "*NODE\n"
        + node_lines(nodes)
        + "*ELEMENT, TYPE=C3D8, ELSET=LEFT\n"
        + element_lines(hexes[:45])
        + "*ELEMENT, TYPE=C3D8, ELSET=RIGHT\n"
        + element_lines(hexes[45:], 46)
    )


def assembly() -> str:
    """Return a deck with a part that stands in two places."""
    nodes, hexes = grid((3, 2, 2), (6, 4, 4))
    return (
        "*PART, NAME=Brick\n*NODE\n"
        + node_lines(nodes)
        + "*ELEMENT, TYPE=C3D8\n"
        + element_lines(hexes)
        + "*END PART\n*ASSEMBLY, NAME=All\n*INSTANCE, NAME=Brick-1, PART=Brick\n*END INSTANCE\n"
        + "*INSTANCE, NAME=Brick-2, PART=Brick\n 100., 0., 0.\n"
        + " 100., 0., 0., 100., 0., 1., 90.\n*END INSTANCE\n"
        + "*END ASSEMBLY\n"
    )


def febio() -> str:
    nodes, hexes = grid((3, 2, 2))
    rows = "".join(
        f'<node id="{i + 1}">{x!r},{y!r},{z!r}</node>\n' for i, (x, y, z) in enumerate(nodes.tolist())
    )
    elements = "".join(
        f'<elem id="{i + 1}">{",".join(map(str, row))}</elem>\n' for i, row in enumerate((hexes + 1).tolist())
    )
    return (
        '<?xml version="1.0"?>\n<febio_spec version="4.0">\n<Mesh>\n'
        f'<Nodes name="all">\n{rows}</Nodes>\n<Elements type="hex8" name="Soft">\n{elements}</Elements>\n'
        "</Mesh>\n</febio_spec>\n"
    )


SPANS = np.array([30.0, 20.0, 9.0])


def warp(points):
    """A smooth known warp of a few mm."""
    x, y, _ = (np.asarray(points) / SPANS).T
    return points + 2.0 * np.stack(
        [0.6 * np.sin(3 * y), 0.8 * np.sin(2.5 * x), np.sin(3 * x) + 0.3 * y], axis=-1
    )


def export(path: Path, **options) -> bytes:
    assert bpy.ops.femors.export_deck(filepath=str(path), **options) == {"FINISHED"}
    return path.read_bytes()


def local(item) -> np.ndarray:
    out = np.empty(3 * len(item.data.vertices), np.float32)
    item.data.vertices.foreach_get("co", out)
    return out.reshape(-1, 3)


def ids(item) -> np.ndarray:
    out = np.empty(len(item.data.vertices), np.int32)
    item.data.attributes["node_id"].data.foreach_get("value", out)
    return out


def target_of(tools, core, path, name="Target", part=None):
    """Make the object of a part's warped outer surface; return it and the same as a core Surface."""
    read = core("deckfiles").read_deck(path)
    surface, _ = read.submesh(read.part(part))[0].surface()
    vertices = warp(surface.vertices).astype(np.float32).astype(float)
    return tools.add_object(name, vertices, surface.faces.tolist()), core("mesh").Surface(
        vertices, surface.faces
    )


def still(core):
    """Settings without an alignment, which could turn a block by half a turn."""
    return core("morph_settings").MorphSettings(alignment="none")


def refused(match: str, operator, tools, **options) -> str:
    before = tools.census()
    with pytest.raises(RuntimeError, match=match) as caught:
        operator(**options)
    line = str(caught.value).removeprefix("Error: ").strip()
    assert "\n" not in line and "Traceback" not in line and "unexpected" not in line, line
    assert tools.census() == before
    return line
