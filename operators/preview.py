# SPDX-License-Identifier: GPL-3.0-or-later
"""The mesh that a running job moves, drawn over the viewport; no object and no data-block is touched."""

from __future__ import annotations

import contextlib
import time
from typing import Any, ClassVar

import bpy

from .lazy import Array, np

PAUSE = 0.2
"""Seconds between two pictures, at least; a slow display gets fewer (see `SHARE`)."""
SHARE = 0.2
"""Of the time that may go into drawing: the rest is for the user and the computation."""
COLOUR = (0.92, 0.36, 0.06)
"""Orange, which neither Blender's grey nor its selection outline is mistaken for."""

# a little nearer than it is: where it lies on the target already, the two would flicker
VERTEX = """
void main()
{
  turned = normal;
  gl_Position = ModelViewProjectionMatrix * vec4(pos, 1.0);
  gl_Position.z -= 0.0002 * gl_Position.w;
}
"""
FRAGMENT = """
void main()
{
  float facing = abs(dot(normalize(turned), towards));
  shade = vec4(colour * (0.25 + 0.75 * facing), 1.0);
}
"""


class View:
    """One moving mesh: a worker puts positions into it, the window draws the latest ones.

    Parameters
    ----------
    vertices : (n, 3) array
        World positions to begin with.
    triangles : (m, 3) int32 array
    """

    def __init__(self, vertices: Array, triangles: Array) -> None:
        self._triangles = np.ascontiguousarray(triangles, dtype=np.int32)
        self._count = len(vertices)
        self._fresh: tuple[Array, Array] | None = None
        self._batch: Any = None
        self._elements: Any = None
        self._next = 0.0
        self.pause = PAUSE
        self.pictures = 0

    def __call__(self, vertices: Array) -> None:
        """Take positions (n, 3) to be drawn soon: a `Preview`, called in the worker; cheap if too soon."""
        now = time.monotonic()
        if now < self._next or self._fresh is not None or len(vertices) != self._count:
            return
        self._next = now + self.pause
        points = np.ascontiguousarray(vertices, dtype=np.float32)
        self._fresh = (points, _normals(points, self._triangles))

    def free(self) -> None:
        """Give back what the graphics card holds; main thread only."""
        self._batch = self._elements = self._fresh = None

    @property
    def waiting(self) -> bool:
        """Whether there is something new to draw."""
        return self._fresh is not None

    def draw(self, shader: Any, towards: Any) -> None:
        """Draw in the viewport whose matrices are set; main thread only."""
        import gpu

        fresh, self._fresh = self._fresh, None
        if fresh is not None:
            form = gpu.types.GPUVertFormat()
            form.attr_add(id="pos", comp_type="F32", len=3, fetch_mode="FLOAT")
            form.attr_add(id="normal", comp_type="F32", len=3, fetch_mode="FLOAT")
            buffer = gpu.types.GPUVertBuf(form, self._count)
            buffer.attr_fill("pos", fresh[0])
            buffer.attr_fill("normal", fresh[1])
            if self._elements is None:
                self._elements = gpu.types.GPUIndexBuf(type="TRIS", seq=self._triangles)
            self._batch = gpu.types.GPUBatch(type="TRIS", buf=buffer, elem=self._elements)
            self.pictures += 1
        if self._batch is not None:
            shader.uniform_float("colour", COLOUR)
            shader.uniform_float("towards", towards)
            self._batch.draw(shader)


class Screen:
    """What is drawn now, and the handler that draws it."""

    views: ClassVar[list[View]] = []
    handler: ClassVar[Any] = None
    shader: ClassVar[Any] = None
    drawn: ClassVar[bool] = False
    seen: ClassVar[float] = 0.0


def show(views: list[View]) -> None:
    """Draw these in every 3D viewport from now on."""
    hide()
    if views and not bpy.app.background:
        Screen.views, Screen.seen, Screen.drawn = views, time.monotonic(), False
        Screen.handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")


def hide(redrawn: bool = True) -> None:
    """Draw nothing any more, and what is there anew; may be repeated."""
    handler, Screen.handler = Screen.handler, None
    for view in Screen.views:
        view.free()
    Screen.views = []
    if handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(handler, "WINDOW")
        if redrawn:
            tag_redraw()
    Screen.shader = None


def refresh(tick: float) -> None:
    """Ask for a redraw where there is something new to see; called every `tick` seconds.

    How late the call after a redraw comes tells what the redraw of the whole window takes, of which
    our drawing is the smallest part. A slow display gets few pictures.
    """
    now = time.monotonic()
    if Screen.drawn:
        for view in Screen.views:
            view.pause = max(PAUSE, (now - Screen.seen - tick) / SHARE)
    Screen.seen, Screen.drawn = now, False
    if any(view.waiting for view in Screen.views):
        tag_redraw()


def tag_redraw() -> None:
    """Draw the 3D viewports anew, in every window."""
    manager = bpy.context.window_manager
    for window in manager.windows if manager else ():
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "WINDOW":
                        region.tag_redraw()


def _draw() -> None:
    import gpu

    Screen.drawn = True
    if Screen.shader is None:
        Screen.shader = _shader()
    turn = np.array(bpy.context.region_data.view_matrix)[2, :3]
    with _depth(gpu.state):
        Screen.shader.bind()
        for view in Screen.views:
            view.draw(Screen.shader, turn.tolist())


@contextlib.contextmanager
def _depth(state: Any) -> Any:
    """Let nearer surfaces hide farther ones, and leave Blender's state as it was."""
    before = state.depth_test_get(), state.depth_mask_get()
    state.depth_test_set("LESS_EQUAL")
    state.depth_mask_set(True)
    try:
        yield
    finally:
        state.depth_test_set(before[0])
        state.depth_mask_set(before[1])


def _shader() -> Any:
    import gpu

    info = gpu.types.GPUShaderCreateInfo()
    info.vertex_in(0, "VEC3", "pos")
    info.vertex_in(1, "VEC3", "normal")
    between = gpu.types.GPUStageInterfaceInfo("femors_preview")
    between.smooth("VEC3", "turned")
    info.vertex_out(between)
    info.push_constant("MAT4", "ModelViewProjectionMatrix")
    info.push_constant("VEC3", "towards")
    info.push_constant("VEC3", "colour")
    info.fragment_out(0, "VEC4", "shade")
    info.vertex_source(VERTEX)
    info.fragment_source(FRAGMENT)
    return gpu.shader.create_from_info(info)


def _normals(points: Array, triangles: Array) -> Array:
    """Return (n, 3) float32 normals of the vertices, not of unit length."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    out = np.empty_like(points)
    for axis in range(3):
        out[:, axis] = np.bincount(triangles.ravel(), np.repeat(cross[:, axis], 3), minlength=len(points))
    return out
