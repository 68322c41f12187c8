# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of surfaces without a graphics card: triangles onto a grid, shaded, as PNG bytes."""

from __future__ import annotations

import dataclasses
import struct
import zlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .colours import from_linear, linear
from .mesh import Float, Int, Surface
from .raster import fragments
from .triples import unit

Colours = Float | tuple[float, float, float]
BONE = (0.83, 0.80, 0.74)
"""sRGB colour of a surface that shows no quantity."""
HEIGHT, LONG = 480, 720  # pixels: of a picture, and of one that is slender
SLENDER = 0.4  # width over height: of a long bone
FINER = 2  # samples across a pixel
MARGIN = 0.04  # of the picture, around what is shown


@dataclasses.dataclass(frozen=True, eq=False)
class Shown:
    """A surface in a picture: its sRGB colour (3,), or those of its vertices (n, 3) or faces (m, 3)."""

    surface: Surface
    colours: Colours = BONE


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

    def placed(self, points: Float, shape: tuple[int, int]) -> Float:
        """Return places (p, 2), across and down, of points (p, 3) in a picture of such rows and columns."""
        tall, wide = shape
        factor, centred = tall / (2.0 * self.scale), points - self.centre
        across, up = centred @ self.right * factor, centred @ self.up * factor
        return np.column_stack((across + wide / 2, tall / 2 - up))


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


@dataclasses.dataclass(frozen=True, eq=False)
class Look:
    """What is seen of surfaces in a view: drawn once, coloured as often as is asked for.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns of samples, `FINER` across each pixel.
    parts : tuple of (Surface, cells (k,), faces (k,), shares (k, 3), brightness (k,))
        For each surface the samples that show it, the face and the barycentric coordinates there, and how
        its light falls.
    """

    shape: tuple[int, int]
    parts: tuple[tuple[Surface, Int, Int, Float, Float], ...]

    @classmethod
    def of(cls, surfaces: Sequence[Surface], view: View, height: int = 0) -> Look:
        """Draw surfaces, lit from the eye's upper left; so many pixels tall, or as tall as suits."""
        height = height or (LONG if view.aspect < SLENDER else HEIGHT)
        tall = height * FINER
        wide = max(round(view.aspect * height), 16) * FINER
        light = unit((0.35 * view.up - 0.35 * view.right + view.towards)[None])[0]
        depth = np.full(tall * wide, -np.inf)
        owner = np.full(tall * wide, -1, dtype=np.int32)
        face, share = np.zeros(tall * wide, dtype=np.int32), np.zeros((tall * wide, 3))
        for number, surface in enumerate(surfaces):
            _draw(surface, view, (wide, tall), depth, owner, face, share, number)
        parts = []
        for number, surface in enumerate(surfaces):
            cells = np.flatnonzero(owner == number)
            faces, shares = face[cells], share[cells]
            normal = unit(_mixed(surface.vertex_normals, surface.faces[faces], shares))
            parts.append((surface, cells, faces, shares, 0.30 + 0.70 * np.abs(normal @ light)))
        return cls((tall, wide), tuple(parts))

    def coloured(self, colours: Sequence[Colours]) -> bytes:
        """Return a PNG on white; `colours` of each surface as in `Shown`."""
        tall, wide = self.shape
        image = np.ones((tall * wide, 3))
        for (surface, cells, faces, shares, brightness), given in zip(self.parts, colours, strict=True):
            ink = np.asarray(given, dtype=np.float64)
            by_vertex = ink.shape == surface.vertices.shape and ink.ndim == 2
            ink = linear(np.broadcast_to(ink, (1, 3)) if ink.ndim == 1 else ink)
            if by_vertex:
                ink = _mixed(ink, surface.faces[faces], shares)
            elif len(ink) > 1:
                ink = ink[faces]
            image[cells] = ink * brightness[:, None]
        fine = image.reshape(tall // FINER, FINER, wide // FINER, FINER, 3)
        small = np.asarray(sum(fine[:, k, :, m] for k in range(FINER) for m in range(FINER))) / FINER**2
        return png(np.clip(np.rint(255 * from_linear(small)), 0, 255).astype(np.uint8))


def picture(shown: Sequence[Shown], view: View, height: int = 0) -> bytes:
    """Return a PNG of surfaces on white, lit from the eye's upper left; its height as in `Look.of`."""
    return Look.of([one.surface for one in shown], view, height).coloured([one.colours for one in shown])


def _draw(
    surface: Surface,
    view: View,
    size: tuple[int, int],
    depth: Float,
    owner: Int,
    face: Int,
    share: Float,
    number: int,
) -> None:
    """Write a surface into the samples in which it is nearer than what was drawn before."""
    wide, tall = size
    flat = view.placed(surface.vertices, (tall, wide))
    nearness = ((surface.vertices - view.centre) @ view.towards)[surface.faces]
    for cells, faces, shares in fragments(flat[surface.faces], wide, tall):
        near = np.einsum("kc,kc->k", shares, nearness[faces])
        left = np.flatnonzero(near > depth[cells])
        while len(left):  # of several in one sample the last is written: the nearer ones come again
            at = cells[left]
            depth[at], owner[at], face[at], share[at] = near[left], number, faces[left], shares[left]
            left = left[near[left] > depth[at]]


def _mixed(values: Float, corners: Int, shares: Float) -> Float:
    """Return values (n, 3) of vertices, between the corners (k, 3) of faces by their shares (k, 3)."""
    out: Float = shares[:, :1] * values.take(corners[:, 0], axis=0)
    for k in (1, 2):
        out += shares[:, k, None] * values.take(corners[:, k], axis=0)
    return out


def png(pixels: NDArray[np.uint8]) -> bytes:
    """Return an image (h, w, 3) as a PNG file."""
    height, width, _ = pixels.shape
    rows = np.zeros((height, 1 + 3 * width), dtype=np.uint8)  # each row begins with its filter, none
    rows[:, 1:] = pixels.reshape(height, -1)

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = zlib.compress(rows.tobytes(), 6)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")
