"""The rows of Table 1, which docs/table1.md describes: what each changes about the base."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from pbrfit.result.refinement import RefineNormals
from pbrfit_evaluation.recipes import DEFAULT, GUESS, PAPER, PAPER_REGULARIZED, Way

COLUMNS = ("recon", "albedo", "roughness", "metallic", "relight")
"""What the paper reports."""

WAYS: Mapping[str, Way] = {
    "default": DEFAULT,
    "paper": PAPER,
    "paper-priors": PAPER_REGULARIZED,
    "constant": GUESS,
}

COMPARED = ("default", "paper", "constant")

REFINED = ("default",)
"""The paper's recipe and guesses cannot refine normals."""

REGULARIZED = ("default", "paper-priors", "constant")

Renderer = Literal["own", "cycles"]
NormalSource = Literal["true", "predicted"]


@dataclass(frozen=True)
class Row:
    """One setup."""

    key: str
    name: str
    """`key` and `name`: for files, and for people."""
    scene: Literal["furnished", "detailed"] = "furnished"
    """Kind of scene."""
    renderer: Renderer = "own"
    """Whose pictures: our forward model's, or Blender Cycles'."""
    light: Literal["panorama", "points"] = "panorama"
    transport: Literal["brdf", "shadows", "full"] = "full"
    """`light` and `transport`: of Cycles: see `pbrfit_evaluation.cycles.render_scene`."""
    normals: NormalSource = "true"
    """The true ones, or those of a simulated estimator."""
    refine_normals: RefineNormals = "off"
    """As for `pbrfit.decompose`."""
    sh_order: int = 3
    """That the decomposition fits; the true lights have order 3."""
    fov: float = 60.0
    """That the decomposition is told, in degrees; the true one is 60."""
    swapped: bool = False
    """Whether our renderer uses the other model than the one that is fitted, instead of the same.
    """
    ways: tuple[str, ...] = COMPARED
    """Keys of the ways to explain its scenes."""
    enlarged: int = 1
    """Side of its pictures, over that of the others."""
    paper: Mapping[str, float] = field(default_factory=dict)
    """The paper's RMSE, on the paper's scenes."""

    @property
    def slow(self) -> bool:
        """Whether a scene takes minutes, so that fewer are measured."""
        return self.renderer == "cycles" or self.refine_normals != "off" or self.enlarged > 1


def _paper(*errors: float) -> dict[str, float]:
    return dict(zip(COLUMNS, errors, strict=False))


ROWS = (
    Row("base", "Base", paper=_paper(0.001, 0.065, 0.232, 0.186, 0.166)),
    Row("base-large", "Base, four times as wide and high", enlarged=4),
    Row("sh2", "SH2 decomposition", sh_order=2, paper=_paper(0.002, 0.064, 0.242, 0.147, 0.154)),
    Row(
        "normals",
        "Predicted normals",
        normals="predicted",
        paper=_paper(0.016, 0.160, 0.341, 0.446, 0.201),
    ),
    Row(
        "normals-refined",
        "Predicted normals, refined",
        normals="predicted",
        refine_normals="auto",
        ways=REFINED,
    ),
    Row("fov90", "FOV 90", fov=90.0, paper=_paper(0.004, 0.091, 0.283, 0.194, 0.143)),
    Row("other-model", "Pictures of the other model", swapped=True),
    Row("detailed", "Detailed scenes", scene="detailed"),
    Row("cycles-brdf", "Cycles, panorama: BRDF alone", renderer="cycles", transport="brdf"),
    Row("cycles-shadows", "Cycles, panorama: and shadows", renderer="cycles", transport="shadows"),
    Row("cycles-panorama", "Cycles, panorama", renderer="cycles"),
    Row(
        "cycles-points-unshadowed",
        "Cycles, point lights without shadows",
        renderer="cycles",
        light="points",
        transport="brdf",
    ),
    Row(
        "cycles-points",
        "Cycles, point lights",
        renderer="cycles",
        light="points",
        transport="shadows",
        paper=_paper(0.040, 0.386, 0.408, 0.630),
    ),
    Row(
        "cycles-detailed",
        "Detailed scenes, Cycles, panorama",
        scene="detailed",
        renderer="cycles",
        paper=_paper(0.043, 0.222, 0.334, 0.435, 0.210),
    ),
    Row(
        "regularized",
        "Regularised",
        ways=REGULARIZED,
        paper=_paper(0.010, 0.066, 0.241, 0.248, 0.160),
    ),
)

BY_KEY = {row.key: row for row in ROWS}
