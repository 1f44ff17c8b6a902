"""How a scene is read: what a worker is told, and what a result has to agree with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pbrfit.io.color import ColorSpace
from pbrfit.io.images import Orientation

if TYPE_CHECKING:
    from pbrfit.scene.scene import Scene


@dataclass(frozen=True)
class Reading:
    """Arguments of `Scene.load`, which see."""

    fov: float | None = None
    color_space: ColorSpace | None = None
    max_size: int | None = None
    code_range: tuple[int, int] | None = None
    orientation: Orientation | None = None

    def load(self, path: Path) -> Scene:
        """Read a scene folder."""
        from pbrfit.scene.scene import Scene

        return Scene.load(path, **{one.name: getattr(self, one.name) for one in fields(self)})

    def as_json(self) -> Mapping[str, Any]:
        """What `result.json` says under `scene` beside the path."""
        code_range = None if self.code_range is None else list(self.code_range)
        return {**asdict(self), "code_range": code_range}
