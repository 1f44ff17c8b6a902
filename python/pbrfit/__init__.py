"""pbrfit: physically based materials and lighting from several pictures of one view."""

from pbrfit._core import InputError
from pbrfit.geometry import view_directions
from pbrfit.materials import Materials
from pbrfit.model import ggx_band_weights, render, sh_basis, shade, shade_vjp
from pbrfit.objective import Objective
from pbrfit.priors import Priors
from pbrfit.relighting import DirectionalLight, relight
from pbrfit.result import Result, Status
from pbrfit.scene import Scene, Truth
from pbrfit.solve import Progress, decompose

__all__ = [
    "DirectionalLight",
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
