"""pbrfit: physically based materials and lighting from several pictures of one view."""

from pbrfit._core import InputError
from pbrfit.geometry import view_directions
from pbrfit.model import Materials, ggx_band_weights, render, sh_basis, shade, shade_vjp

__all__ = [
    "InputError",
    "Materials",
    "ggx_band_weights",
    "render",
    "sh_basis",
    "shade",
    "shade_vjp",
    "view_directions",
]
