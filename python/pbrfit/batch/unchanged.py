"""Whether a result is whole, and what the same scene would give again with the same options."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pbrfit._core import InputError
from pbrfit.io.input_files import digest
from pbrfit.io.json_files import UNFIT, as_json, read_json, table
from pbrfit.model.reflection import chosen_model
from pbrfit.result.options import FitOptions
from pbrfit.result.result import details_of, files_of, model_of
from pbrfit.result.verdict import verdicts_of
from pbrfit.scene import folder as scene_folder
from pbrfit.scene.folder import ScenePath
from pbrfit.scene.options import ReadOptions


def kept(
    output: Path, scene: ScenePath, reading: ReadOptions, options: FitOptions
) -> Mapping[str, Any] | None:
    """Give what `result.json` holds if a result may stay as it is, else None.

    It may where all its files are as they were written, by this version, of these options, and of
    the files that the scene folder has now: their names and contents, not their dates. Whatever
    cannot be read is none. Raises InputError if the result is of another model than the scene would
    be fitted with now: materials of one model are worth nothing in another, so it is no earlier
    attempt at this one.
    """
    file = output / "result.json"
    try:
        content = table(read_json(file, "a result"))
        found, of_pictures = model_of(content, file), scene_folder.locate(scene).settings().model
    except (OSError, ValueError):
        return None
    wanted = chosen_model(options.model, of_pictures)
    if found != wanted:
        raise InputError(
            f"{output}: expected a result of model {wanted} to resume, found one of model {found}; "
            f"--model {found} keeps it, --overwrite replaces it"
        )
    try:
        details_of(content, output)  # raises what is caught below
        scene_then = dict(content["scene"])
        if (content["camera"] or {}).get("response"):  # the choice of the fit, as nobody asked
            scene_then["color_space"] = None
        same = (
            content["version"] == version("pbrfit")
            and content["options"] == as_json(options)
            and ReadOptions.from_json(scene_then) == reading
            and bool(verdicts_of(content["uncertainty"])) == options.uncertainty
            and content["files"] == {name: digest(output / name) for name in files_of(output)}
            and content["inputs"] == scene_folder.digests(scene)
        )
    except (OSError, InputError, *UNFIT):
        return None
    return content if same else None
