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
        with (self.folder / "lights" / "panoramas.csv").open(encoding="utf-8", newline="") as table:
            return {
                row["picture"]: self.folder / "lights" / row["file"] for row in csv.DictReader(table)
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
    cycles.pixel_filter_type = "BOX"  # a pixel shows its own facet alone
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.blur_glossy = 0
    cycles.light_sampling_threshold = 0
    if as_relit:
        cycles.use_denoising = False
        cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = 0


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
    mesh.normals_split_custom_set_from_vertices(in_blender(normals).tolist())


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


def card_mesh(height: int, width: int) -> Any:
    """A rectangle that fills the view."""
    texture = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    corners = np.zeros((4, 3))
    corners[:, :2] = (texture - 0.5) * [1, height / width]
    return quads("pbrfit card", corners, texture, np.arange(4)[None])


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


def add_surface(collection: Any, export: Export, geometry: str, *, as_relit: bool) -> Any:
    """The surface with its material; (height, width) of the picture."""
    normal_map = export.needed("normal")
    base_color = export.needed("base_color", "sRGB")
    opacity = export.map("mask")
    width, height = normal_map.size
    mask = np.ones((height, width), bool) if opacity is None else samples(opacity)[..., 0] > 0.5
    normals = 2 * samples(normal_map)[..., :3] - 1
    if export.green_down:
        normals[..., 1] *= -1
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    if geometry == "FACETS":
        mesh = facet_mesh(normals, mask, export.fov)
    elif geometry == "RELIEF":
        if export.displacement is None:
            raise ValueError(f"{export.folder}: expected a height map for a relief, found none")
        low, high = export.displacement["low"], export.displacement["high"]
        shares = samples(export.needed("displacement"))[..., 0]
        mesh = relief_mesh(normals, mask, low + (high - low) * shares, export.fov)
    else:
        mesh = card_mesh(height, width)
    on_card = geometry == "CARD"
    interpolation = "Closest" if geometry == "FACETS" else "Linear"
    material = bpy.data.materials.new("pbrfit")
    material.use_nodes = True
    tree = material.node_tree
    [shader] = [node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"]

    def texture(image: Any, row: int) -> Any:
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image, node.interpolation, node.extension = image, interpolation, "EXTEND"
        node.location = (-700, 400 - 300 * row)
        return node.outputs["Color"]

    color = texture(base_color, 0)
    tree.links.new(color, shader.inputs["Base Color"])
    for row, name in enumerate(("metallic", "roughness"), start=1):
        tree.links.new(texture(export.needed(name), row), shader.inputs[name.capitalize()])
    if on_card:
        node = tree.nodes.new("ShaderNodeNormalMap")
        node.location = (-300, -500)
        bump = texture(normal_map, 3)
        if export.green_down:
            bump = flipped_green(tree, bump)
        tree.links.new(bump, node.inputs["Color"])
        tree.links.new(node.outputs["Normal"], shader.inputs["Normal"])
        if opacity is not None:
            cut = texture(opacity, 4)
            cut.node.interpolation = "Closest"
            tree.links.new(cut, shader.inputs["Alpha"])
    mesh.materials.append(material)
    found = bpy.data.objects.new(mesh.name, mesh)
    if as_relit:
        found.visible_diffuse = found.visible_glossy = found.visible_shadow = False
    collection.objects.link(found)
    return height, width


def flipped_green(tree: Any, color: Any) -> Any:
    """A normal map whose green points down, with green up."""
    apart = tree.nodes.new("ShaderNodeSeparateColor")
    again = tree.nodes.new("ShaderNodeCombineColor")
    turn = tree.nodes.new("ShaderNodeMath")
    turn.operation = "SUBTRACT"
    turn.inputs[0].default_value = 1
    for source, target in (
        (color, apart.inputs[0]),
        (apart.outputs[1], turn.inputs[1]),
        (apart.outputs[0], again.inputs[0]),
        (turn.outputs[0], again.inputs[1]),
        (apart.outputs[2], again.inputs[2]),
    ):
        tree.links.new(source, target)
    return again.outputs[0]


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
        name="Rotation",
        description="Turns light from the viewer towards the right, in degrees",
    )
    sun: BoolProperty(name="Sun", description="Instead: hard light from one direction")
    azimuth: FloatProperty(
        name="Azimuth", description="Degrees: 0 from behind the viewer, 90 from the right"
    )
    elevation: FloatProperty(name="Elevation", description="Degrees above the view", default=35)

    def set_light(self, scene: Any, export: Export) -> None:
        """Put the chosen light into the scene; suns of earlier choices go."""
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
    """Import materials, camera and light that pbrfit recovered"""

    bl_idname = "import_scene.pbrfit"
    bl_label = "Import pbrfit result"
    bl_options = {"REGISTER", "UNDO", "PRESET"}
    filename_ext = ".json"
    filter_glob: StringProperty(default=MANIFEST, options={"HIDDEN"})
    geometry: EnumProperty(
        name="Geometry",
        items=(
            ("FACETS", "Facets", "A rectangle a pixel, turned to its normal: as relit, from the "
             "camera's view alone"),
            ("CARD", "Card", "One rectangle with a normal map; steep normals get too little light"),
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
            self.set_light(scene, export)
        except (OSError, RuntimeError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        scene.collection.children.link(collection)
        scene[FOLDER] = str(export.folder)
        if export.model != "principled":
            self.report(
                {"WARNING"},
                f"fitted with the model {export.model}: Blender's materials reflect by another "
                "law. `pbrfit decompose --model principled` has Blender's",
            )
        return {"FINISHED"}


class SetLight(bpy.types.Operator, LightOptions):
    """Light an imported pbrfit result by another of its lights, a panorama or a sun"""

    bl_idname = "world.pbrfit_light"
    bl_label = "pbrfit light"
    bl_options = {"REGISTER", "UNDO"}

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
