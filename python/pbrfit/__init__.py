"""pbrfit: physically based materials and lighting from several pictures of one view."""

from pbrfit._core import InputError
from pbrfit.fit.decompose import Progress, decompose
from pbrfit.fit.objective import Objective
from pbrfit.model.geometry import view_directions
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import ggx_band_weights, render, sh_basis, shade, shade_vjp
from pbrfit.result.data import Status
from pbrfit.result.options import FitOptions, Priors
from pbrfit.result.relighting import DirectionalLight, relight
from pbrfit.result.result import Result
from pbrfit.scene.arrays import Truth
from pbrfit.scene.scene import Scene

__all__ = [
    "DirectionalLight",
    "FitOptions",
    "InputError",
    "Materials",
    "Objective",
    "Priors",
    "Progress",
    "Result",
    "Scene",
    "Status",
    "Truth",
    "decompose",
    "ggx_band_weights",
    "relight",
    "render",
    "sh_basis",
    "shade",
    "shade_vjp",
    "view_directions",
]
