# SPDX-License-Identifier: GPL-3.0-or-later
"""What is set for a morph: weights, landmarks, every setting at its ends."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from morphs import GOAL, SMALL, STAY, finite, subjects, subjects_morphed
from scipy.spatial.transform import Rotation
from surfaces import soup

from femors_addon import morph_fit, shapes
from femors_addon import settings as declared
from femors_addon.mesh import Surface
from femors_addon.morph import PRESETS, MorphSettings, morph
from femors_addon.progress import FemorsError


# --- weights --------------------------------------------------------------------------------------
@pytest.mark.parametrize("nodes", [900, 2500])
def test_weights_hold_what_must_stay(nodes):
    """Exactly, whatever levels and mending come between; what is free still reaches the target."""
    source, target, _ = shapes.pair(nodes, nodes, seed=1)
    free = source.vertices[:, 2] < 200
    result = morph(source, target, STAY, weights=free.astype(float))
    assert np.array_equal(result.vertices[~free], source.vertices[~free])
    distance = result.surface_distance[source.vertices[:, 2] < 150]
    assert np.percentile(distance, 99) < 0.01 * target.diagonal
    assert result.after.flipped == 0


def test_a_share_is_a_share():
    pair = subjects()
    full = morph(pair.source, pair.target, STAY)
    for share in (0.0, 0.25, 1.0):
        part = morph(pair.source, pair.target, STAY, weights=np.full(len(pair.source.vertices), share))
        wanted = pair.source.vertices + share * (full.vertices - pair.source.vertices)
        assert part.vertices == pytest.approx(wanted, abs=1e-9)


def test_weights_of_a_soup():
    """A merged vertex takes the largest of its copies' weights, so that none tears off."""
    loose = soup(SMALL)
    weights = np.zeros(len(loose.vertices))
    weights[::2] = 1.0
    result = morph(loose, GOAL, STAY, weights=weights)
    _, group = np.unique(loose.vertices, axis=0, return_inverse=True)
    for one in range(0, 162, 20):
        assert len(np.unique(result.vertices[group.ravel() == one], axis=0)) == 1


def test_weights_are_told_not_to_hold_the_alignment():
    result = morph(SMALL, GOAL, weights=np.zeros(len(SMALL.vertices)))
    assert any("not the alignment" in warning for warning in result.warnings)


@pytest.mark.parametrize(
    "weights", [np.ones(3), np.full(162, np.nan), np.full(162, -0.1), np.full(162, 1.1), []]
)
def test_bad_weights_are_told(weights):
    with pytest.raises(FemorsError, match="162 numbers from 0 to 1"):
        morph(SMALL, GOAL, weights=weights)


# --- landmarks ------------------------------------------------------------------------------------
def test_landmarks_start_the_morph():
    pair, morphed = subjects(), subjects_morphed()
    at = [10, 200, 400, 600, 800]
    away = pair.source.moved(pair.source.vertices @ Rotation.random(random_state=9).as_matrix() + 1e3)
    result = morph(away, pair.target, source_landmarks=away.vertices[at], target_landmarks=pair.truth[at])
    assert np.linalg.norm(result.vertices - morphed.vertices, axis=1).mean() < 2e-3 * pair.target.diagonal


@pytest.mark.parametrize(
    ("ours", "theirs", "words"),
    [
        (np.eye(3), None, "both meshes"),
        (None, np.eye(3), "both meshes"),
        (np.eye(3), np.ones((2, 3)), "paired"),
        (np.eye(3)[:2], np.eye(3)[:2], "at least 3"),
        (np.full((3, 3), np.nan), np.eye(3), "not finite"),
        (np.ones((4, 3)), np.eye(4)[:, :3], "one line"),
    ],
)
def test_bad_landmarks_are_told(ours, theirs, words):
    with pytest.raises(FemorsError, match=words) as error:
        morph(SMALL, GOAL, source_landmarks=ours, target_landmarks=theirs)
    assert "\n" not in str(error.value)


# --- settings at their extremes -------------------------------------------------------------------
def extremes() -> list[tuple[str, object]]:
    """Every setting at its least, its most, and for lengths at what is far too small and too large."""
    out: list[tuple[str, object]] = []
    for name, (field, spec) in declared.specs(MorphSettings).items():
        if spec.choices:
            values: list[object] = [choice[0] for choice in spec.choices]
        elif isinstance(field.default, bool):
            values = [False, True]
        else:
            values = [spec.minimum, 1e9 if spec.maximum is None else spec.maximum]
            values += [1e-9] if spec.unit == "length" else []
        out += [(name, type(field.default)(value)) for value in values]
    return out


@pytest.mark.parametrize(("name", "value"), extremes())
@pytest.mark.parametrize(
    "base", [STAY, dataclasses.replace(PRESETS["published"], alignment="none")], ids=["own", "paper"]
)
def test_no_setting_breaks_the_morph(base, name, value):
    result = morph(SMALL, GOAL, dataclasses.replace(base, **{name: value}))
    assert finite(result, SMALL)
    assert result.stop_reason


def test_nothing_to_do_is_no_failure():
    """No iterations, no projection, no relaxation: the aligned source."""
    idle = MorphSettings(
        alignment="none", iterations=0, fine_iterations=0, dense_iterations=0, projection=0.0, relaxation=0
    )
    result = morph(SMALL, GOAL, idle)
    assert np.array_equal(result.vertices, SMALL.vertices)
    assert result.history == ()


def test_the_length_of_a_border_is_that_of_edges_with_one_face():
    """Not of every edge between two of its nodes: the square's diagonal."""
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert morph_fit._border_length(Surface(corners, [[0, 1, 2], [0, 2, 3]])) == 4.0
    assert morph_fit._border_length(SMALL) == 0.0
