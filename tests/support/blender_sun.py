"""Render a sphere under Blender's sun with Cycles. Runs in the environment that has bpy.

    python blender_sun.py FOLDER AZIMUTH ELEVATION SIDE NAME...

NAME is ``matt``, or the roughness of a white metal; FOLDER/NAME.npy is written. A camera in Blender
looks along −Z with +Y up, so its space is ours. Of pbrfit-evaluation only the worker is imported,
as a file.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import bpy
import numpy as np

sys.path.append(str(Path(__file__).parents[2] / "evaluation" / "pbrfit_evaluation" / "cycles"))

from worker import layer, new_material, render, set_up  # type: ignore[import-not-found]


def main(folder: Path, azimuth: float, elevation: float, side: int, names: list[str]) -> None:
    """Set up the sphere, the camera and the sun, and render once a material."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    no_bounces = dict.fromkeys(("all", "diffuse", "glossy"), 0)
    set_up(scene, {"size": side, "threads": 1, "seed": 0, "bounces": no_bounces})
    scene.cycles.samples = 256
    scene.cycles.pixel_filter_type = "BOX"  # a pixel is the mean of what it covers
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
        material, nodes = new_material(name)
        if name == "matt":  # Lambert's
            surface = nodes.add("BsdfDiffuse", {"Color": (1, 1, 1, 1)})
        else:  # GGX of that roughness without Fresnel
            inputs = {"Color": (1, 1, 1, 1), "Roughness": float(name)}
            surface = nodes.add("BsdfAnisotropic", inputs, distribution="GGX")
        nodes.add("OutputMaterial", {"Surface": surface.outputs[0]})
        sphere.data.materials.clear()
        sphere.data.materials.append(material)
        np.save(folder / f"{name}.npy", layer(render(scene, folder), "Combined", "RGB"))


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4]), sys.argv[5:])
