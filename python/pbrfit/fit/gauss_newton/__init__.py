"""Gauss-Newton for lights and materials together, where L-BFGS stalls.

The problem has the structure of bundle adjustment: five unknowns a pixel, 48 a picture, and pixels
that touch the lights only. Two things stop L-BFGS: a few pixels in a wrong local minimum of
roughness and metallic bend the lights, and along some directions of the lights (the scale
between albedo and light, bands 2 and 3) the loss is a narrow valley. Gauss-Newton walks the
valleys, and trying all of roughness and metallic frees the pixels; each alone stalls too.

1. `subsample`: a few hundred pixels, drawn by a seed, find the lights, at a cost that does not
   depend on the size of the picture. Rounds of two steps: each pixel by itself tries a grid of
   roughness and metallic with the best albedo at each node, descends from the best few and keeps
   what is lower; then joint steps with the pixels solved for (`schur_complement` in the core), each
   followed by a descent of every pixel under its new lights.
2. `pixels`: all pixels, by themselves, given these lights; those whose residuals stand out from
   more starts, and from what their neighbours have found.
3. `global_gauss_newton`: joint steps of all pixels and the lights. The system of the lights is
   solved by conjugate gradients, preconditioned with that of some pixels.

Where lights are known there is 2 alone.
"""

from pbrfit.fit.gauss_newton.global_gauss_newton import fit_materials, fit_with_prior
from pbrfit.fit.gauss_newton.pixels import Watch
from pbrfit.fit.gauss_newton.subsample import LightEstimate, find_lights

__all__ = ["LightEstimate", "Watch", "find_lights", "fit_materials", "fit_with_prior"]
