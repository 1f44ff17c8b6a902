"""Import a .glb into Blender and render it with Cycles. Runs in the environment that has bpy.

    python blender_worker.py FOLDER

FOLDER holds `job.json` (`blender_card.py` writes it); `facts.json`, `seen.npz` and a .npy a render
are written beside it. Nothing of pbrfit is imported here.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import OpenEXR
from numpy.typing import NDArray


def main(folder: Path) -> None:
    """Import, say what came of it, look at what is seen, render."""
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=job["glb"])
    scene = bpy.context.scene
    [camera] = [thing for thing in bpy.data.objects if thing.type == "CAMERA"]
    [card] = [thing for thing in bpy.data.objects if thing.type == "MESH"]
    [material] = card.data.materials
    scene.camera = camera
    tree = material.node_tree
    [principled] = [node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"]
    (folder / "facts.json").write_text(json.dumps(facts(principled, camera.data)), encoding="utf-8")
    if job["camera_only"]:
        card.visible_diffuse = card.visible_glossy = card.visible_shadow = False
    set_up(scene, job)
    np.savez(folder / "seen.npz", allow_pickle=False, **seen(scene, folder, tree, principled))
    for of in job["renders"]:
        light(scene.world, of)
        undo = change(tree, principled, of)
        scene.cycles.samples = of["samples"]
        channels = render(scene, folder)
        np.save(folder / f"{of['name']}.npy", stacked(channels, "Combined", "RGBA"))
        undo()


def facts(principled: Any, camera: Any) -> dict[str, Any]:
    """What feeds each input of the surface, and the camera."""
    inputs = {}
    for name in ("Base Color", "Metallic", "Roughness", "Normal", "Alpha"):
        socket, path = principled.inputs[name], []
        while socket.is_linked:
            link = socket.links[0]
            node = link.from_node
            image = getattr(node, "image", None)
            path.append(
                [node.type, link.from_socket.name]
                + ([image.name, image.colorspace_settings.name] if image else [])
            )
            socket = next(
                (s for s in node.inputs if s.is_linked and s.name != "Vector"), node.inputs[0]
            )
        inputs[name] = path
    return {
        "blender": bpy.app.version_string,
        "inputs": inputs,
        "camera": camera.type,
        "horizontal": float(np.degrees(camera.angle_x)),
        "vertical": float(np.degrees(camera.angle_y)),
    }


def set_up(scene: Any, job: dict[str, Any]) -> None:
    """Cycles without any setting that trades truth for looks; one light path segment."""
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = job["size"]
    render.resolution_percentage = 100
    render.film_transparent = True
    render.use_compositing = render.use_sequencer = False
    render.threads_mode, render.threads = "FIXED", job["threads"]
    if hasattr(render.image_settings, "media_type"):  # Blender 5
        render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    render.image_settings.color_depth = "32"
    render.image_settings.exr_codec = "NONE"
    cycles.device = "CPU"
    cycles.seed = 1
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.light_sampling_threshold = cycles.blur_glossy = 0.0
    cycles.max_bounces = 0
    # Rays through a hundredth of a pixel about its centre: texels one by one.
    cycles.pixel_filter_type, cycles.filter_width = "GAUSSIAN", 0.01
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True


def light(world: Any, of: dict[str, Any]) -> None:
    """A panorama, turned about Blender's Z as the Mapping node of the world does it."""
    tree = world.node_tree
    tree.nodes.clear()
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    mapping = tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Rotation"].default_value = (0, 0, np.radians(of["turn"]))
    mapping.inputs["Scale"].default_value = of["scale"]
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(of["panorama"], check_existing=True)
    background = tree.nodes.new("ShaderNodeBackground")
    output = tree.nodes.new("ShaderNodeOutputWorld")
    for source, target in (
        (coordinates.outputs["Generated"], mapping.inputs["Vector"]),
        (mapping.outputs["Vector"], texture.inputs["Vector"]),
        (texture.outputs["Color"], background.inputs["Color"]),
        (background.outputs["Background"], output.inputs["Surface"]),
    ):
        tree.links.new(source, target)


def change(tree: Any, principled: Any, of: dict[str, Any]) -> Any:
    """Make the change that a render asks for; returns what undoes it."""
    links, added, before = tree.links, [], principled.distribution
    ends = [(link.from_socket, link.to_socket) for link in links]
    principled.distribution = of["distribution"]
    if of["flat"] and principled.inputs["Normal"].is_linked:
        links.remove(principled.inputs["Normal"].links[0])
    if of["diffuse"]:
        diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
        added.append(diffuse)
        color = principled.inputs["Base Color"].links[0].from_socket
        links.new(color, diffuse.inputs["Color"])
        if principled.inputs["Normal"].is_linked:
            links.new(principled.inputs["Normal"].links[0].from_socket, diffuse.inputs["Normal"])
        [surface] = [
            node.inputs["Surface"] for node in tree.nodes if node.type == "OUTPUT_MATERIAL"
        ]
        links.new(diffuse.outputs[0], surface)
    if of["flip_green"]:
        [normal] = [node for node in tree.nodes if node.type == "NORMAL_MAP"]
        source = normal.inputs["Color"].links[0].from_socket
        parts, whole = (
            tree.nodes.new(f"ShaderNode{kind}Color") for kind in ("Separate", "Combine")
        )
        flipped = tree.nodes.new("ShaderNodeMath")
        flipped.operation = "SUBTRACT"
        flipped.inputs[0].default_value = 1.0
        added += [parts, whole, flipped]
        links.new(source, parts.inputs[0])
        links.new(parts.outputs[1], flipped.inputs[1])
        for output, target in (
            (parts.outputs[0], whole.inputs[0]),
            (flipped.outputs[0], whole.inputs[1]),
            (parts.outputs[2], whole.inputs[2]),
            (whole.outputs[0], normal.inputs["Color"]),
        ):
            links.new(output, target)

    def undo() -> None:
        for node in added:
            tree.nodes.remove(node)
        for source, target in ends:
            links.new(source, target)
        principled.distribution = before

    return undo


def seen(scene: Any, folder: Path, tree: Any, principled: Any) -> dict[str, NDArray[np.float32]]:
    """What the surface is made of, its normal and place, at the centre of every pixel."""
    view_layer = scene.view_layers[0]
    view_layer.use_pass_normal = view_layer.use_pass_position = True
    nodes = []
    for name, kind in (("Base Color", "COLOR"), ("Roughness", "VALUE"), ("Metallic", "VALUE")):
        aov = view_layer.aovs.add()
        aov.name, aov.type = name, kind
        node = tree.nodes.new("ShaderNodeOutputAOV")
        node.aov_name = name
        tree.links.new(
            principled.inputs[name].links[0].from_socket,
            node.inputs["Color" if kind == "COLOR" else "Value"],
        )
        nodes.append(node)
    scene.cycles.samples = 1
    channels = render(scene, folder)
    for node in nodes:
        tree.nodes.remove(node)
    view_layer.use_pass_normal = view_layer.use_pass_position = False
    while view_layer.aovs:
        view_layer.aovs.remove(view_layer.aovs[0])
    values = {
        name.lower().replace(" ", "_"): next(
            v for key, v in channels.items() if key.startswith(f"{name}.")
        )
        for name in ("Roughness", "Metallic")
    }
    return values | {
        "base_color": stacked(channels, "Base Color", "RGB"),
        "normal": stacked(channels, "Normal", "XYZ"),
        "position": stacked(channels, "Position", "XYZ"),
        "alpha": channels["Combined.A"],
    }


def render(scene: Any, folder: Path) -> dict[str, NDArray[np.float32]]:
    """Render; channels by name without the view layer."""
    path = folder / "render.exr"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {
            name.split(".", 1)[1]: np.array(channel.pixels, np.float32)
            for part in file.parts
            for name, channel in part.channels.items()
        }
    path.unlink()
    return channels


def stacked(channels: dict[str, NDArray[np.float32]], name: str, ends: str) -> NDArray[np.float32]:
    """(H, W, len(ends)) of one pass."""
    return np.stack([channels[f"{name}.{end}"] for end in ends], axis=-1)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
