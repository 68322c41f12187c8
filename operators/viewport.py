# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture of what a 3D viewport shows, drawn off screen."""

from __future__ import annotations

import bpy

from .lazy import np

WIDTH = 960


def picture(context: bpy.types.Context) -> bytes | None:
    """Return the first 3D viewport of the window as a PNG; None where there is no window to draw with."""
    if bpy.app.background or context.window is None:
        return None
    area = next((one for one in context.window.screen.areas if one.type == "VIEW_3D"), None)
    if area is None:
        return None
    import gpu

    from ..femors_addon.picture import png

    region = next(one for one in area.regions if one.type == "WINDOW")
    space = area.spaces.active
    tall = max(round(WIDTH * region.height / max(region.width, 1)), 16)
    screen = gpu.types.GPUOffScreen(WIDTH, tall)
    try:
        screen.draw_view3d(
            context.scene,
            context.view_layer,
            space,
            region,
            space.region_3d.view_matrix,
            space.region_3d.window_matrix,
            do_color_management=True,
        )
        with screen.bind():
            buffer = gpu.state.active_framebuffer_get().read_color(0, 0, WIDTH, tall, 4, 0, "UBYTE")
    finally:
        screen.free()
    buffer.dimensions = 4 * WIDTH * tall
    pixels = np.array(buffer.to_list(), dtype=np.uint8).reshape(tall, WIDTH, 4)
    return png(np.ascontiguousarray(pixels[::-1, :, :3]))
