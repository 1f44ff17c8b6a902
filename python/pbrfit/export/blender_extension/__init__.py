"""Blender extension: *File ▸ Import ▸ pbrfit result* opens what `pbrfit export` wrote.

It imports the folder of `export.json`: the camera of the pictures, the surface that it saw, its
material, and one of the recovered lights, another panorama or a sun, so that Cycles shows what
`pbrfit relight` shows. Button and menu are in Blender; the same from Python:

    bpy.ops.import_scene.pbrfit(filepath=".../export.json", light="picture_3")
    bpy.ops.world.pbrfit_light(sun=True, azimuth=-50, elevation=35)

Nothing of pbrfit is imported here. `view_mesh.py` is the module of that name in `pbrfit.export`; it
is put beside this file when the extension is packed.

pbrfit's camera space has X to the right, Y up and Z to the viewer; in Blender's world that is
(x, −z, y): the surface faces −Y. Lengths are in picture widths.
"""

import csv
import json
import math
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty
from bpy_extras.io_utils import ImportHelper
from mathutils import Vector
from numpy.typing import NDArray

from .view_mesh import camera as view_camera
from .view_mesh import facets

MANIFEST = "export.json"

FOLDER = "pbrfit_folder"
"""Custom property of a scene: the export that was imported into it."""

LAW = "law of the fit"
"""Name of the node that has 0 for Principled and 1 for the paper's law."""

WORLD_TURN = -90.0
"""Degrees about Blender's Z between the panoramas of pbrfit and those of Blender."""

NORMAL_ERROR = 1e-3
"""Difference of a facet's own normal from the map's from which on facets get the map's."""

Array = NDArray[np.floating[Any]]


class Export:
    """What `export.json` says, and the maps beside it."""

    def __init__(self, path: str) -> None:
        at = Path(bpy.path.abspath(path))
        self.folder = at if at.is_dir() else at.parent
        try:
            described = json.loads((self.folder / MANIFEST).read_text(encoding="utf-8"))
            self.fov = float(described["fov"])
            self.files = {file["path"]: file for file in described["files"]}
            self.green_down = described["normal_maps"] == "directx"
            self.model = described.get("model", "paper")
            self.displacement = described.get("displacement")
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise ValueError(
                f"{self.folder}: expected a folder that `pbrfit export --preset blender` wrote, "
                f"found none: {error}"
            ) from None

    def map(self, name: str, color_space: str = "Non-Color") -> Any:
        """A map as an image, or None; names may go on, as `normal_opengl` does."""
        for suffix in ("", "_opengl", "_directx"):
            path = f"png/{name}{suffix}.png"
            if path in self.files:
                image = bpy.data.images.load(str(self.folder / path))
                image.colorspace_settings.name = color_space
                image.alpha_mode = "CHANNEL_PACKED"
                return image
        return None

    def needed(self, name: str, color_space: str = "Non-Color") -> Any:
        """The same of a map that must be there."""
        image = self.map(name, color_space)
        if image is None:
            raise ValueError(
                f"{self.folder}: expected png/{name}.png, as `pbrfit export --preset blender` "
                "writes it, found none"
            )
        return image

    def panoramas(self) -> dict[str, Path]:
        """Files of the recovered lights by picture, in order."""
        lights = self.folder / "lights"
        with (lights / "panoramas.csv").open(encoding="utf-8", newline="") as table:
            return {
                row["picture"].removeprefix("'"): lights / row["file"].removeprefix("'")
                for row in csv.DictReader(table)
            }


def samples(image: Any) -> Array:
    """(H, W, channels) float32 of an image, top row first."""
    width, height = image.size
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(height, width, image.channels)[::-1]


def in_blender(vectors: Array) -> Array:
    """From camera space to Blender's axes."""
    return np.stack([vectors[..., 0], -vectors[..., 2], vectors[..., 1]], axis=-1)


# The view


def add_camera(scene: Any, collection: Any, fov: float, height: int, width: int) -> None:
    """The camera of the pictures, and the size of the render."""
    _, distance = view_camera(height, width, fov)
    data = bpy.data.cameras.new("pbrfit view")
    data.sensor_fit = "HORIZONTAL"
    if fov == 0:
        data.type, data.ortho_scale = "ORTHO", 1.0
    else:
        data.angle = math.radians(fov)
    data.clip_start, data.clip_end = 0.01 * distance, 100 * distance
    found = bpy.data.objects.new("pbrfit view", data)
    found.location = (0, -distance, 0)
    found.rotation_euler = (math.pi / 2, 0, 0)
    collection.objects.link(found)
    scene.camera = found
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1


def set_up_render(scene: Any, *, as_relit: bool) -> None:
    """Colours as they are; and, as relit, no light from surface to surface."""
    scene.render.engine = "CYCLES"
    scene.render.film_transparent = True
    scene.display_settings.display_device = "sRGB"
    view = scene.view_settings
    view.view_transform, view.look = "Standard", "None"
    view.exposure, view.gamma = 0, 1
    cycles = scene.cycles
    cycles.samples, cycles.use_denoising = 128, True
    cycles.pixel_filter_type = "BOX"  # a pixel shows its own facet alone
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.blur_glossy = 0
    cycles.light_sampling_threshold = 0
    cycles.max_bounces = 0 if as_relit else 12
    cycles.diffuse_bounces = cycles.glossy_bounces = 0 if as_relit else 4


# The surface


def quads(name: str, corners: Array, texture: Array, faces: NDArray[np.integer[Any]]) -> Any:
    """A mesh of corners (V, 3) in camera space, places in the texture (V, 2), faces (F, 4)."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(corners))
    mesh.vertices.foreach_set("co", in_blender(corners).astype(np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.astype(np.int32).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 4, dtype=np.int32))
    mesh.polygons.foreach_set("use_smooth", np.zeros(len(faces), bool))
    layer = mesh.uv_layers.new(name="UVMap")
    layer.uv.foreach_set("vector", texture.astype(np.float32)[faces.ravel()].ravel())
    mesh.update(calc_edges=True)
    return mesh


def set_normals(mesh: Any, normals: Array) -> None:
    """Give the vertices normals (V, 3) in camera space."""
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), bool))
    mesh.normals_split_custom_set_from_vertices(in_blender(normals))


def facet_mesh(normals: Array, mask: NDArray[np.bool_], fov: float) -> Any:
    """A rectangle a pixel, turned to its normal."""
    found = facets(normals.astype(np.float64), mask, fov).attributes
    corners = found["POSITION"].reshape(-1, 4, 3).astype(np.float64)
    texture = found["TEXCOORD_0"] * [1, -1] + [0, 1]  # Blender's v grows upwards
    faces = np.arange(4 * len(corners)).reshape(-1, 4)
    mesh = quads("pbrfit facets", corners.reshape(-1, 3), texture, faces)
    # Those that face away, or that are seen at so small an angle that their depth is limited.
    own = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    own /= np.linalg.norm(own, axis=-1, keepdims=True)
    if np.abs(own - found["NORMAL"][::4]).max() > NORMAL_ERROR:
        set_normals(mesh, found["NORMAL"])
    return mesh


def relief_mesh(normals: Array, mask: NDArray[np.bool_], height: Array, fov: float) -> Any:
    """A surface through the pixels' centres at their height, with the normals of the map."""
    rows, columns = mask.shape
    i, j = np.mgrid[:rows, :columns]
    on_card = np.stack([(j + 0.5) / columns - 0.5, (0.5 * rows - i - 0.5) / columns], axis=-1)
    _, distance = view_camera(rows, columns, fov)
    near = 1.0 if fov == 0 else (1 - height / distance)[..., None]
    corners = np.concatenate([on_card * near, height[..., None]], axis=-1)
    texture = np.stack([(j + 0.5) / columns, 1 - (i + 0.5) / rows], axis=-1)
    index = np.arange(mask.size).reshape(mask.shape)
    whole = mask[:-1, :-1] & mask[1:, :-1] & mask[1:, 1:] & mask[:-1, 1:]
    around = index[1:, :-1], index[1:, 1:], index[:-1, 1:], index[:-1, :-1]
    faces = np.stack([of[whole] for of in around], axis=-1)
    mesh = quads("pbrfit relief", corners.reshape(-1, 3), texture.reshape(-1, 2), faces)
    set_normals(mesh, normals.reshape(-1, 3))
    return mesh


def add_surface(
    collection: Any, export: Export, geometry: str, *, as_relit: bool
) -> tuple[int, int]:
    """The surface with its material; (height, width) of the picture."""
    normal_map = export.needed("normal")
    opacity = export.map("mask")
    width, height = normal_map.size
    mask = np.ones((height, width), bool) if opacity is None else samples(opacity)[..., 0] > 0.5
    normals = 2 * samples(normal_map)[..., :3] - 1
    if export.green_down:
        normals[..., 1] *= -1
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    if geometry == "AUTO":
        found = (export.displacement or {}).get("source")
        geometry = "RELIEF" if found == "fit" else "FACETS"
    if geometry == "FACETS":
        mesh = facet_mesh(normals, mask, export.fov)
    elif export.displacement is None:
        raise ValueError(f"{export.folder}: expected a height map for a relief, found none")
    else:
        low, high = export.displacement["low"], export.displacement["high"]
        shares = samples(export.needed("displacement"))[..., 0]
        mesh = relief_mesh(normals, mask, low + (high - low) * shares, export.fov)

    nodes = Nodes("pbrfit", "Closest" if geometry == "FACETS" else "Linear")
    maps = {
        "Base Color": nodes.texture(export.needed("base_color", "sRGB")),
        "Metallic": nodes.texture(export.needed("metallic")),
        "Roughness": nodes.texture(export.needed("roughness")),
    }
    surface = nodes.add("BsdfPrincipled", **maps).outputs[0]
    if export.model == "paper":
        both = nodes.add("MixShader", 0, surface, paper_law(nodes, *maps.values()))
        both.name = both.label = LAW
        surface = both.outputs[0]
    nodes.add("OutputMaterial", surface)
    mesh.materials.append(nodes.material)
    found = bpy.data.objects.new(mesh.name, mesh)
    if as_relit:
        found.visible_diffuse = found.visible_glossy = found.visible_shadow = False
    collection.objects.link(found)
    return height, width


class Nodes:
    """A material's nodes, made and linked in one step, each to the right of the last."""

    def __init__(self, name: str, interpolation: str) -> None:
        self.material = bpy.data.materials.new(name)
        self.material.use_nodes = True
        self.tree = self.material.node_tree
        self.tree.nodes.clear()
        self.interpolation = interpolation

    def add(self, kind: str, *inputs: Any, **by_name: Any) -> Any:
        """A node; an input is another's output, a constant, or None for what it has."""
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        node.location = (170 * len(self.tree.nodes), -40 * (len(self.tree.nodes) % 9))
        for key, value in [*enumerate(inputs), *by_name.items()]:
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, node.inputs[key])
            elif value is not None:
                node.inputs[key].default_value = value
        return node

    def texture(self, image: Any) -> Any:
        """Colour of an image."""
        node = self.add("TexImage")
        node.image, node.interpolation, node.extension = image, self.interpolation, "EXTEND"
        return node.outputs["Color"]

    def math(self, operation: str, a: Any, b: Any = None) -> Any:
        """Result of arithmetic on numbers."""
        node = self.add("Math", a, b)
        node.operation = operation
        return node.outputs[0]

    def vectors(self, operation: str, a: Any, b: Any = None, *, scale: Any = None) -> Any:
        """Result of arithmetic on vectors or colours."""
        node = self.add("VectorMath", a, b, None, scale)
        node.operation = operation
        return node.outputs["Value" if operation == "DOT_PRODUCT" else "Vector"]


def paper_law(nodes: Nodes, base_color: Any, metallic: Any, roughness: Any) -> Any:
    """A surface near the paper's reflection law, pbrfit's model "paper"; Principled has another.

    With F by Schlick at n·v, F0 = 0.04 (1 − m) + m ρ, and k = r⁴/2:

        diffuse   (1 − F)(1 − m) ρ
        glossy    F · n·v / (n·v (1 − k) + k) / (1 + r⁴)        under even light

    which are the law's own. Its lobe is round about the mirror direction, where that of GGX becomes
    longer towards the horizon; the GGX lobe of roughness r (n·v)^(1/3) is about the nearest.
    """
    geometry = nodes.add("NewGeometry").outputs
    facing = nodes.vectors("DOT_PRODUCT", geometry["Incoming"], geometry["Normal"])
    facing = nodes.math("MINIMUM", nodes.math("MAXIMUM", facing, 1e-4), 1)
    r4 = nodes.math("POWER", roughness, 4)
    k = nodes.math("MULTIPLY", r4, 0.5)
    below = nodes.math("ADD", nodes.math("MULTIPLY", facing, nodes.math("SUBTRACT", 1, k)), k)
    below = nodes.math("MULTIPLY", below, nodes.math("ADD", r4, 1))
    strength = nodes.math("DIVIDE", facing, below)

    matt = nodes.math("SUBTRACT", 1, metallic)
    matt_color = nodes.vectors("SCALE", base_color, scale=matt)
    f0 = nodes.vectors("SCALE", base_color, scale=metallic)
    f0 = nodes.vectors("ADD", f0, nodes.vectors("SCALE", (0.04, 0.04, 0.04), scale=matt))
    schlick = nodes.math("POWER", nodes.math("SUBTRACT", 1, facing), 5)
    rest = nodes.vectors("SUBTRACT", (1, 1, 1), f0)
    rest = nodes.vectors("SCALE", rest, scale=nodes.math("SUBTRACT", 1, schlick))  # 1 − F
    color = nodes.vectors("MULTIPLY", matt_color, rest)
    surface = nodes.add("BsdfDiffuse", color).outputs[0]

    fresnel = nodes.vectors("SUBTRACT", (1, 1, 1), rest)
    shares = nodes.add("SeparateXYZ", nodes.vectors("SCALE", fresnel, scale=strength)).outputs
    narrowed = nodes.math("MULTIPLY", roughness, nodes.math("POWER", facing, 1 / 3))
    for channel, share in enumerate(shares):
        # A lobe a channel: the colour of one would enter the light from facet to facet.
        pure = [float(channel == c) for c in range(3)]
        lobe = nodes.add("BsdfAnisotropic", (*pure, 1), narrowed)
        lobe.distribution = "MULTI_GGX"
        part = nodes.add("MixShader", share, None, lobe.outputs[0]).outputs[0]
        surface = nodes.add("AddShader", surface, part).outputs[0]
    return surface


# The light


def set_panorama(scene: Any, path: Path, rotation: float) -> None:
    """Light by a panorama, turned as `pbrfit relight --rotate` turns it."""
    world = bpy.data.worlds.new(f"pbrfit {path.stem}")
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    [background] = [node for node in nodes if node.type == "BACKGROUND"]
    directions, mapping, picture = (
        nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "Mapping", "TexEnvironment")
    )
    for column, node in enumerate((directions, mapping, picture)):
        node.location = (-900 + 250 * column, 300)
    mapping.inputs["Rotation"].default_value = (0, 0, math.radians(WORLD_TURN - rotation))
    picture.image = bpy.data.images.load(str(path), check_existing=True)
    if picture.image.is_float:
        picture.image.colorspace_settings.name = "Linear Rec.709"
    links.new(directions.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], picture.inputs["Vector"])
    links.new(picture.outputs["Color"], background.inputs["Color"])
    scene.world = world


def set_sun(scene: Any, azimuth: float, elevation: float) -> None:
    """Light from one direction, as `pbrfit relight --light` of strength 1, and no other."""
    scene.world = bpy.data.worlds.new("pbrfit dark")
    scene.world.use_nodes = True
    [background] = [n for n in scene.world.node_tree.nodes if n.type == "BACKGROUND"]
    background.inputs["Strength"].default_value = 0
    a, e = math.radians(azimuth), math.radians(elevation)
    direction = np.array([math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)])
    data = bpy.data.lights.new("pbrfit sun", "SUN")
    data.energy, data.angle = math.pi, 0  # a white diffuse surface that faces it has radiance 1
    found = bpy.data.objects.new("pbrfit sun", data)
    found.rotation_euler = Vector(in_blender(direction)).to_track_quat("Z", "Y").to_euler()
    scene.collection.objects.link(found)


def set_law(scene: Any, own: bool) -> None:
    """Switch materials that have both between Principled and the law of the fit."""
    for thing in scene.objects:
        for slot in thing.material_slots:
            node = slot.material.node_tree.nodes.get(LAW) if slot.material else None
            if node is not None:
                node.inputs[0].default_value = float(own)


def lights_known(self: Any, context: Any, _typed: str) -> list[str]:
    """Pictures whose lights can be chosen."""
    try:
        return list(Export(getattr(self, "filepath", "") or context.scene[FOLDER]).panoramas())
    except (KeyError, OSError, ValueError):
        return []


class LightOptions:
    """Which light: a picture's, a panorama of one's own, or a sun."""

    light: StringProperty(
        name="Light of picture",
        description="Recovered light of this picture; empty: the first",
        search=lights_known,
    )
    panorama: StringProperty(
        name="Panorama",
        description="Instead: an equirectangular picture (HDR or EXR), as of relight --env",
    )
    rotation: FloatProperty(
        name="Rotation", description="Turns light from the viewer towards the right, in degrees"
    )
    sun: BoolProperty(name="Sun", description="Instead: hard light from one direction")
    azimuth: FloatProperty(
        name="Azimuth", description="Degrees: 0 from behind the viewer, 90 from the right"
    )
    elevation: FloatProperty(name="Elevation", description="Degrees above the view", default=35)

    own_law: BoolProperty(
        name="Law of the fit",
        description="Results of the paper's model, under recovered light: nodes near its "
        "reflection law instead of Principled",
        default=True,
    )

    def set_light(self, scene: Any, export: Export) -> None:
        """Put the chosen light into the scene; suns of earlier choices go."""
        # The paper's closed form is for SH light alone.
        set_law(scene, self.own_law and not self.sun and not self.panorama)
        for thing in [one for one in scene.objects if one.name.startswith("pbrfit sun")]:
            bpy.data.objects.remove(thing)
        if self.sun:
            set_sun(scene, self.azimuth + self.rotation, self.elevation)
            return
        if self.panorama:
            path = Path(bpy.path.abspath(self.panorama))
        else:
            known = export.panoramas()
            name = self.light or next(iter(known))
            if name not in known:
                raise ValueError(
                    f"light: expected one of the pictures {', '.join(known)}, found {name}"
                )
            path = known[name]
        if not path.is_file():
            raise ValueError(f"{path}: expected a panorama, found none")
        set_panorama(scene, path, self.rotation)


class ImportResult(bpy.types.Operator, ImportHelper, LightOptions):
    """File ▸ Import ▸ pbrfit result."""

    bl_description = "Import materials, camera and light that pbrfit recovered"
    bl_idname = "import_scene.pbrfit"
    bl_label = "Import pbrfit result"
    bl_options = {"REGISTER", "UNDO", "PRESET"}  # noqa: RUF012
    filename_ext = ".json"
    filter_glob: StringProperty(default=MANIFEST, options={"HIDDEN"})
    geometry: EnumProperty(
        name="Geometry",
        items=(
            ("AUTO", "Automatic", "A relief where the fit found its height, else facets"),
            (
                "FACETS",
                "Facets",
                "A rectangle a pixel, turned to its normal: as relit, from the camera's view alone",
            ),
            ("RELIEF", "Relief", "The surface at the height that the normals integrate to"),
        ),
    )
    as_relit: BoolProperty(
        name="As relit",
        description="No shadows and no light from surface to surface, as pbrfit relight has it",
        default=True,
    )

    def execute(self, context: Any) -> set[str]:
        """Build the view."""
        scene = context.scene
        try:
            export = Export(self.filepath)
            collection = bpy.data.collections.new(f"pbrfit {export.folder.name}")
            size = add_surface(collection, export, self.geometry, as_relit=self.as_relit)
            add_camera(scene, collection, export.fov, *size)
            set_up_render(scene, as_relit=self.as_relit)
            scene.collection.children.link(collection)
            self.set_light(scene, export)
        except (OSError, RuntimeError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        scene[FOLDER] = str(export.folder)
        if export.model != "principled":
            self.report(
                {"WARNING"},
                f"fitted with the model {export.model}, which Blender's materials are only near: "
                "`pbrfit decompose --model principled` has Blender's own law",
            )
        return {"FINISHED"}


class SetLight(bpy.types.Operator, LightOptions):
    """The light of an imported result."""

    bl_description = "Light the result by another of its lights, a panorama or a sun"
    bl_idname = "world.pbrfit_light"
    bl_label = "pbrfit light"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Whether there is a result in the scene."""
        return FOLDER in context.scene

    def invoke(self, context: Any, _event: Any) -> set[str]:
        """Ask which."""
        found: set[str] = context.window_manager.invoke_props_dialog(self)
        return found

    def execute(self, context: Any) -> set[str]:
        """Change it."""
        try:
            self.set_light(context.scene, Export(context.scene[FOLDER]))
        except (OSError, RuntimeError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class LightPanel(bpy.types.Panel):
    """The button of the light, among the properties of the world."""

    bl_idname = "WORLD_PT_pbrfit"
    bl_label = "pbrfit"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "world"

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Whether there is a result in the scene."""
        return FOLDER in context.scene

    def draw(self, _context: Any) -> None:
        """One button."""
        self.layout.operator(SetLight.bl_idname, text="Light…")


def menu(self: Any, _context: Any) -> None:
    """The entry of File ▸ Import."""
    self.layout.operator(ImportResult.bl_idname, text="pbrfit result (export.json)")


CLASSES = (ImportResult, SetLight, LightPanel)


def register() -> None:
    """Make the operators known."""
    for of in CLASSES:
        bpy.utils.register_class(of)
    bpy.types.TOPBAR_MT_file_import.append(menu)


def unregister() -> None:
    """Take them back."""
    bpy.types.TOPBAR_MT_file_import.remove(menu)
    for of in reversed(CLASSES):
        bpy.utils.unregister_class(of)
