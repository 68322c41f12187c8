# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator `femors.animate`: the slider of a result from 0 to 1, as a film.

No ``from __future__ import annotations`` here: Blender reads annotations as property definitions.
"""

from typing import ClassVar

import bpy

from .result import KEY_PREFIX


def shape_key(item: bpy.types.Object | None) -> bpy.types.ShapeKey | None:
    """Return the latest shape key that a job has made, or None."""
    keys = item.data.shape_keys if item is not None and item.type == "MESH" else None
    if keys is None or not keys.use_relative:
        return None
    ours = [key for key in keys.key_blocks[1:] if key.name.startswith((KEY_PREFIX, "FEMORS"))]
    active = item.active_shape_key
    return active if active in ours else (ours[-1] if ours else None)


class FEMORS_OT_animate(bpy.types.Operator):
    """Key the result's shape key from 0 to 1, so that playing shows the source turn into the result"""

    bl_idname = "femors.animate"
    bl_label = "Animate Shape Key"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    start: bpy.props.IntProperty(
        name="First Frame",
        description="Where the slider is 0; left out, the scene's first frame",
        default=1,
        options={"SKIP_SAVE"},
    )
    frames: bpy.props.IntProperty(
        name="Frames", description="From 0 to 1", default=60, min=1, max=100000, options={"SKIP_SAVE"}
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The active object must have such a shape key."""
        message, item = "", context.object
        if context.mode != "OBJECT":
            message = "Leave Edit Mode or painting first"
        elif item is None or item.type != "MESH":
            message = "Select the result of a morph"
        elif item.library is not None or item.data.library is not None:
            message = "The mesh is linked from another file"
        elif shape_key(item) is None:
            message = "Only a Shape Key can be animated: morph with Result set to Shape Key"
        if message:
            cls.poll_message_set(message)
        return not message

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Set two keys, in place of earlier ones, and go to the first."""
        key = shape_key(context.object)
        scene = context.scene
        start = self.start if self.properties.is_property_set("start") else scene.frame_start
        key.driver_remove("value")
        action = key.id_data.animation_data and key.id_data.animation_data.action
        if action is not None:
            self._forget(key)
        for frame, value in ((start, 0.0), (start + self.frames, 1.0)):
            key.value = value
            key.keyframe_insert("value", frame=frame)
        scene.frame_end = max(scene.frame_end, start + self.frames)
        scene.frame_set(start)
        self.report({"INFO"}, f"'{key.name}' goes from 0 to 1 in frames {start} to {start + self.frames}")
        return {"FINISHED"}

    @staticmethod
    def _forget(key: bpy.types.ShapeKey) -> None:
        """Take away the keyframes that the slider has."""
        keys = key.id_data
        for frame in sorted({round(f) for f in _frames(keys, key.path_from_id("value"))}):
            key.keyframe_delete("value", frame=frame)


def _frames(keys: bpy.types.Key, path: str) -> list[float]:
    """Return the frames of a data path's keyframes, in old actions and in those with layers (4.4)."""
    action = keys.animation_data.action
    curves = list(getattr(action, "fcurves", ()))
    if not curves:
        for layer in getattr(action, "layers", ()):
            for strip in layer.strips:
                for bag in strip.channelbags:
                    curves += list(bag.fcurves)
    return [point.co[0] for curve in curves if curve.data_path == path for point in curve.keyframe_points]


classes = (FEMORS_OT_animate,)
