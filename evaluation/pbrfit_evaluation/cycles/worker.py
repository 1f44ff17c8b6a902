"""Render one job with Cycles. Runs in the environment that has bpy, in a process of its own.

    python worker.py FOLDER

FOLDER holds `job.json` and `arrays.npz`, as `job.py` writes them; the results are written
beside them: `radiance.npy`, `truth.npz` and `outcome.json`. Nothing of pbrfit is imported here,
and bpy nowhere else.

Everything is in camera space: the Blender camera is not turned, so its axes are the world's.
"""

from __future__ import annotations

import ctypes
import json
import signal
import sys
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import OpenEXR
from numpy.typing import NDArray

Floats = NDArray[np.float32]


def main(folder: Path) -> None:
    """Read the job, build it, render the truth and then the light, write both."""
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    arrays = np.load(folder / "arrays.npz")
    started = time.process_time()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    set_up(scene, job)
    add_camera(scene, job["fov"])
    maps = {name: pixel_map(name, arrays[f"map.{name}"]) for name in job["maps"]}
    for index in range(len(job["meshes"])):
        add_mesh(scene, index, arrays, maps, job)
    truth = render_truth(scene, folder)
    light = render_harmonics if job["light"]["kind"] == "harmonics" else render_points
    radiance = light(scene, folder, job)
    np.savez(folder / "truth.npz", **truth)
    np.save(folder / "radiance.npy", radiance)
    outcome = {"cpu_seconds": time.process_time() - started}
    (folder / "outcome.json").write_text(json.dumps(outcome), encoding="utf-8")


def end_with_parent() -> None:
    """Let no render go on for a program that was killed; Linux alone can promise that."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def set_up(scene: Any, job: dict[str, Any]) -> None:
    """Path tracing without any of the settings that trade truth for looks."""
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x = render.resolution_y = job["size"]
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
    cycles.seed = job["seed"]
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.light_sampling_threshold = 0.0
    cycles.blur_glossy = 0.0
    cycles.caustics_reflective = True
    cycles.use_auto_tile = False
    cycles.max_bounces = job["bounces"]["all"]
    cycles.diffuse_bounces = job["bounces"]["diffuse"]
    cycles.glossy_bounces = job["bounces"]["glossy"]
    cycles.transparent_max_bounces = cycles.min_transparent_bounces = 64  # no roulette there
    # Rays through a hundredth of a pixel about its centre: no pixel mixes two surfaces.
    cycles.pixel_filter_type, cycles.filter_width = "GAUSSIAN", 0.01
    world = bpy.data.worlds.new("world")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    world.cycles.sampling_method = "NONE"
    scene.world = world


def add_camera(scene: Any, fov: float) -> None:
    """At the origin, towards -Z, Y up; `fov` in degrees, horizontal."""
    camera = bpy.data.cameras.new("camera")
    camera.sensor_fit = "HORIZONTAL"
    camera.angle = np.radians(fov)
    camera.clip_start, camera.clip_end = 1e-3, 1e6
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.collection.objects.link(scene.camera)


def pixel_map(name: str, values: Floats) -> Any:
    """Float picture of the view; values (H, W, 3), top row first."""
    height, width = values.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=False, float_buffer=True, is_data=True)
    image.use_half_precision = False
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = values[::-1]
    image.pixels.foreach_set(pixels.reshape(-1))
    image.pack()
    return image


def add_mesh(
    scene: Any, index: int, arrays: Any, maps: dict[str, Any], job: dict[str, Any]
) -> None:
    """Triangles with normals and, where the material varies, its values at the vertices."""
    mesh = job["meshes"][index]
    data = triangles(f"piece {index}", arrays[f"{index}.vertices"], arrays[f"{index}.triangles"])
    at_vertices = {"custom_normal": arrays[f"{index}.normals"]}
    if mesh["varies"]:
        values = arrays[f"{index}.material"]  # (V, 5): albedo, roughness, metallic
        at_vertices["albedo"] = values[:, :3]
        at_vertices["finish"] = np.concatenate([values[:, 3:], 0 * values[:, :1]], axis=1)
    for name, of in at_vertices.items():
        attribute = data.attributes.new(name, "FLOAT_VECTOR", "POINT")
        attribute.data.foreach_set("vector", np.ascontiguousarray(of).reshape(-1))
    data.materials.append(material(index, mesh, maps, job))
    data.update()
    piece = bpy.data.objects.new(f"piece {index}", data)
    piece.pass_index = index + 1
    only_camera(piece, not mesh["blocks_light"] or job["transport"] == "brdf")
    piece.cycles.shadow_terminator_geometry_offset = 0.0
    piece.cycles.shadow_terminator_offset = 0.0
    scene.collection.objects.link(piece)


def triangles(name: str, vertices: Floats, corners: NDArray[np.int32]) -> Any:
    """A smooth Blender mesh."""
    data = bpy.data.meshes.new(name)
    data.vertices.add(len(vertices))
    data.vertices.foreach_set("co", vertices.reshape(-1))
    data.loops.add(corners.size)
    data.loops.foreach_set("vertex_index", corners.reshape(-1))
    data.polygons.add(len(corners))
    data.polygons.foreach_set("loop_start", np.arange(0, corners.size, 3, dtype=np.int32))
    data.polygons.foreach_set("use_smooth", np.ones(len(corners), bool))
    data.update(calc_edges=True)
    if data.validate():
        raise ValueError(f"{name}: expected sound triangles, found some that Blender changed")
    return data


def only_camera(piece: Any, alone: bool) -> None:
    """Let nothing but camera rays meet the object, or all rays."""
    piece.visible_diffuse = piece.visible_glossy = piece.visible_shadow = not alone
    piece.visible_transmission = piece.visible_volume_scatter = not alone


class Nodes:
    """Shader nodes of a material or world, made and linked in one step."""

    def __init__(self, of: Any) -> None:
        of.use_nodes = True
        self.tree = of.node_tree

    def add(self, kind: str, inputs: dict[Any, Any] | None = None, **settings: Any) -> Any:
        """Make a node; an input is a constant or another node's output socket."""
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for key, value in settings.items():
            setattr(node, key, value)
        for key, value in (inputs or {}).items():
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, node.inputs[key])
            else:
                node.inputs[key].default_value = value
        return node

    def math(self, operation: str, a: Any, b: Any = 0.0) -> Any:
        """Output of an arithmetic node."""
        return self.add("Math", {0: a, 1: b}, operation=operation).outputs[0]

    def show(self, **values: Any) -> None:
        """Put what feeds the albedo, roughness and metallic into passes of these names."""
        for name, value in values.items():
            key = "Color" if name == "albedo" else "Value"
            self.add("OutputAOV", {key: value}, aov_name=name)


def new_material(name: str) -> tuple[Any, Nodes]:
    """A material without nodes."""
    made = bpy.data.materials.new(name)
    nodes = Nodes(made)
    nodes.tree.nodes.clear()
    return made, nodes


def material(index: int, mesh: dict[str, Any], maps: dict[str, Any], job: dict[str, Any]) -> Any:
    """Principled, and AOVs of what went into it.

    What the camera sees comes from maps with one texel a pixel, looked up where the point is in
    the picture; what other rays see comes from the values at the vertices.
    """
    made, nodes = new_material(f"material {index}")
    inputs: dict[str, Any] = {"IOR": 1.5, "Specular IOR Level": job["specular"]}
    if mesh["varies"]:
        by_camera = nodes.add("LightPath").outputs["Is Camera Ray"]
        window = {"Vector": nodes.add("TexCoord").outputs["Window"]}
        smooth = nodes.add("NewGeometry").outputs["Normal"]

        def seen(name: str) -> Any:
            texture = nodes.add(
                "TexImage", window, image=maps[name], interpolation="Closest", extension="EXTEND"
            )
            at_vertices = nodes.add("Attribute", attribute_name=name).outputs["Vector"]
            mix = nodes.add("Mix", {"Factor": by_camera}, data_type="VECTOR", clamp_factor=False)
            a, b = (s for s in mix.inputs if s.name in "AB" and s.type == "VECTOR")
            nodes.tree.links.new(smooth if name == "normal" else at_vertices, a)
            nodes.tree.links.new(texture.outputs["Color"], b)
            return next(s for s in mix.outputs if s.type == "VECTOR")

        finish = nodes.add("SeparateXYZ", {0: seen("finish")})
        inputs["Base Color"] = seen("albedo")
        inputs["Roughness"], inputs["Metallic"] = finish.outputs[0], finish.outputs[1]
        if "normal" in maps:
            inputs["Normal"] = seen("normal")
    else:
        inputs["Base Color"] = (*mesh["albedo"], 1.0)
        inputs["Roughness"], inputs["Metallic"] = mesh["roughness"], mesh["metallic"]
    shader = nodes.add("BsdfPrincipled", inputs, distribution=job["distribution"])
    nodes.add("OutputMaterial", {"Surface": shader.outputs[0]})
    nodes.show(
        albedo=inputs["Base Color"], roughness=inputs["Roughness"], metallic=inputs["Metallic"]
    )
    return made


def render(scene: Any, folder: Path) -> dict[str, Floats]:
    """Render; the channels of the written file, by name without the view layer."""
    path = folder / "render.exr"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {
            name.split(".", 1)[1]: np.array(channel.pixels, np.float32)
            for part in file.parts  # one a pass
            for name, channel in part.channels.items()
        }
    path.unlink()
    return channels


def layer(channels: dict[str, Floats], name: str, ends: str) -> Floats:
    """(H, W, len(ends)) of one pass."""
    return np.stack([channels[f"{name}.{end}"] for end in ends], axis=-1)


def plane(channels: dict[str, Floats], *names: str) -> Floats:
    """(H, W) of a pass with one channel, by any of its names."""
    return next(of for key, of in channels.items() if key.rsplit(".", 1)[0] in names)


def render_truth(scene: Any, folder: Path) -> dict[str, Any]:
    """Albedo, roughness, metallic, normal, position and object of every pixel's centre."""
    view_layer = scene.view_layers[0]

    def use_passes(on: bool) -> None:
        view_layer.use_pass_normal = view_layer.use_pass_position = on
        view_layer.use_pass_object_index = on

    use_passes(True)
    for name, kind in (("albedo", "COLOR"), ("roughness", "VALUE"), ("metallic", "VALUE")):
        aov = view_layer.aovs.add()
        aov.name, aov.type = name, kind
    scene.cycles.samples = 1
    channels = render(scene, folder)
    use_passes(False)
    while view_layer.aovs:
        view_layer.aovs.remove(view_layer.aovs[0])
    index = plane(channels, "Object Index", "IndexOB")
    return {
        "albedo": layer(channels, "albedo", "RGB"),
        "normals": layer(channels, "Normal", "XYZ"),
        "positions": layer(channels, "Position", "XYZ"),
        "segments": np.rint(index).astype(np.uint16),
        "roughness": plane(channels, "roughness"),
        "metallic": plane(channels, "metallic"),
    }


def render_harmonics(scene: Any, folder: Path, job: dict[str, Any]) -> Floats:
    """(K, H, W, 3): the picture under each basis function, all from one render.

    Each function is the emission of one more box around everything, and a light group. The boxes
    are transparent as well, so that a ray that leaves the scene meets all of them.
    """
    names = [f"basis{k:02d}" for k in range(len(job["light"]["basis"]))]
    for k, (name, terms) in enumerate(zip(names, job["light"]["basis"], strict=True)):
        scene.view_layers[0].lightgroups.add(name=name)
        box = bpy.data.objects.new(name, enclosure(name, 1.01**k * job["light"]["distance"]))
        box.data.materials.append(glow(name, terms))
        box.lightgroup = name
        box.visible_camera = box.visible_shadow = False
        scene.collection.objects.link(box)
    scene.cycles.samples = job["samples"]
    channels = render(scene, folder)
    return np.stack([layer(channels, f"Combined_{name}", "RGB") for name in names])


def enclosure(name: str, half: float) -> Any:
    """A cube about the origin. Its shape is of no matter: it emits by direction."""
    signs = np.array(list(np.ndindex(2, 2, 2)), np.float32) * 2 - 1
    quads = np.array(
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    )
    corners = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    return triangles(name, half * signs, corners)


def glow(name: str, terms: list[list[Any]]) -> Any:
    """Transparent, and emits the polynomial of the ray's direction: [factor, [a, b, c]], ..."""
    made, nodes = new_material(name)
    incoming = nodes.add("NewGeometry").outputs["Incoming"]  # against the ray
    towards = nodes.add("VectorMath", {0: incoming, 3: -1.0}, operation="SCALE")
    axes = nodes.add("SeparateXYZ", {0: towards.outputs[0]}).outputs
    total: Any = None
    for factor, powers in terms:
        term: Any = None
        for axis, power in zip(axes, powers, strict=True):
            for _ in range(power):
                term = axis if term is None else nodes.math("MULTIPLY", term, axis)
        term = factor if term is None else nodes.math("MULTIPLY", term, factor)
        total = term if total is None else nodes.math("ADD", total, term)
    emission = nodes.add("Emission", {"Color": (1, 1, 1, 1), "Strength": total})
    clear = nodes.add("BsdfTransparent", {"Color": (1, 1, 1, 1)})
    both = nodes.add("AddShader", {0: emission.outputs[0], 1: clear.outputs[0]})
    nodes.add("OutputMaterial", {"Surface": both.outputs[0]})
    made.cycles.emission_sampling = "NONE"
    return made


def render_points(scene: Any, folder: Path, job: dict[str, Any]) -> Floats:
    """(K, H, W, 3): the picture under each white point light.

    A light of P watts and no size gives a white diffuse surface that faces it at the distance d
    the radiance P / (4π²d²); with P = 4π² that is 1 at one metre.
    """
    light = bpy.data.lights.new("point", "POINT")
    light.energy = 4 * np.pi**2
    light.shadow_soft_size = 0.0
    light.use_shadow = job["transport"] != "brdf"
    lamp = bpy.data.objects.new("point", light)
    scene.collection.objects.link(lamp)
    scene.cycles.samples = job["samples"]
    # Meshes stay as they are from one light to the next. Not from the render of the truth to these:
    # with other passes, what an earlier render left in them would be added.
    scene.render.use_persistent_data = True
    pictures = []
    for position in job["light"]["positions"]:
        lamp.location = position
        pictures.append(layer(render(scene, folder), "Combined", "RGB"))
    return np.stack(pictures)


if __name__ == "__main__":
    end_with_parent()
    main(Path(sys.argv[1]))
