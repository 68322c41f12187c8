# SPDX-License-Identifier: GPL-3.0-or-later
"""What the transfer has to show: on warps with known answers, and on real bones where they are."""

from __future__ import annotations

import numpy as np
import pytest
from anatomy import PAIR, SMALL, femur_pair, needs_pair, needs_small

from femors_addon import meshfiles, shapes
from femors_addon.carry import Carrier
from femors_addon.cleaning import clean
from femors_addon.morph import MorphSettings, morph
from femors_addon.nearest import SurfaceIndex
from femors_addon.regions import RegionMap

WARPS = {
    "bend": (("bend", 0.15),),
    "twist": (("twist", 0.2),),
    "stretch": (("stretch", 0.06),),
    "bump": (("bump", 0.015),),
}


# --- warps with known answers ---------------------------------------------------------------------
@pytest.mark.parametrize("steps", WARPS.values(), ids=WARPS)
def test_landmarks_of_a_known_warp(steps):
    """In percent of the size 0.26 to 0.38 measured, with five steering landmarks 0.20 to 0.25."""
    source, other = shapes.bone(4000), shapes.bone(4000, lattice=1)
    target = other.moved(shapes.warp(other.vertices, *steps))
    truth = shapes.warp(source.vertices, *steps)
    rows = [int(np.argmax(source.vertices[:, 2]))]  # each as far from the others as can be
    while len(rows) < 5:
        away = np.min([np.linalg.norm(source.vertices - source.vertices[r], axis=1) for r in rows], axis=0)
        rows.append(int(np.argmax(away)))
    marks = np.random.default_rng(0).choice(len(truth), 200, replace=False)
    error = {}
    for steer in (False, True):
        pairs = {"source_landmarks": source.vertices[rows], "target_landmarks": truth[rows]}
        result = morph(source, target, MorphSettings(steer=steer), **(pairs if steer else {}))
        got = result.apply(source.vertices[marks])
        error[steer] = np.linalg.norm(got - truth[marks], axis=1).mean() / target.diagonal
    assert error[False] < 0.01
    assert error[True] < 0.003
    assert error[True] < error[False]


# --- real bones -----------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def pair():
    source, target = femur_pair()
    result = morph(source, target)
    return source, target, Carrier(result.kept("source", "target"))


def off(index: SurfaceIndex, points: np.ndarray) -> np.ndarray:
    return index.closest(points).distance


@needs_pair
def test_all_sites_land_on_the_target_nearer_than_the_authors(pair):
    source, target, carrier = pair
    before, after = (SurfaceIndex(clean(s.vertices, s.faces).surface) for s in (source, target))
    paths = sorted((PAIR / "sites").glob("*.stl"))
    assert len(paths) == 13
    for path in paths:
        nodes = np.unique(meshfiles.read(path).vertices, axis=0)
        theirs = np.unique(meshfiles.read(PAIR / "sites_authors_morphed" / path.name).vertices, axis=0)
        ours = carrier.carry(nodes).points
        assert np.median(off(after, ours)) <= np.median(off(after, theirs)), path.stem
        # and as far from the target as it was from the source: 0.005 to 0.024 mm, but 0.049 for one
        apart = np.median(np.abs(off(after, ours) - off(before, nodes)))
        assert apart < (0.05 if path.stem == "MCL_Super_Post_Region_Fem" else 0.03), path.stem


@needs_pair
def test_the_landmarks_of_the_pair_keep_their_offsets(pair):
    """They lie up to 8.8 mm off the bone, and 3 mm in the median from where the authors have them."""
    source, target, carrier = pair
    before, after = (SurfaceIndex(clean(s.vertices, s.faces).surface) for s in (source, target))
    marks, theirs = (
        np.loadtxt(PAIR / f"{name}.csv", delimiter=",") for name in ("landmarks", "landmarks_authors_morphed")
    )
    ours = carrier.carry(marks).points
    offset = before.signed(marks)
    kept, authors = np.abs(after.signed(ours) - offset), np.abs(after.signed(theirs) - offset)
    assert kept.mean() < 0.15 < authors.mean()
    assert np.median(np.linalg.norm(ours - theirs, axis=1)) < 4.0


@needs_pair
def test_a_sites_area_on_the_targets_mesh(pair):
    """Under 5 % of the region carried as a mesh, for every site that starts on the bone."""
    source, target, carrier = pair
    ways = RegionMap(source.moved(carrier.carry(source.vertices).points), target)
    for path in sorted((PAIR / "sites").glob("*.stl")):
        patch = meshfiles.read(path).surface()
        away = SurfaceIndex(clean(patch.vertices, patch.faces).surface).closest(source.vertices).distance
        weights = (away < 0.8).astype(float)
        if weights.sum() > 3:
            region = ways.region(weights)
            assert abs(region.area_error) < 0.05, path.stem
            assert region.centroid_error < 0.5, path.stem


@needs_small
def test_every_vertex_of_the_small_femur_is_a_landmark():
    """0.38 mm in the mean measured, where 3.7 mm were to be beaten."""
    source, target = (meshfiles.read(SMALL / f"{name}.stl").surface() for name in ("femur", "femur_target"))
    rows = np.random.default_rng(0).choice(len(source.vertices), 200, replace=False)
    got = morph(source, target).apply(source.vertices[rows])
    error = np.linalg.norm(got - target.vertices[rows], axis=1)
    assert error.mean() < 0.6
    assert error.max() < 3.0
