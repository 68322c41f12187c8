# SPDX-License-Identifier: GPL-3.0-or-later
"""Thinning: about a quarter of the nodes, where they were, on a surface of the same topology."""

from __future__ import annotations

import numpy as np
import pytest
from surfaces import cut, together

from femors_addon import reduce, shapes, thinning
from femors_addon.cleaning import clean
from femors_addon.mesh import Surface
from femors_addon.nearest import SurfaceIndex
from femors_addon.progress import FemorsError
from femors_addon.quality import aspect_ratio, degenerate, flipped_faces
from femors_addon.thinning import _independent, thinned


def few(surface: Surface, seed: int = 0) -> Surface:
    return thinned(surface, np.random.default_rng(seed))


BONE = shapes.bone(4000)


@pytest.mark.parametrize("seed", range(3))
def test_no_two_of_the_chosen_are_neighbours_and_all_others_have_one(seed):
    links = BONE.adjacency
    priority = np.random.default_rng(seed).permutation(len(BONE.vertices))
    chosen = _independent(links.indptr[:-1], links.indices, priority)
    one, two = BONE.edges.T
    assert not (chosen[one] & chosen[two]).any()
    above = links.multiply(np.where(chosen, priority + 1, 0)).max(axis=1).toarray().ravel()
    assert (chosen | (above > priority + 1)).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_quarter_of_the_nodes_makes_the_same_surface(seed):
    small = few(BONE, seed)
    assert 3.5 < len(BONE.vertices) / len(small.vertices) < 5.0
    assert len(small.vertices) - len(small.edges) + len(small.faces) == 2
    assert not small.border.any()
    assert not degenerate(small).any()
    assert np.percentile(aspect_ratio(small), 99) < 3.0
    known = {tuple(point) for point in BONE.vertices}
    assert all(tuple(point) in known for point in small.vertices)
    assert SurfaceIndex(small).closest(BONE.vertices).distance.max() < 0.5 * small.mean_edge
    assert small.volume == pytest.approx(BONE.volume, rel=0.03)
    assert (np.sign(small.volume), len(flipped_faces(small, small))) == (1.0, 0)


def test_a_border_keeps_its_outline():
    low, high = np.percentile(BONE.vertices[:, 2], (30, 70))
    open_bone, _ = cut(BONE, low, high)
    small = few(open_bone)
    assert small.border.any()
    along = open_bone.vertices[open_bone.border]
    at = {tuple(point) for point in along}
    assert all(tuple(point) in at for point in small.vertices[small.border])
    edge = small.mean_edge
    away = [np.linalg.norm(small.vertices[small.border] - point, axis=1).min() for point in along]
    assert max(away) < 1.5 * edge


def test_where_three_sheets_meet_they_meet():
    across, up = np.meshgrid(np.arange(21.0), np.arange(31.0), indexing="ij")
    at = np.arange(21 * 31).reshape(21, 31)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    faces = np.concatenate((np.column_stack((a, b, c)), np.column_stack((a, c, d))))
    sheets = [
        np.stack((across * np.cos(turn), across * np.sin(turn), up), axis=-1).reshape(-1, 3)
        for turn in np.radians((0.0, 120.0, 240.0))
    ]
    surface = clean(np.concatenate(sheets), np.concatenate([faces + k * at.size for k in range(3)])).surface
    small = few(surface)
    count = np.unique(
        np.sort(small.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)), axis=0, return_counts=True
    )
    seam = np.unique(count[0][count[1] == 3])
    inner = small.vertices[seam[np.abs(small.vertices[seam, 2] - 15.0) < 13.0]]
    assert len(inner) >= 8
    assert np.abs(inner[:, :2]).max() < 1e-9  # they stand on the line, but at its ends
    assert np.ptp(inner[:, 2]) > 20.0


def test_creases_keep_their_nodes(monkeypatch):
    block = shapes.box((3.0, 2.0, 1.0), (30, 20, 10))
    lost = block.volume - few(block).volume
    assert 0 < lost < 0.02 * block.volume
    monkeypatch.setattr(thinning, "_ranks", lambda surface: np.zeros(len(surface.vertices), dtype=int))
    assert lost < 0.5 * (block.volume - few(block).volume)


def test_pieces_stay_apart():
    two = together(BONE, BONE.moved(BONE.vertices + (200.0, 0.0, 0.0)))
    assert few(two).components.max() == 1


def test_the_same_every_time():
    assert few(BONE, 5).vertices.tobytes() == few(Surface(BONE.vertices, BONE.faces), 5).vertices.tobytes()


def test_a_mesh_of_which_nothing_would_be_left_is_refused():
    with pytest.raises(FemorsError):
        few(shapes.sphere(0))


def test_dense_meshes_are_thinned_before_edges_collapse(monkeypatch):
    asked = []
    monkeypatch.setattr(
        reduce, "thinned", lambda *args: asked.append(len(args[0].vertices)) or thinned(*args)
    )
    count = len(BONE.vertices)
    plain = reduce.reduced(BONE, count // 8)
    assert not asked
    monkeypatch.setattr(reduce, "DENSE", 200)
    assert len(reduce.reduced(BONE, count // 3).vertices) == pytest.approx(count // 3, rel=0.05)
    assert not asked  # too few would be left
    small = reduce.reduced(BONE, count // 8)
    assert asked == [count]
    assert len(small.vertices) == pytest.approx(count // 8, rel=0.05)
    assert small.volume == pytest.approx(plain.volume, rel=0.03)
    asked.clear()
    reduce.reduced(BONE, count // 40)
    assert len(asked) == 2
    # what cannot be thinned is reduced as ever
    monkeypatch.setattr(reduce, "DENSE", 10)
    ball = shapes.sphere(1)
    assert len(reduce.reduced(ball, 11).vertices) <= len(ball.vertices)
