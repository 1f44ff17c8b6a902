"""Render a glTF model under panoramas with Cycles. Runs in the environment that has bpy.

    python helmet_in_cycles.py FOLDER

FOLDER holds `job.json` (`helmet_scene.py` writes it); `truth.npz` and `radiance.npy` are written
beside it. The camera is not turned, so its axes are the world's: X right, Y up, Z to the viewer.
Of pbrfit-evaluation only the worker is imported, as a file.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

sys.path.append(str(Path(__file__).parents[1] / "evaluation" / "pbrfit_evaluation" / "cycles"))

from worker import Nodes, layer, render, render_truth, set_up


def main(folder: Path) -> None:
    """Import the model, look at what is seen, render it under each light."""
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=job["model"])
    scene = bpy.context.scene
    set_up(scene, job)
    scene.render.resolution_x, scene.render.resolution_y = job["width"], job["height"]
    place(job)
    add_camera(scene, job)
    for material in bpy.data.materials:
        show_inputs(material)
    truth = render_truth(scene, folder)
    pictures = []
    scene.cycles.samples = job["samples"]
    scene.cycles.use_denoising = job["denoise"]
    for at, light in enumerate(job["lights"]):
        scene.cycles.seed = at
        scene.world = bpy.data.worlds.new(f"light {at}")
        scene.world.cycles.sampling_method = "MANUAL"
        scene.world.cycles.sample_map_resolution = 128
        under(Nodes(scene.world), light)
        seen = layer(render(scene, folder), "Combined", "RGBA")
        pictures.append(seen[..., :3])
        print(f"picture {at + 1} of {len(job['lights'])}", flush=True)
    np.savez(folder / "truth.npz", **truth)
    np.save(folder / "radiance.npy", np.stack(pictures))


def place(job: dict[str, Any]) -> None:
    """Stand the model upright in Y, turn it about Y, and leave out what is not to be seen."""
    # The importer turned Y up into Z up.
    back = Matrix.Rotation(-math.pi / 2, 4, "X")
    turned = Matrix.Rotation(math.radians(job["turn"]), 4, "Y") @ back
    for thing in list(bpy.data.objects):
        if any(name in thing.name for name in job["without"]):
            bpy.data.objects.remove(thing)
        elif thing.type == "MESH":
            thing.matrix_world = turned @ thing.matrix_world
            thing.pass_index = 1


def add_camera(scene: Any, job: dict[str, Any]) -> None:
    """In front of the model, towards -Z; `fov` in degrees is that of the width."""
    camera = bpy.data.cameras.new("camera")
    camera.sensor_fit = "HORIZONTAL"
    camera.angle = math.radians(job["fov"])
    camera.clip_start, camera.clip_end = 1e-3, 1e3
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.camera.location = job["camera"]
    scene.collection.objects.link(scene.camera)


def show_inputs(material: Any) -> None:
    """Put what feeds the surface into passes."""
    nodes = Nodes(material)
    [surface] = [one for one in nodes.tree.nodes if one.type == "BSDF_PRINCIPLED"]
    surface.distribution = "GGX"
    if surface.inputs["Alpha"].is_linked:
        nodes.tree.links.remove(surface.inputs["Alpha"].links[0])
    for name, key in (
        ("albedo", "Base Color"),
        ("roughness", "Roughness"),
        ("metallic", "Metallic"),
    ):
        source = surface.inputs[key]
        nodes.show(**{name: source.links[0].from_socket})


def under(nodes: Nodes, path: str) -> None:
    """Light of a panorama whose centre is at -Z and whose top is +Y."""
    x, y, z = nodes.add("SeparateXYZ", {0: nodes.add("TexCoord").outputs["Generated"]}).outputs
    # Blender's panorama is centred at +X, with its right at -Y and its top at +Z.
    turned = {"X": nodes.math("MULTIPLY", z, -1.0), "Y": nodes.math("MULTIPLY", x, -1.0), "Z": y}
    looked_up = nodes.add("CombineXYZ", turned).outputs[0]
    image = bpy.data.images.load(path, check_existing=True)
    texture = nodes.add("TexEnvironment", {"Vector": looked_up}, image=image)
    [background] = [node for node in nodes.tree.nodes if node.type == "BACKGROUND"]
    nodes.tree.links.new(texture.outputs["Color"], background.inputs["Color"])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
