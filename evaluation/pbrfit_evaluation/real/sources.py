"""Pictures of other people, from photographs and other renderers, as scene folders.

A *source* is a scene folder that somebody made, or one of the public sets below as it was
published. The latter hold pictures and normals in forms of their own; `write_scene` makes a scene
folder of one (docs/formats.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from pbrfit._core import InputError
from pbrfit.io.normal_files import find_normals
from pbrfit.io.output import scratch_folder
from pbrfit.scene import folder as scene_folder
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.real.public_sets import SETS, PublicSet, Source, room_source

__all__ = [
    "SETS",
    "PublicSet",
    "Source",
    "absent",
    "check_names",
    "find_data",
    "find_sources",
    "load",
    "write_scene",
]


def find_data(folders: Sequence[Path], environment: Mapping[str, str]) -> list[Path]:
    """Folders as given, else that of PBRFIT_DATA.

    Raises
    ------
    InputError
        If there is neither.
    """
    if folders:
        return list(folders)
    if environment.get("PBRFIT_DATA"):
        return [Path(environment["PBRFIT_DATA"])]
    raise InputError(
        "FOLDER: expected scene folders or a folder of public sets, found none, and PBRFIT_DATA is "
        "not set"
    )


def find_sources(path: Path) -> list[Source]:
    """Sources that a path names: a scene folder, a public set, or a folder that holds such.

    Raises
    ------
    FileNotFoundError, InputError
        If there is no such folder, or nothing in it that could be pictures of one view.
    """
    if not path.is_dir():
        there = "a file" if path.exists() else "nothing of that name"
        raise FileNotFoundError(f"{path}: expected a folder of pictures, found {there}")
    found = _sources_at(path)
    if not found:
        for below in sorted(path.iterdir()):
            if below.is_dir() and not below.name.startswith("."):
                found += _sources_at(below)
    if not found:
        raise InputError(
            f"{path}: expected a scene folder or one of {', '.join(SETS)}, found none of them"
        )
    return found


def check_names(sources: Sequence[Source]) -> None:
    """Records are kept by name.

    Raises
    ------
    InputError
        If two sources have one name.
    """
    names = [source.name for source in sources]
    for source in sources:
        if names.count(source.name) > 1:
            raise InputError(
                f"{source.folder}: expected different names, found {source.name} twice"
            )


def absent(path: Path, found: Sequence[Source]) -> list[PublicSet]:
    """Public sets that a folder of public sets lacks; none for a folder of another kind."""
    kinds = {source.kind for source in found if path in source.folder.parents}
    return [one for kind, one in SETS.items() if kind not in kinds] if kinds & set(SETS) else []


def write_scene(source: Source, folder: Path) -> None:
    """Write a public set as a scene folder, into a folder that exists and is empty."""
    SETS[source.kind].write(source, folder)


CODE_RANGE = (0, 254)
"""Only what is surely clipped counts as clipped: what matters is how well the rest is explained."""


def load(source: Source, max_size: int | None = None) -> Scene:
    """Read a source. Samples that an integer file holds at its maximum are at a limit.

    Such a sample says that there was at least so much light, not how much. Where several pixels
    are averaged down to one, one of them is enough.
    """
    read = partial(Scene.load, max_size=max_size, code_range=CODE_RANGE)
    if source.kind == "scene":
        scene = read(source.folder)
    else:
        with scratch_folder() as folder:
            write_scene(source, folder)
            scene = read(folder)
    return replace(scene, lighting=None, truth=None, source=None, model=None)


def _sources_at(path: Path) -> list[Source]:
    name = path.resolve().name
    if name in SETS:
        return SETS[name].find(path)
    if not scene_folder.is_scene(path):
        return []
    if not (path / "images").is_dir() and not find_normals(path):
        return [room_source(path)]
    pictures = len(scene_folder.find_pictures(path))
    return [Source(name, path, "scene", pictures, "scene folder, as it is")]
