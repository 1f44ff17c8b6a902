"""The pictures that a result was made from: found again, and known to be the same."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from pbrfit._core import InputError
from pbrfit.result.result import Result
from pbrfit.scene.options import Source
from pbrfit.scene.scene import Scene
from pbrfit.values.quoting import listed, visible

log = logging.getLogger("pbrfit")

AND_SO = "So this page shows what the result says the pictures look like, but not the pictures."


def find(result: Result, given: Scene | str | Path | None = None) -> tuple[Scene | None, str]:
    """Find the scene that a result was made from; or in words why there is none.

    `given` is the scene or its folder; None = where the result says that it was. Raises InputError
    or OSError if what was given is not that scene, or cannot be read. A scene that the result
    itself names and that is gone or has changed is a remark, and a warning.
    """
    if isinstance(given, Scene):
        given = result.as_fitted(given)
        _check(result, given, "scene")
        return given, ""
    if given is not None:
        return _read(result, Path(given)), ""
    if result.source is None:
        return None, f"The result does not say where its pictures are. {AND_SO}"
    path = result.source.path
    try:
        return _read(result, path), ""
    except (InputError, OSError) as error:
        why = visible(" ".join(str(error).split()))
        log.warning("%s; the page has no pictures of the scene", why)
        found = "is gone, has changed since, or cannot be read"
        return None, f"The scene folder {path.name} {found}. {AND_SO}"


def _read(result: Result, path: Path) -> Scene:
    source = result.source or Source(path)
    named = [path / name for name in source.files]
    # A field of view is that of whole pictures; a result's is that of what was cropped.
    fov = source.options.fov if source.options.crop else result.fov
    scene = Scene.load(named or path, source.options, fov=fov).through(result.fov)
    scene = result.as_fitted(scene)
    _check(result, scene, str(path))
    return scene


def _check(result: Result, scene: Scene, name: str) -> None:
    found = _what_differs(result, scene)
    if found:
        raise InputError(f"{name}: expected the scene that the result was made from, found {found}")


def _what_differs(result: Result, scene: Scene) -> str:
    """The first difference in words; nothing where the result may be of this scene."""
    if result.inputs and scene.inputs:
        # The truth takes no part in a fit.
        then, now = (
            {file: digest for file, digest in one.inputs.items() if not file.startswith("truth/")}
            for one in (result, scene)
        )
        if other := {file for file, _ in then.items() ^ now.items()}:
            return f"files that are new, gone or changed: {listed(other)}"
    if scene.names != result.pictures:
        return f"pictures {', '.join(scene.names)}"
    if scene.valid.shape != result.mask.shape:
        height, width = result.mask.shape
        return f"{scene.width} × {scene.height} pixels instead of {width} × {height}"
    if not np.array_equal(scene.valid, result.mask):
        return "that other pixels are valid"
    return ""
