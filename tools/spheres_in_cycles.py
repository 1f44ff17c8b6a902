"""Render spheres under panoramas with Cycles. Runs in the environment that has bpy.

    python spheres_in_cycles.py FOLDER JOB

JOB is JSON: `side`, `samples`, `panoramas` (paths by name) and `surfaces` ([albedo, roughness,
metallic] by name). FOLDER/PANORAMA-SURFACE.npy is written, (side, side, 3). A camera in Blender
looks along −Z with +Y up, so its space is ours. Of pbrfit-evaluation only the worker is imported,
as a file.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import bpy
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "evaluation" / "pbrfit_evaluation" / "cycles"))

from worker import Nodes, layer, new_material, render, set_up  # type: ignore[import-not-found]


def main(folder: Path, job: dict) -> None:  # type: ignore[type-arg]
    """One sphere, rendered once a panorama and surface."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    no_bounces = dict.fromkeys(("all", "diffuse", "glossy"), 0)
    set_up(scene, {"size": job["side"], "threads": 2, "seed": 0, "bounces": no_bounces})
    scene.cycles.samples = job["samples"]
    scene.cycles.pixel_filter_type = "BOX"  # a pixel is the mean of what it covers
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", 2.0
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.collection.objects.link(scene.camera)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=256, ring_count=128, location=(0, 0, -5))
    bpy.ops.object.shade_smooth()
    sphere = bpy.context.object
    for panorama, path in job["panoramas"].items():
        scene.world = bpy.data.worlds.new(panorama)
        under(Nodes(scene.world), path)
        for surface, (albedo, roughness, metallic) in job["surfaces"].items():
            material, nodes = new_material(surface)
            inputs = {
                "Base Color": (albedo, albedo, albedo, 1),
                "Roughness": roughness,
                "Metallic": metallic,
            }
            made = nodes.add("BsdfPrincipled", inputs)
            nodes.add("OutputMaterial", {"Surface": made.outputs[0]})
            sphere.data.materials.clear()
            sphere.data.materials.append(material)
            seen = layer(render(scene, folder), "Combined", "RGB")
            np.save(folder / f"{panorama}-{surface}.npy", seen)


def under(nodes: Nodes, path: str) -> None:
    """Light of a panorama whose centre is at −Z and whose top is +Y.

    Blender's is centred at +X, with its right at −Y and its top at +Z: (x, y, z) is looked up at
    (−z, −x, y).
    """
    x, y, z = nodes.add("SeparateXYZ", {0: nodes.add("TexCoord").outputs["Generated"]}).outputs
    turned = {"X": nodes.math("MULTIPLY", z, -1.0), "Y": nodes.math("MULTIPLY", x, -1.0), "Z": y}
    vector = nodes.add("CombineXYZ", turned).outputs[0]
    texture = nodes.add("TexEnvironment", {"Vector": vector}, image=bpy.data.images.load(path))
    [background] = [node for node in nodes.tree.nodes if node.type == "BACKGROUND"]
    nodes.tree.links.new(texture.outputs["Color"], background.inputs["Color"])


if __name__ == "__main__":
    main(Path(sys.argv[1]), json.loads(sys.argv[2]))
