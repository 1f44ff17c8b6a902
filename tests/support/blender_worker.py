"""Import a .glb into Blender and render it with Cycles. Runs in the environment that has bpy.

    python blender_worker.py FOLDER

FOLDER holds `job.json` (`blender_card.py` writes it); `facts.json`, `seen.npz` and a .npy a render
are written beside it. Of pbrfit-evaluation only the worker is imported, as a file.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np

sys.path.append(str(Path(__file__).parents[2] / "evaluation" / "pbrfit_evaluation" / "cycles"))

from worker import Nodes, layer, render, render_truth, set_up  # type: ignore[import-not-found]


def main(folder: Path) -> None:
    """Import, say what came of it, look at what is seen, render."""
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    scene, nodes, principled = imported(job)
    (folder / "facts.json").write_text(
        json.dumps(facts(principled, scene.camera.data)), encoding="utf-8"
    )
    names = {"albedo": "Base Color", "roughness": "Roughness", "metallic": "Metallic"}
    nodes.show(**{key: source(principled, name) for key, name in names.items()})
    np.savez(folder / "seen.npz", **render_truth(scene, folder))
    for of in job["renders"]:
        scene, nodes, principled = imported(job)
        light(scene, of)
        change(nodes, principled, of)
        scene.cycles.samples = of["samples"]
        np.save(folder / f"{of['name']}.npy", layer(render(scene, folder), "Combined", "RGBA"))


def imported(job: dict[str, Any]) -> tuple[Any, Nodes, Any]:
    """The scene, the nodes of its one material, and the surface among them."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=job["glb"])
    scene = bpy.context.scene
    [scene.camera] = [thing for thing in bpy.data.objects if thing.type == "CAMERA"]
    [card] = [thing for thing in bpy.data.objects if thing.type == "MESH"]
    if job["camera_only"]:
        card.visible_diffuse = card.visible_glossy = card.visible_shadow = False
    [material] = card.data.materials
    nodes = Nodes(material)
    set_up(scene, job)
    scene.render.resolution_y = job["height"]
    return scene, nodes, node(nodes, "BSDF_PRINCIPLED")


def node(nodes: Nodes, kind: str) -> Any:
    """The one node of a kind."""
    [found] = [one for one in nodes.tree.nodes if one.type == kind]
    return found


def source(of: Any, name: str) -> Any:
    """The socket that feeds an input."""
    return of.inputs[name].links[0].from_socket


def facts(principled: Any, camera: Any) -> dict[str, Any]:
    """What feeds each input of the surface, and the camera."""
    inputs = {}
    for name in ("Base Color", "Metallic", "Roughness", "Normal", "Alpha"):
        socket, path = principled.inputs[name], []
        while socket.is_linked:
            link = socket.links[0]
            feeds = link.from_node
            image = getattr(feeds, "image", None)
            path.append(
                [feeds.type, link.from_socket.name]
                + ([image.name, image.colorspace_settings.name] if image else [])
            )
            socket = next(
                (s for s in feeds.inputs if s.is_linked and s.name != "Vector"), feeds.inputs[0]
            )
        inputs[name] = path
    return {"inputs": inputs, "camera": camera.type}


def light(scene: Any, of: dict[str, Any]) -> None:
    """A panorama, turned about Blender's Z as the Mapping node of the world does it."""
    scene.world = bpy.data.worlds.new("panorama")
    nodes = Nodes(scene.world)
    generated = nodes.add("TexCoord").outputs["Generated"]
    turn = (0, 0, np.radians(of["turn"]))
    mapping = nodes.add("Mapping", {"Vector": generated, "Rotation": turn, "Scale": of["scale"]})
    picture = bpy.data.images.load(of["panorama"])
    texture = nodes.add("TexEnvironment", {"Vector": mapping.outputs["Vector"]}, image=picture)
    background = node(nodes, "BACKGROUND").inputs["Color"]
    nodes.tree.links.new(texture.outputs["Color"], background)


def change(nodes: Nodes, principled: Any, of: dict[str, Any]) -> None:
    """Make the change that a render asks for."""
    principled.distribution = of["distribution"]
    link = nodes.tree.links.new
    if of["flat"]:
        for one in principled.inputs["Normal"].links:
            nodes.tree.links.remove(one)
    if of["flip_green"]:
        normal = node(nodes, "NORMAL_MAP")
        red, green, blue = nodes.add("SeparateColor", {0: source(normal, "Color")}).outputs
        flipped = {0: red, 1: nodes.math("SUBTRACT", 1.0, green), 2: blue}
        link(nodes.add("CombineColor", flipped).outputs[0], normal.inputs["Color"])
    if of["diffuse"]:
        inputs = {"Color": source(principled, "Base Color")}
        if principled.inputs["Normal"].is_linked:
            inputs["Normal"] = source(principled, "Normal")
        diffuse = nodes.add("BsdfDiffuse", inputs)
        link(diffuse.outputs[0], node(nodes, "OUTPUT_MATERIAL").inputs["Surface"])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
