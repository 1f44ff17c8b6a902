"""How a scene is read and fitted: what a worker is told, and what a result has to agree with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pbrfit.fit.priors.penalties import Priors
from pbrfit.io.color import ColorSpace
from pbrfit.io.images import CODE_RANGE
from pbrfit.result.refinement import RefineNormals

if TYPE_CHECKING:
    from pbrfit.fit.decompose import Loss, Progress
    from pbrfit.fit.solvers import Solver
    from pbrfit.model.reflection import Model
    from pbrfit.result.result import Options, Result
    from pbrfit.scene.scene import Scene


@dataclass(frozen=True)
class Reading:
    """Arguments of `Scene.load`, which see."""

    fov: float | None = None
    color_space: ColorSpace | None = None
    max_size: int | None = None
    code_range: tuple[int, int] = CODE_RANGE

    def load(self, path: Path) -> Scene:
        """Read a scene folder."""
        from pbrfit.scene.scene import Scene

        return Scene.load(path, **{one.name: getattr(self, one.name) for one in fields(self)})

    def as_json(self) -> Mapping[str, Any]:
        """What `result.json` says under `scene` beside the path."""
        return {**asdict(self), "code_range": list(self.code_range)}


@dataclass(frozen=True)
class Fitting:
    """Arguments of `decompose` that change the result; see there."""

    solver: Solver = "auto"
    iterations: int = 500
    time_limit: float | None = None
    sh_order: int = 3
    metallic: float | None = None
    mono_light: bool = False
    priors: Priors = field(default_factory=Priors)
    robust: Loss = "none"
    equal_exposures: bool | None = None
    refine_normals: RefineNormals = "auto"
    seed: int = 0
    model: Model | None = None

    def fit(self, scene: Scene, threads: int, progress: Callable[[Progress], None]) -> Result:
        """Decompose a scene."""
        from pbrfit.fit.decompose import decompose

        arguments = {one.name: getattr(self, one.name) for one in fields(self)}
        return decompose(scene, threads=threads, progress=progress, **arguments)

    def options(self) -> Options:
        """What a result of `fit` says about its options."""
        from pbrfit.result.result import Options

        arguments = {one.name: getattr(self, one.name) for one in fields(self)}
        return Options(**{**arguments, "priors": asdict(self.priors)})
