"""Install the Blender extension from its .zip and render what it imports. Runs where bpy is.

    python blender_extension_worker.py FOLDER

FOLDER holds `job.json` (`blender_extension.py` writes it); `facts.json` and a .npy a render are
written beside it. Blender's own installer unpacks, checks and enables the extension. Of
pbrfit-evaluation only the worker is imported, as a file.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

FOLDER = Path(sys.argv[1])
os.environ["BLENDER_USER_RESOURCES"] = str(FOLDER / "user")  # nothing of the user's is touched

import bpy  # noqa: E402
import numpy as np  # noqa: E402

sys.path.append(str(Path(__file__).parents[2] / "evaluation" / "pbrfit_evaluation" / "cycles"))

from worker import layer, render  # type: ignore[import-not-found]  # noqa: E402


def main() -> None:
    """Install, import, render."""
    job = json.loads((FOLDER / "job.json").read_text(encoding="utf-8"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    installed = bpy.ops.extensions.package_install_files(
        filepath=job["zip"], repo="user_default", enable_on_install=True
    )
    enabled = [name for name in bpy.context.preferences.addons.keys() if name.endswith(".pbrfit")]  # noqa: SIM118
    facts: dict[str, Any] = {"installed": sorted(installed), "enabled": enabled, "scenes": {}}
    for of in job["renders"]:
        for thing in list(bpy.data.objects):
            bpy.data.objects.remove(thing)
        try:
            found = bpy.ops.import_scene.pbrfit(filepath=job["export"], **of["options"])
            if of["then"]:
                found = bpy.ops.world.pbrfit_light(**of["then"])
        except RuntimeError as error:  # what was reported as an error
            facts["scenes"][of["name"]] = {"error": str(error)}
            continue
        scene = bpy.context.scene
        facts["scenes"][of["name"]] = facts_of(scene) | {"found": sorted(found)}
        if of["samples"]:
            write_floats(scene, of["samples"])
            np.save(FOLDER / f"{of['name']}.npy", layer(render(scene, FOLDER), "Combined", "RGBA"))
        if of["png"]:
            scene.cycles.samples = of["samples"]
            if hasattr(scene.render.image_settings, "media_type"):
                scene.render.image_settings.media_type = "IMAGE"
            scene.render.image_settings.file_format = "PNG"
            scene.render.image_settings.color_depth = "8"
            scene.render.filepath = str(FOLDER / f"{of['name']}.png")
            bpy.ops.render.render(write_still=True)
    [module] = enabled
    bpy.ops.preferences.addon_disable(module=module)
    facts["gone"] = not hasattr(bpy.types, "IMPORT_SCENE_OT_pbrfit")
    (FOLDER / "facts.json").write_text(json.dumps(facts), encoding="utf-8")


def write_floats(scene: Any, samples: int) -> None:
    """What only a measurement wants: two threads, a fixed seed, EXR."""
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    scene.cycles.device, scene.cycles.seed, scene.cycles.samples = "CPU", 1, samples
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    if hasattr(scene.render.image_settings, "media_type"):  # Blender 5
        scene.render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.image_settings.color_depth = "32"


def facts_of(scene: Any) -> dict[str, Any]:
    """The camera, the render and the colours as they are set."""
    camera = scene.camera.data
    [surface] = [one for one in scene.objects if one.type == "MESH"]
    [material] = surface.data.materials
    images = {
        node.image.name: [node.image.colorspace_settings.name, node.interpolation]
        for node in material.node_tree.nodes
        if node.type == "TEX_IMAGE"
    }
    return {
        "camera": [camera.type, camera.angle_x, camera.ortho_scale, *scene.camera.location],
        "size": [scene.render.resolution_x, scene.render.resolution_y],
        "view": [scene.view_settings.view_transform, scene.view_settings.look],
        "bounces": scene.cycles.max_bounces,
        "shadow": surface.visible_shadow,
        "faces": len(surface.data.polygons),
        "images": images,
        "suns": len([one for one in scene.objects if one.type == "LIGHT"]),
    }


if __name__ == "__main__":
    main()
