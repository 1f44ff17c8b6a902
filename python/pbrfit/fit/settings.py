"""Every number that a fit decides by: its quantity, its unit, and what happens on either side.

Sums of squared residuals are in units of x: pictures are divided so that their mean radiance is
0.4 (`Normalization`). A share is a number in [0, 1] without unit. Numbers that belong to a formula
stand beside it.
"""

from __future__ import annotations

import math

# --- Start and normalization ------------------------------------------------------------------

MEAN_RADIANCE = 0.4
"""Mean valid radiance after division by the scene scale, so that exposure does not matter."""

START_MEAN_ALBEDO = 0.5
"""Mean albedo that the mean picture is scaled to at the start, the middle of the range. The scale
between albedo and light is what the fit finds last, so it matters where it starts: from 0.4, the
mean radiance, the errors on synthetic rooms after 500 iterations are 1.5 times as large."""

START_ROUGHNESS = 0.5
START_METALLIC = 0.25
START_ALBEDO_RANGE = (0.02, 0.98)
"""The start keeps clear of the bounds 0 and 1, where the gradient by albedo may vanish."""

LARGEST_LIGHT = 1e15
"""Multiple of the scene scale above which known lights are refused: float32 has to hold the squares
of residuals."""

LIGHT_RIDGE = 1e-6
"""Share of the mean eigenvalue that is added to the lights' normal equations at the start: keeps
the lights finite where the normals show only part of a sphere."""

NOISE_SIGMA_MIN = 1e-4 * MEAN_RADIANCE
"""Smallest standard deviation of the noise that a robust loss allows for, in units of x: pictures
may be explained perfectly."""

NEAR_GREY = 0.05
"""Relative deviation of the lights from grey (`color_deviation`) up to which the monochrome prior
acts by itself; above it lights keep their colours. docs/priors.md has what was measured."""

GREY_WEIGHT = 1e-3
"""Weight of the monochrome prior on lights that are near grey."""

WHOLE_PIXELS_MAX = 1 << 21
"""Valid pixels up to which the solver auto fits all of them at once; larger pictures are fitted in
tiles."""


# --- Misfit: whether residuals are noise ------------------------------------------------------


# --- Gauss-Newton: lights from a subset of the pixels -----------------------------------------


# --- Gauss-Newton: all pixels -----------------------------------------------------------------


# --- L-BFGS, and the choice between solvers ---------------------------------------------------

DATA_SHARE_OF_ITERATIONS = 0.5
"""Share of the iterations that L-BFGS spends on the data alone, before the mixture prior is fitted
around its result; the rest is spent with the prior."""

EXACT_RMSE = 1e-6
"""Root mean square residual, at mean radiance 0.4, up to which pictures count as explained to the
last digit: then no mixture prior is fitted. Rounding to float32 leaves 1e-8."""

FAR_BETTER = 0.1
"""Ratio of Gauss-Newton's sum of squared residuals to L-BFGS's up to which Gauss-Newton's fit is
taken, whatever it leaves."""

SAME_FIT = 0.9
"""The same ratio, from which (up to 1) Gauss-Newton's fit is taken as the same minimum, further
along its valleys; between `FAR_BETTER` and this L-BFGS's fit stays. After 250 iterations on seven
rooms the ratio was 0.93 to 0.99 where lights of order 2 were fitted to pictures of order 3, and
Gauss-Newton's materials were better; with a wrong field of view it was 0.42 to 0.79, and they were
worse."""

SAME_FIT_OF_VALIDATION_PIXELS = (0.8, 1.3)
"""The same ratio on the validation pixels alone, between which it is worth fitting all pixels by
Gauss-Newton to compare."""

LBFGS_PAIRS = 10
"""Pairs of steps and gradients that L-BFGS remembers; memory grows with it, 10 is scipy's default.
"""

TRAP_ROUGHNESS = 0.1
"""Roughness below which the first stages of L-BFGS do not go. Band weights and G1 depend on r⁴, so
their slope is r³ and roughness 0 is a stationary point of every pixel: one that overshoots to the
bound stays there, far from its minimum, and bends the lights. Between 0 and 0.1 pictures under SH
light hardly change, so little is lost by waiting."""

TRAPPED_MARGIN = 0.005
"""Roughness above `TRAP_ROUGHNESS` up to which a pixel counts as caught at that bound."""

LBFGS_STAGES = ((TRAP_ROUGHNESS, 0.3), (TRAP_ROUGHNESS, 0.6), (0.0, 1.0))
"""(Lowest roughness, share of the iterations after which the stage ends). Between stages, pixels
that ended at the bound start again from the middle."""

LBFGS_STAGES_GIVEN_START = ((0.0, 1.0),)
ROBUST_STAGES_GIVEN_START = ((0.0, 0.3), (0.0, 1.0))
"""The same where a start is given. A robust loss needs a fit by squares first, which tells its
scale."""

STALL = (10, 1e-5)
"""(Iterations, share): after Gauss-Newton, L-BFGS stops where the loss fell by less than this share
of itself over so many iterations."""

LOSS_RESOLUTION = 1e-9
"""Relative resolution of a difference of nearby losses, whose residuals are those of float32:
smaller differences count as none."""

SCIPY_UP_TO = 100_000
"""Unknowns up to which scipy's L-BFGS-B is taken, 128² pixels of three channels; above it the one
whose vectors are in Rust. Up to there 500 of scipy's iterations take seconds, and the fit is that
of the reference, bit for bit. The other takes a third to a tenth of the time at any size, but after
as many iterations single scenes end up to 12 % above scipy's loss, others as much below."""


# --- Mixture prior on materials ---------------------------------------------------------------


# --- Normals ----------------------------------------------------------------------------------


# --- Tiles ------------------------------------------------------------------------------------


# --- Uncertainty ------------------------------------------------------------------------------

SIGMA_UNDETERMINED = 1 / math.sqrt(12)
"""Marginal standard deviation of a material value above which it counts as not determined: that of
a number about which nothing is known but that it lies in [0, 1]."""

SIGMA_MAX = 1.0
"""Standard deviation of a material value at which larger ones are cut off, the width of its
range."""

LIGHT_PIXELS_MAX = 4096
"""Pixels, evenly spread, up to which all and above which so many give the covariance of the lights.
Time and memory grow with them, the deviations hardly change."""

OMITTED_VARIANCE_SHARE_MAX = 1e-3
"""Share of the pixels' variances, in the mean, that the modes of the lights which are left out may
add together; smaller keeps more modes."""

LIGHT_INFORMATION_MIN = 1e-10
"""Share of its information that a direction of the light keeps when materials are fitted too, below
which it is rounding: materials can make up for that direction completely."""

FREE_MOVE_MAX = 0.01
"""Change of a material value, when the light changes by its own size in a direction that materials
can make up for, above which the value is not determined."""

OMITTED_CHECK_PIXELS = 512
"""Pixels in which the deviations by the modes in use are compared with those by all."""
