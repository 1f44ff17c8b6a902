"""Scene: the arrays of a scene, with the folder that they are read from and written to."""

from __future__ import annotations

from pathlib import Path

from pbrfit.io.color import ColorSpace
from pbrfit.io.images import Orientation
from pbrfit.scene import reading, writing
from pbrfit.scene.arrays import SceneArrays


class Scene(SceneArrays):
    """Pictures of one view under different lights; `SceneArrays` has what it holds and checks."""

    @classmethod
    def load(
        cls,
        path: str | Path,
        *,
        fov: float | None = None,
        color_space: ColorSpace | None = None,
        max_size: int | None = None,
        code_range: tuple[int, int] | None = None,
        orientation: Orientation | None = None,
    ) -> Scene:
        """Read a scene folder (see docs/formats.md).

        Parameters
        ----------
        path
            The folder.
        fov
            Horizontal field of view in degrees; overrides `scene.toml` and EXIF.
        color_space
            Of all pictures; overrides `scene.toml`, profiles and file types.
        max_size
            Longer side in pixels; larger pictures are averaged down.
        code_range
            Lowest and highest code of 8-bit pictures that is data, and the same shares of the
            maximum of 16-bit ones; what is outside is in `limits`. None = 1 to 250 in JPEG, all but
            0 and the maximum in other integer pictures; (0, 255) = all are data.
        orientation
            "exif" turns each picture as its EXIF data says, "as-stored" none; overrides
            `scene.toml`. None = as there, else "exif".

        Raises
        ------
        InputError, OSError
            One line that names the file, what was expected and what was found.
        """
        return reading.load(
            Path(path),
            cls,
            fov=fov,
            color_space=color_space,
            max_size=max_size,
            code_range=code_range,
            orientation=orientation,
        )

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write a scene folder that `load` reads back: float32 EXR, ground truth included.

        The mask leaves out pixels that no picture tells anything of. Samples of weight 0 that are
        NaN or infinite are stored as 0. Limits are stored beside each picture, what its file did to
        its samples (`noise_floor`) is not. Segments with ids below 0 or above 65535 are numbered
        anew.

        Raises
        ------
        FileExistsError
            If the folder exists and `overwrite` is False.
        """
        writing.save(self, Path(path), overwrite=overwrite)
