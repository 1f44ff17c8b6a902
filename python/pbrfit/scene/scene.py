"""Scene: the arrays of a scene, with the folder that they are read from and written to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from pbrfit.scene import reading, writing
from pbrfit.scene.arrays import SceneArrays
from pbrfit.scene.folder import ScenePath
from pbrfit.scene.options import AS_STATED, ReadOptions


class Scene(SceneArrays):
    """Pictures of one view under different lights; `SceneArrays` has what it holds and checks."""

    @classmethod
    def load(cls, path: ScenePath, options: ReadOptions = AS_STATED, **given: Any) -> Scene:
        """Read a scene folder, or pictures that are named one by one (see docs/formats.md).

        Parameters
        ----------
        path
            The folder, or the files of the pictures: where these lie in one folder, what else it
            has counts too.
        options
            How files are read; `ReadOptions` has each.
        **given
            Single options by name, in place of those in `options`: `max_size=512`.

        Raises
        ------
        InputError, OSError
            One line that names the file, what was expected and what was found.
        TypeError
            If there is no option of a name.
        """
        for name in given.keys() - vars(AS_STATED):
            expected = f"expected options {', '.join(vars(AS_STATED))}"
            raise TypeError(f"Scene.load: {expected}, found {name!r}")
        return reading.load(path, cls, replace(options, **given))

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write a scene folder that `load` reads back: float32 EXR, ground truth included.

        The mask leaves out pixels that no picture tells anything of. Samples of weight 0 that are
        NaN or infinite are stored as 0. Limits are stored beside each picture, what its file did to
        its samples (`noise_floor`) is not. Ids below 0 or above 65535 are numbered anew.

        Raises
        ------
        FileExistsError
            If the folder exists and `overwrite` is False.
        """
        writing.save(self, Path(path), overwrite=overwrite)

    def _repr_html_(self) -> str:
        """Small pictures and what is known of them, for notebooks."""
        from pbrfit.display.notebook import pictures

        facts = [repr(self), *(f"{topic}: {fact}" for topic, fact in self.assumed.items())]
        return pictures(self.images, self.names, self.valid, facts)
