# SPDX-License-Identifier: GPL-3.0-or-later
"""Alignment of a part and a whole."""

from __future__ import annotations

import numpy as np
import pytest
from aligncases import off, placed, pose, subjects, twice
from anatomy import DATA
from surfaces import cut

from femors_addon import deckfiles, shapes
from femors_addon.align import DOUBT, align
from femors_addon.cleaning import clean
from femors_addon.mesh import Surface
from femors_addon.triples import renumbered

PARTS = {
    "far end": (-99, 150),
    "near end": (220, 999),
    "all but the far end": (100, 999),
    "all but the near end": (-99, 300),
}


@pytest.fixture(scope="module")
def bones():
    """One bone, meshed twice."""
    return twice()


@pytest.fixture(scope="module")
def pair():
    """Two subjects."""
    return subjects()


@pytest.mark.parametrize("seed", [0, 2])
@pytest.mark.parametrize("part", PARTS)
def test_a_part_finds_its_place_on_the_whole(bones, part, seed):
    """The same shape: what is left is within the mean edge of the meshes; from any pose."""
    source, target = bones
    piece, _ = cut(source, *PARTS[part])
    start = pose(seed)
    result = align(placed(start, piece), target, "rigid", partial="source")
    assert off(result.matrix @ start, piece.vertices, piece.vertices, target.diagonal) < 6e-3
    assert result.residual < target.mean_edge
    assert DOUBT not in result.warnings


@pytest.mark.parametrize("seed", [0, 2])
@pytest.mark.parametrize("part", PARTS)
def test_the_whole_finds_its_place_on_a_part(bones, part, seed):
    source, target = bones
    piece, _ = cut(target, *PARTS[part])
    start = pose(seed)
    result = align(placed(start, source), piece, "rigid", partial="target")
    # what the part does not show hangs on a long lever
    assert off(result.matrix @ start, source.vertices, source.vertices, target.diagonal) < 0.015
    _, there = cut(source, *PARTS[part])
    points = source.vertices[there]
    assert off(result.matrix @ start, points, points, target.diagonal) < 6e-3
    assert result.residual < target.mean_edge


def test_it_is_told_where_a_part_fits_in_several_places(bones):
    """A cap fits a ball everywhere; of a bone the pose is certain, and landmarks leave no doubt."""
    ball = shapes.sphere(4)
    cap = Surface(ball.vertices, ball.faces[(ball.corners[:, :, 2] > 0.3).all(axis=1)])
    kept, faces = renumbered(cap.faces, len(cap.vertices))
    cap = Surface(ball.vertices[kept], faces)
    assert DOUBT in align(placed(pose(3), cap), ball, "rigid", partial="source").warnings
    assert DOUBT in align(ball, placed(pose(3), cap), "rigid", partial="target").warnings
    points = cap.vertices[:4]
    marked = align(cap, ball, "rigid", partial="source", landmarks=(points, points))
    assert DOUBT not in marked.warnings
    assert DOUBT not in align(ball, ball, "rigid").warnings  # of whole meshes it is not asked


@pytest.mark.parametrize("part", PARTS)
def test_parts_of_another_subject(pair, part):
    """One-sided and trimmed: not squeezed into the other, as the whole would be."""
    size = pair.target.diagonal
    piece, used = cut(pair.source, *PARTS[part])
    result = align(placed(pose(1), piece), pair.target, "affine", partial="source")
    assert off(result.matrix @ pose(1), piece.vertices, pair.truth[used], size) < 0.015
    piece, _ = cut(pair.target, *PARTS[part])
    there = (pair.truth[:, 2] > PARTS[part][0]) & (pair.truth[:, 2] < PARTS[part][1])
    result = align(placed(pose(1), pair.source), piece, "affine", partial="target")
    assert off(result.matrix @ pose(1), pair.source.vertices[there], pair.truth[there], size) < 0.015
    assert 0.6 < np.linalg.det(result.matrix[:3, :3]) < 1.6


@pytest.mark.skipif(not (DATA / "knee").exists(), reason=f"no knee at {DATA}")
def test_the_hand_of_a_part_is_told_though_its_mirror_image_starts_little_better():
    """Of a left proximal tibia on a right one with its fibula."""
    paths = DATA / "tibia_small" / "tibia_mesh.vtk", DATA / "knee" / "bone_tibia_fibula.inp"
    left, right = (deckfiles.read_deck(path).mesh.surface()[0] for path in paths)
    left, right = (clean(one.vertices, one.faces).surface for one in (left, right))
    mirrored = left.moved(left.vertices * [-1, 1, 1])
    (told,) = [text for text in align(left, right, partial="source").warnings if "mirror" in text]
    assert told.startswith("the source's mirror image fits the target better by")
    turned = clean(mirrored.vertices, mirrored.faces).surface
    assert not any("mirror" in text for text in align(turned, right, partial="source").warnings)
