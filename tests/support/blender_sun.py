"""Render a sphere under Blender's sun with Cycles. Runs in the environment that has bpy.

    python blender_sun.py FOLDER AZIMUTH ELEVATION SIDE NAME...

NAME is ``matt``, or the roughness of a white metal; FOLDER/NAME.exr is written. A camera in Blender
looks along −Z with +Y up, so its space is ours. Nothing of pbrfit is imported here.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import bpy


def main(folder: Path, azimuth: float, elevation: float, side: int, names: list[str]) -> None:
    """Set up the sphere, the camera and the sun, and render once a material."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 256
    scene.cycles.pixel_filter_type = "BOX"  # a pixel is the mean of what it covers
    scene.cycles.max_bounces = 0
    scene.cycles.use_denoising = False
    scene.render.threads_mode = "FIXED"
    scene.render.threads = 1
    scene.render.resolution_x = scene.render.resolution_y = side
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.view_settings.view_transform = "Raw"
    scene.world = bpy.data.worlds.new("dark")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0

    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", 2.0
    scene.camera = bpy.data.objects.new("camera", camera)
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle = math.pi, 0.0  # irradiance π
    lamp = bpy.data.objects.new("sun", sun)
    # It shines along its −Z: +Z is tilted up first, and then turned about Y.
    lamp.rotation_euler = (-math.radians(elevation), math.radians(azimuth), 0.0)
    for thing in (scene.camera, lamp):
        scene.collection.objects.link(thing)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=256, ring_count=128, location=(0, 0, -5))
    bpy.ops.object.shade_smooth()
    sphere = bpy.context.object
    for name in names:
        sphere.data.materials.clear()
        sphere.data.materials.append(material(name))
        scene.render.filepath = str(folder / f"{name}.exr")
        bpy.ops.render.render(write_still=True)


def material(name: str) -> bpy.types.Material:
    """White: Lambert's, or GGX of that roughness without Fresnel."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes = made.node_tree.nodes
    nodes.clear()
    if name == "matt":
        surface = nodes.new("ShaderNodeBsdfDiffuse")
    else:
        surface = nodes.new("ShaderNodeBsdfAnisotropic")
        surface.distribution = "GGX"
        surface.inputs["Roughness"].default_value = float(name)
    surface.inputs["Color"].default_value = (1, 1, 1, 1)
    output = nodes.new("ShaderNodeOutputMaterial")
    made.node_tree.links.new(surface.outputs[0], output.inputs[0])
    return made


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4]), sys.argv[5:])
