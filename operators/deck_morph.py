# SPDX-License-Identifier: GPL-3.0-or-later
"""The morph of an object that is a part of a deck: the core's, in float64, with all elements inside."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import bpy

from ..femors_addon.progress import FemorsError, Preview, Progress, counted
from . import deck_scene, deck_store
from .deck_nodes import PartShot
from .lazy import Array, np
from .scene import Snapshot

if TYPE_CHECKING:
    from ..femors_addon.mesh import Surface
    from ..femors_addon.morph_result import MorphResult
    from ..femors_addon.morph_settings import MorphSettings


@dataclasses.dataclass(frozen=True, eq=False)
class PartSource:
    """A part of a deck as the source of a morph: its object, as it was, and the deck's zip."""

    shot: PartShot
    seen: Snapshot
    archive: bytes


@dataclasses.dataclass(frozen=True, eq=False)
class PartMorph:
    """A morphed part; for the rest of its figures, see `figures`.

    Attributes
    ----------
    figures : MorphResult
        With vertices (world), surface_distance and displacement by vertex of the object; the distance
        is 0 for what is not on the surface.
    known : (n, 3) float64
        Local positions by node of the part.
    elements : dict or None
        Figures of the elements as in `VolumeMorphResult.report`; None for shells.
    """

    figures: MorphResult
    known: Array
    elements: dict[str, Any] | None

    def __getattr__(self, name: str) -> Any:
        return getattr(self.figures, name)

    def report(self) -> dict[str, Any]:
        """Return everything but the arrays, for JSON."""
        elements = {} if self.elements is None else {"volume": self.elements}
        return {**self.figures.report(), **elements}


def source_of(item: bpy.types.Object, seen: Snapshot) -> PartSource | None:
    """Return what a morph needs of a part of a deck; None for any other object.

    Raises
    ------
    FemorsError
        Modifiers or shape keys are to count, the deck is gone, or the vertices are no longer its nodes.
    """
    if not deck_store.is_part(item):
        return None
    if seen.evaluated:
        raise FemorsError(
            f"'{item.name}' is a part of an FE model, which modifiers cannot change: untick Use Modifiers"
        )
    return PartSource(deck_scene.shot(item), seen, deck_store.archive_of(item))


def surface_of(item: bpy.types.Object, seen: Snapshot) -> Surface:
    """Return a target's surface, without the nodes inside a part of a deck."""
    from ..femors_addon.mesh import Surface

    if not deck_store.is_part(item):
        return Surface(seen.vertices, seen.triangles)
    used, triangles = np.unique(seen.triangles, return_inverse=True)
    return Surface(seen.vertices[used], triangles.reshape(-1, 3))


def morph(
    source: PartSource,
    target: Surface,
    settings: MorphSettings,
    progress: Progress,
    landmarks: Mapping[str, Any],
    preview: Preview | None = None,
) -> PartMorph:
    """Morph a part onto a target in world coordinates; a pure function, for the worker."""
    from ..femors_addon.deck_morph import morph_part
    from ..femors_addon.nearest import SurfaceIndex
    from ..femors_addon.transforms import transformed
    from ..femors_addon.volume_morph import VolumeMorphResult

    deck = deck_store.unpacked(source.archive)
    part, vertex, before = source.shot.of(deck), source.shot.vertices(deck), source.shot.nodes(deck)
    matrix = source.seen.matrix
    world = transformed(matrix, before)
    coordinates = np.array(deck.coordinates)
    coordinates[part.nodes] = world
    weights = None
    if source.seen.weights is not None:
        weights = np.ones(len(coordinates))
        weights[part.nodes] = source.seen.weights[vertex]
    placed = deck.with_coordinates(coordinates)
    node = np.argsort(vertex)  # of each vertex
    seen = None if preview is None else lambda moved: preview(moved[part.nodes][node])
    after, result = morph_part(
        placed, part, target, settings, progress, weights=weights, preview=seen, **landmarks
    )
    moved = after.coordinates[part.nodes]
    known = source.seen.to_local(moved)
    known[(moved == world).all(axis=1)] = before[(moved == world).all(axis=1)]  # to the very bit

    figures = result.surface if isinstance(result, VolumeMorphResult) else result
    mesh, nodes = after.submesh(part)
    surface = nodes[mesh.boundary.nodes]
    distance = np.zeros(len(coordinates))
    distance[surface] = SurfaceIndex(target).closest(after.coordinates[surface]).distance
    aligned = transformed(figures.transform, world)
    aligned[~np.isin(part.nodes, nodes)] = moved[~np.isin(part.nodes, nodes)]  # what no element uses stays
    figures = dataclasses.replace(
        figures,
        vertices=moved[node],
        surface_distance=distance[part.nodes][node],
        displacement=np.linalg.norm(moved - aligned, axis=1)[node],
    )
    elements = result.report()["volume"] if isinstance(result, VolumeMorphResult) else None
    return PartMorph(figures, known, elements)


def remember(item: bpy.types.Object, morphed: PartMorph, kind: str) -> None:
    """Keep the exact nodes with the mesh, or the shape key, that they were written to."""
    remember_nodes(item, morphed.known, kind)


def remember_nodes(item: bpy.types.Object, known: Array, kind: str) -> None:
    """Keep exact local nodes (n, 3) with the mesh, or the shape key, that they were written to."""
    mesh = item.data
    if kind == "SHAPE_KEY":
        key = mesh.shape_keys.key_blocks[item.active_shape_key_index].name
        deck_scene.remember(mesh, known, key)
        return
    deck_scene.forget_keys(mesh)
    deck_scene.remember(mesh, known)


def sentences(morphed: Any) -> tuple[list[str], list[str]]:
    """Return what to report of the elements, and what of it is a fault."""
    elements = getattr(morphed, "elements", None)
    if elements is None:
        return [], []
    before, after = elements["before"], elements["after"]
    faults = []
    if elements["inverted_on_input"]:
        faults.append(
            f"{counted(len(elements['inverted_on_input']), 'element')} inverted before, and left alone"
        )
    if elements["newly_inverted"]:
        faults.append(f"{counted(len(elements['newly_inverted']), 'element')} inverted")
    if elements["nodes_held_back"]:
        faults.append(
            f"{counted(elements['nodes_held_back'], 'node')} held back by up to "
            f"{elements['held_back_by']:.3g}, "
            "so that no element is inverted"
        )
    said = (
        f"scaled Jacobian min {after['minimum']:.3f} (was {before['minimum']:.3f}), "
        f"volume {round(elements['volume_change'], 3) + 0.0:+.1%}"
    )
    return [said], faults
