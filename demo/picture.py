# SPDX-License-Identifier: GPL-3.0-or-later
"""The demonstration's picture: source, target, result and displacement side by side, by Cycles."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

GAP = 158.0
"""Between two bones, in mm."""
WIDTH = 1600
INK = (0.03, 0.035, 0.05, 1.0)
# viridis at five even steps, as sRGB
RAMP = ("440154", "3b528b", "21918c", "5ec962", "fde725")
FACING = Matrix.Rotation(np.pi, 4, "Z") @ Matrix.Rotation(np.pi / 2, 4, "X")
"""Turns text and planes towards the camera, which looks along -y."""


def linear(code: str) -> tuple[float, float, float, float]:
    """Return an sRGB hex code as a linear colour."""
    srgb = np.array([int(code[i : i + 2], 16) / 255 for i in (0, 2, 4)])
    return (*np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4), 1.0)


def compose(source: Any, target: Any, result: Any, report: dict[str, Any]) -> Any:
    """Build the scene of the picture beside the working scene; return it."""
    scene = bpy.data.scenes.new("Picture")
    back = unpose(source, result)
    bone, wire = plain("Bone", (0.86, 0.78, 0.64, 1.0), 0.55), plain("Wire", (0.05, 0.04, 0.03, 1.0), 0.8)
    parts = by_attribute("Parts", "parts", None)
    moved = np.empty(len(result.data.vertices), dtype=np.float32)
    result.data.attributes["femors_displacement"].data.foreach_get("value", moved)
    top = float(np.ceil(np.percentile(moved, 99.5) / 5) * 5)
    heat = by_attribute("Displacement", "femors_displacement", top)
    place(scene, source, 0, Matrix(), parts, wire)
    place(scene, target, 1, back, bone, None)
    place(scene, result, 2, back, parts, wire)
    place(scene, result, 3, back, heat, None)
    tops = [(back @ v.co).z for v in target.data.vertices] + [v.co.z for v in source.data.vertices]
    height = max(tops)
    words(scene, source, target, result, report, height)
    legend(scene, top)
    light(scene)
    camera(scene, height)
    return scene


def unpose(source: Any, result: Any) -> Matrix:
    """Return the rigid motion that turns the result, and the target with it, as the source stands."""
    a = np.array([v.co[:] for v in result.data.vertices], dtype=np.float64)
    b = np.array([v.co[:] for v in source.data.vertices], dtype=np.float64)
    u, _, vt = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    turn = vt.T @ np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    out = np.eye(4)
    out[:3, :3] = turn
    out[:3, 3] = b.mean(0) - turn @ a.mean(0)
    out[2, 3] -= (a @ turn.T)[:, 2].min() + out[2, 3]  # standing on the ground, as the source does
    return Matrix(out.tolist())


def place(scene: Any, item: Any, slot: int, motion: Matrix, material: Any, wire: Any) -> None:
    """Put a copy with a material of its own into a slot, and its edges over it where a wire is given."""
    shift = Matrix.Translation((-GAP * slot, 0, 0))
    spin = Matrix.Rotation(np.radians(-18), 4, "Z")  # a little from the side shows more of the shape
    for kind in (material, wire):
        if kind is None:
            continue
        copy = bpy.data.objects.new(f"Picture {item.name} {kind.name}", item.data)
        scene.collection.objects.link(copy)
        copy.matrix_world = shift @ spin @ motion
        if not copy.material_slots:
            item.data.materials.append(None)
        copy.material_slots[0].link = "OBJECT"
        copy.material_slots[0].material = kind
        if kind is wire:
            modifier = copy.modifiers.new("Edges", "WIREFRAME")
            modifier.thickness, modifier.use_even_offset, modifier.offset = 0.45, False, 0.3


def plain(name: str, colour: tuple[float, ...], roughness: float) -> Any:
    """Return a material of one colour."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = colour
    shader.inputs["Roughness"].default_value = roughness
    return material


def by_attribute(name: str, attribute: str, top: float | None, glow: bool = False) -> Any:
    """Return a material coloured by a colour attribute, or by a number from 0 to `top`."""
    material = plain(name, (1, 1, 1, 1), 0.55)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    read = nodes.new("ShaderNodeAttribute")
    read.attribute_name = attribute
    colour = read.outputs["Color"]
    if top is not None:
        span = nodes.new("ShaderNodeMapRange")
        span.inputs["From Max"].default_value = top
        links.new(read.outputs["Fac"], span.inputs["Value"])
        ramp = nodes.new("ShaderNodeValToRGB")
        for i, code in enumerate(RAMP):
            at = i / (len(RAMP) - 1)
            ends = ramp.color_ramp.elements
            stop = ends[0] if i == 0 else ends[-1] if i == len(RAMP) - 1 else ends.new(at)
            stop.color = linear(code)
        links.new(span.outputs["Result"], ramp.inputs["Fac"])
        colour = ramp.outputs["Color"]
    if glow:
        shader = nodes.new("ShaderNodeEmission")
        links.new(colour, shader.inputs["Color"])
        links.new(shader.outputs["Emission"], nodes["Material Output"].inputs["Surface"])
    else:
        links.new(colour, nodes["Principled BSDF"].inputs["Base Color"])
    return material


def write(
    scene: Any, text: str, x: float, z: float, size: float, align: str = "CENTER", ink: Any = None
) -> None:
    """Put a line of text before the bones."""
    curve = bpy.data.curves.new(text[:20], "FONT")
    curve.body, curve.size, curve.align_x = text, size, align
    item = bpy.data.objects.new(f"Text {text[:20]}", curve)
    scene.collection.objects.link(item)
    item.matrix_world = Matrix.Translation((x, 150, z)) @ FACING
    name = "Ink" if ink is None else "Faint ink"
    material = bpy.data.materials.get(name)
    if material is None:
        material = bpy.data.materials.new(name)
        material.use_nodes = True
        nodes = material.node_tree.nodes
        shader = nodes.new("ShaderNodeEmission")
        shader.inputs["Color"].default_value = ink or INK
        material.node_tree.links.new(shader.outputs["Emission"], nodes["Material Output"].inputs["Surface"])
    curve.materials.append(material)


def words(scene: Any, source: Any, target: Any, result: Any, report: dict[str, Any], height: float) -> None:
    """Write the labels above and the figures below."""
    faint = (0.16, 0.17, 0.2, 1.0)
    labels = (
        ("Source", f"{len(source.data.vertices)} nodes, regions marked"),
        ("Target", f"{len(target.data.vertices)} nodes, meshed by itself"),
        ("Result", "the source's mesh in the target's shape"),
        ("Displacement", "beyond the alignment"),
    )
    for slot, (title, line) in enumerate(labels):
        write(scene, title, -GAP * slot, height + 40, 20)
        write(scene, line, -GAP * slot, height + 23, 9.2, ink=faint)
    after, error = report["after"], report["error_against_known_correspondence"]
    distance = after["target_to_surface"]
    line = (
        f"target to result: median {distance['median']:.3f}, max {distance['maximum']:.2f} mm"
        f"      every node against its true place: median {error['median']:.2f} mm"
        f"      flipped {after['flipped']}, self-intersections {after['self_intersecting']}"
    )
    write(scene, line, -1.5 * GAP, -32, 10, ink=faint)


def legend(scene: Any, top: float) -> None:
    """Draw the colour bar of the displacement, in mm."""
    steps, height, wide = 64, 150.0, 8.0
    level = np.linspace(0, 1, steps + 1)
    vertices = [(side * wide, 0, height * at) for at in level for side in (0, 1)]
    faces = [(2 * i, 2 * i + 1, 2 * i + 3, 2 * i + 2) for i in range(steps)]
    mesh = bpy.data.meshes.new("Legend")
    mesh.from_pydata(vertices, [], faces)
    values = mesh.attributes.new("femors_displacement", "FLOAT", "POINT")
    values.data.foreach_set("value", np.repeat(level * top, 2).astype(np.float32))
    mesh.materials.append(by_attribute("Legend", "femors_displacement", top, glow=True))
    item = bpy.data.objects.new("Legend", mesh)
    scene.collection.objects.link(item)
    x, z = -3 * GAP - 62, 125.0
    item.matrix_world = Matrix.Translation((x, 150, z))
    for at in (0.0, 0.5, 1.0):
        number = f"{at * top:g}" + (" mm" if at == 1 else "")
        write(scene, number, x - 4, z + at * height - 3.2, 9.2, "LEFT")


def light(scene: Any) -> None:
    """Light from the upper left, softly filled, before a light ground."""
    world = scene.world = bpy.data.worlds.new("Picture")
    world.use_nodes = True
    ground = world.node_tree.nodes["Background"]
    ground.inputs["Color"].default_value = (0.93, 0.945, 0.96, 1.0)
    ground.inputs["Strength"].default_value = 1.0
    # what the camera sees is light, what lights the bones is dim: the sun then models them
    nodes, links = world.node_tree.nodes, world.node_tree.links
    path, dim, mix = (nodes.new(f"ShaderNode{n}") for n in ("LightPath", "Background", "MixShader"))
    dim.inputs["Color"].default_value = (0.80, 0.86, 1.0, 1.0)
    dim.inputs["Strength"].default_value = 0.32
    links.new(path.outputs["Is Camera Ray"], mix.inputs["Fac"])
    links.new(dim.outputs["Background"], mix.inputs[1])
    links.new(ground.outputs["Background"], mix.inputs[2])
    links.new(mix.outputs["Shader"], nodes["World Output"].inputs["Surface"])
    for name, strength, angle, turn in (("Key", 2.1, 12, (-50, 0, 215)), ("Fill", 0.4, 40, (-70, 0, 120))):
        lamp = bpy.data.lights.new(name, "SUN")
        lamp.energy, lamp.angle = strength, np.radians(angle)
        item = bpy.data.objects.new(name, lamp)
        scene.collection.objects.link(item)
        item.rotation_euler = np.radians((abs(turn[0]), 0, turn[2]))


def camera(scene: Any, height: float) -> None:
    """Look along -y, without perspective, at all of it."""
    lens = bpy.data.cameras.new("Camera")
    lens.type, lens.ortho_scale, lens.clip_end = "ORTHO", 3 * GAP + 192, 5000.0
    item = bpy.data.objects.new("Camera", lens)
    scene.collection.objects.link(item)
    item.matrix_world = Matrix.Translation((-1.5 * GAP - 12, 1500, (height + 64 - 44) / 2)) @ FACING
    scene.camera = item
    scene.render.resolution_x = WIDTH
    scene.render.resolution_y = 2 * round(WIDTH * (height + 64 + 44) / lens.ortho_scale / 2)


def denoiser_there() -> bool:
    """Whether this build of Cycles has its denoiser; Debian's may lack it, and would then fail."""
    try:
        import _cycles
    except ImportError:
        return False
    return bool(getattr(_cycles, "with_openimagedenoise", False))


def render(scene: Any, path: Path, samples: int, width: int) -> None:
    """Render to a PNG; the file appears when it is whole."""
    settings = scene.render
    settings.engine = "CYCLES"
    scene.cycles.samples = samples
    scene.cycles.use_denoising = denoiser_there()
    scene.cycles.max_bounces = 4
    settings.resolution_percentage = round(100 * width / WIDTH)
    scene.view_settings.view_transform = "Standard"
    settings.image_settings.file_format = "PNG"
    settings.image_settings.color_mode = "RGB"
    settings.image_settings.compression = 100
    settings.dither_intensity = 0.0  # its noise would double the file
    temporary = path.with_name(f".{path.stem}.part.png")
    settings.filepath = str(temporary)
    bpy.ops.render.render(write_still=True, scene=scene.name)
    os.replace(temporary, path)
