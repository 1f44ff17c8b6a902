"""Open an exported .glb in Blender and render it. Runs in the environment that has bpy.

    python opened.py FOLDER

FOLDER holds `job.json` (`process.py` writes it); a picture (H, W, 4) a panorama is written beside
it, `NUMBER.npy`. Imports nothing of pbrfit but the worker, as a file.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np

sys.path.append(str(Path(__file__).parent))

from worker import Nodes, layer, render, set_up  # type: ignore[import-not-found]


def main(folder: Path) -> None:
    """Import, and render under each panorama."""
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=job["glb"])
    scene = bpy.context.scene
    [scene.camera] = [thing for thing in bpy.data.objects if thing.type == "CAMERA"]
    set_up(scene, job)
    scene.cycles.samples = job["samples"]
    for number, panorama in enumerate(job["panoramas"]):
        light(scene, panorama, job["turn"])
        np.save(folder / f"{number}.npy", layer(render(scene, folder), "Combined", "RGBA"))


def light(scene: Any, panorama: str, turn: float) -> None:
    """A panorama as the world, turned about Blender's Z by its Mapping node."""
    scene.world = bpy.data.worlds.new("panorama")
    nodes = Nodes(scene.world)
    generated = nodes.add("TexCoord").outputs["Generated"]
    turned = {"Vector": generated, "Rotation": (0, 0, np.radians(turn))}
    mapping = nodes.add("Mapping", turned).outputs["Vector"]
    picture = bpy.data.images.load(panorama)
    texture = nodes.add("TexEnvironment", {"Vector": mapping}, image=picture)
    [background] = [one for one in nodes.tree.nodes if one.type == "BACKGROUND"]
    nodes.tree.links.new(texture.outputs["Color"], background.inputs["Color"])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
