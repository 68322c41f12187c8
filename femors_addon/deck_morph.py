# SPDX-License-Identifier: GPL-3.0-or-later
"""The morph of a part of a deck: of shells by their nodes, of solids by their surface and what is in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import morph as surfaces
from .deck import ALL, Deck, Part
from .mesh import Float, Surface
from .morph_result import MorphResult
from .morph_settings import MorphSettings
from .progress import FemorsError, Preview, Progress, counted, silent
from .transforms import transformed
from .volume import carry_mid_nodes
from .volume_morph import VolumeMorphResult, at_nodes, morph_volume
from .volume_quality import scaled_jacobians


def morph_part(
    deck: Deck,
    part: Part,
    target: Surface,
    settings: MorphSettings | None = None,
    progress: Progress = silent,
    *,
    weights: ArrayLike | None = None,
    source_landmarks: ArrayLike | None = None,
    target_landmarks: ArrayLike | None = None,
    landmark_names: Sequence[str] | None = None,
    morph: Any = None,
    preview: Preview | None = None,
) -> tuple[Deck, MorphResult | VolumeMorphResult]:
    """Morph a part of a deck onto a surface.

    Only the nodes of the part's elements move; mid-side nodes of shells go with their edges.

    Parameters
    ----------
    deck, part : Deck, Part
    target : Surface
    settings, progress, source_landmarks, target_landmarks, landmark_names
        As for `morph.morph`.
    weights : (n,) array, optional
        Of the deck's nodes, from 0 to 1: how far each may follow.
    morph : callable, optional
        What morphs surfaces, in place of `morph.morph`.
    preview : Preview, optional
        Given all of the deck's coordinates (n, 3).

    Returns
    -------
    deck : Deck
        At its new coordinates.
    result : MorphResult or VolumeMorphResult
        The latter where the part has solid elements.

    Raises
    ------
    FemorsError, Cancelled
        As `morph.morph`.
    """
    mesh, nodes = deck.submesh(part)
    settings = settings or MorphSettings()
    options: dict[str, Any] = {
        "source_landmarks": source_landmarks,
        "target_landmarks": target_landmarks,
        "landmark_names": landmark_names,
    }
    share = None if weights is None else np.asarray(weights, dtype=float).ravel()[nodes]
    coordinates = np.array(deck.coordinates)
    if preview is not None:
        options["preview"] = at_nodes(preview, deck.coordinates, nodes)
    result: MorphResult | VolumeMorphResult
    if mesh.solid:
        result = morph_volume(mesh, target, settings, progress, weights=share, **options)
        coordinates[nodes] = result.nodes
    else:
        surface, on_faces = mesh.surface()
        if share is not None:
            options["weights"] = share[on_faces]
        if preview is not None:
            options["preview"] = at_nodes(options["preview"], mesh.nodes, on_faces)
        result = (morph or surfaces.morph)(surface, target, settings, progress, **options)
        aligned = transformed(result.transform, mesh.nodes)
        moved = aligned.copy()
        moved[on_faces] = result.vertices
        coordinates[nodes] = carry_mid_nodes(mesh, moved, aligned)
    _refuse_torn(deck, part, coordinates)
    return deck.with_coordinates(coordinates), result


def _refuse_torn(deck: Deck, part: Part, coordinates: Float) -> None:
    """Refuse coordinates (n, 3) that invert elements which share nodes with a part but are not of it."""
    outside = np.ones(deck.mesh.element_count, dtype=bool)
    outside[part.elements] = False
    valid = outside & (scaled_jacobians(deck.mesh) > 0)
    torn = np.flatnonzero(valid & (scaled_jacobians(deck.mesh.moved(coordinates)) <= 0))
    if len(torn):
        raise FemorsError(
            f"{counted(len(torn), 'element')} outside '{part.name}' would be inverted, by nodes "
            "shared with it (first: "
            f"element {int(deck.mesh.element_ids[torn[0]])}); morph a set that holds them, or --part {ALL}"
        )
