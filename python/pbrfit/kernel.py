"""Formulas of the reflection models as functions on arrays, for own optimisers."""

from pbrfit.model.geometry import view_directions
from pbrfit.model.reflection import ggx_band_weights, render, sh_basis, shade, shade_vjp

__all__ = ["ggx_band_weights", "render", "sh_basis", "shade", "shade_vjp", "view_directions"]
