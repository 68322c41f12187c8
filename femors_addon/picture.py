# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of surfaces without a graphics card: triangles onto a grid, shaded, as PNG bytes."""

from __future__ import annotations

import dataclasses
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from .colours import from_linear, linear
from .mesh import Float, Surface
from .raster import fragments
from .triples import unit

BONE = (0.83, 0.80, 0.74)
"""sRGB colour of a surface that shows no quantity."""
FINER = 2  # samples across a pixel
MARGIN = 0.04  # of the picture, around what is shown


@dataclasses.dataclass(frozen=True, eq=False)
class Shown:
    """A surface in a picture: its sRGB colour (3,), or those of its vertices (n, 3) or faces (m, 3)."""

    surface: Surface
    colours: Float | tuple[float, float, float] = BONE


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """A direction of sight, without perspective.

    Attributes
    ----------
    right, up, towards : (3,) float64
        Axes of the picture, and towards the eye.
    centre : (3,) float64
        What is in its middle.
    scale : float
        Length of a picture's half height.
    aspect : float
        Width over height.
    """

    right: Float
    up: Float
    towards: Float
    centre: Float
    scale: float
    aspect: float


def views(surfaces: list[Surface], count: int = 2) -> list[View]:
    """Return views that show all surfaces whole, upright along their longest axis, a quarter turn apart."""
    points = np.concatenate([surface.vertices[np.unique(surface.faces)] for surface in surfaces])
    centre = points.mean(axis=0)
    axes = np.linalg.svd((points - centre)[:: max(len(points) // 20_000, 1)], full_matrices=False)[2]
    up = axes[0] * (np.sign(axes[0][np.argmax(np.abs(axes[0]))]) or 1.0)
    first = axes[2]
    out = []
    for number in range(count):
        angle = np.pi * number / count
        towards = np.cos(angle) * first + np.sin(angle) * np.cross(up, first)
        right = np.cross(up, towards)
        across, along = (points - centre) @ right, (points - centre) @ up
        middle = centre + right * (across.min() + np.ptp(across) / 2) + up * (along.min() + np.ptp(along) / 2)
        half = np.ptp(along) / 2 * (1 + 2 * MARGIN)
        aspect = max(np.ptp(across) / max(np.ptp(along), 1e-300), 0.25) * (1 + MARGIN)
        out.append(View(right, up, towards, middle, float(max(half, 1e-300)), float(min(aspect, 2.0))))
    return out


def facing(sight: View, points: list[Float]) -> View:
    """Return a view, or that from behind where things' points, (p, 3) each, are on that side."""
    depth = sum(float(((some - sight.centre) @ sight.towards).mean()) for some in points)
    return sight if depth >= 0 else dataclasses.replace(sight, right=-sight.right, towards=-sight.towards)


def picture(shown: list[Shown], view: View, height: int = 480) -> bytes:
    """Return a PNG of surfaces on white, lit from the eye's upper left."""
    tall = height * FINER
    wide = max(round(view.aspect * height), 16) * FINER
    depth = np.full(tall * wide, -np.inf)
    image = np.ones((tall * wide, 3))
    light = unit((0.35 * view.up - 0.35 * view.right + view.towards)[None])[0]
    for one in shown:
        _draw(one, view, light, depth, image, wide, tall)
    small = image.reshape(height, FINER, wide // FINER, FINER, 3).mean(axis=(1, 3))
    return png(np.clip(np.rint(255 * from_linear(small)), 0, 255).astype(np.uint8))


def _draw(one: Shown, view: View, light: Float, depth: Float, image: Float, wide: int, tall: int) -> None:
    surface = one.surface
    centred = surface.vertices - view.centre
    factor = tall / (2.0 * view.scale)
    flat = np.column_stack((centred @ view.right * factor + wide / 2, tall / 2 - centred @ view.up * factor))
    nearness = centred @ view.towards
    normals = surface.vertex_normals
    colours = np.asarray(one.colours, dtype=np.float64)
    by_vertex = colours.shape == surface.vertices.shape and colours.ndim == 2
    colours = linear(np.broadcast_to(colours, (1, 3)) if colours.ndim == 1 else colours)
    for cell, face, share in fragments(flat[surface.faces], wide, tall):
        corners = surface.faces[face]
        near = np.einsum("kc,kc->k", share, nearness[corners])
        order = np.argsort(near, kind="stable")  # of several in one cell the nearest is written last
        order = order[near[order] > depth[cell[order]]]
        cell, face, share, near, corners = cell[order], face[order], share[order], near[order], corners[order]
        normal = unit(np.einsum("kc,kcd->kd", share, normals[corners]))
        facing = np.abs(normal @ light)
        if by_vertex:
            colour = np.einsum("kc,kcd->kd", share, colours[corners])
        else:
            colour = colours[face] if len(colours) > 1 else colours
        depth[cell] = near
        image[cell] = colour * (0.30 + 0.70 * facing)[:, None]


def png(pixels: NDArray[np.uint8]) -> bytes:
    """Return an image (h, w, 3) as a PNG file."""
    height, width, _ = pixels.shape
    rows = np.zeros((height, 1 + 3 * width), dtype=np.uint8)  # each row begins with its filter, none
    rows[:, 1:] = pixels.reshape(height, -1)

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = zlib.compress(rows.tobytes(), 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")
