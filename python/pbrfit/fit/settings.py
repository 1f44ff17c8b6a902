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

START_MIDDLE = 0.5
"""Middle of their range, where roughness, and the mean of the albedo, start: the scale between
albedo and light is what a fit finds last."""

START_METALLIC = 0.25
START_ALBEDO_RANGE = (0.02, 0.98)
"""The start keeps clear of the bounds 0 and 1, where the gradient by albedo may vanish."""

LARGEST_LIGHT = 1e15
"""Multiple of the scene scale above which known lights are refused: float32 holds squares."""

LIGHT_RIDGE = 1e-6
"""Share of the diagonal that is added to the lights' normal equations, at the start of the mean,
and in the preconditioner: keeps lights finite where the normals show only part of a sphere."""

NEAR_GREY = 0.05
"""Relative deviation of lights from grey (`color_deviation`) up to which `monochrome` acts."""

GREY_WEIGHT = 1e-3
"""Weight of the monochrome prior on lights that are near grey."""

WHOLE_PIXELS_MAX = 1 << 21
"""Valid pixels up to which gauss-newton fits all at once; larger pictures are fitted in tiles."""

# --- Noise ------------------------------------------------------------------------------------

DEGREES_OF_FREEDOM_SHARE_MIN = 0.1
"""Smallest share of the samples that the noise's degrees of freedom count as."""

NOISE_VARIANCE_MIN = 1e-20
"""Smallest variance of the noise in units of x squared, for where nothing is left unexplained."""

DAMPING_START = 1e-3
"""First damping of joint steps, as a share of the diagonal of each pixel's matrix (Marquardt)."""

# --- Levels, and what they leave --------------------------------------------------------------

COARSE_PIXELS = 1024
"""Pixels of the level that finds lights, misfit and prior, and of the systems whose square is taken
for each pixel, the preconditioner's and that of the lights' covariance."""

SUBSET_STARTS = 2
"""Nodes of roughness and metallic from which each pixel of a level descends in a round."""

COARSE_ROUNDS_MAX = 12
COARSE_STEPS = 6
"""Rounds of that level, each a search of the nodes for each pixel and up to so many joint steps."""

SAMPLES_OF_UNKNOWN = 5
"""Samples for each unknown of a pixel below which lights are sought from a second start too: in
colour, up to 8 pictures. One start ended in wrong minima in two of 12 rooms with 5 pictures."""

EARLY_ROUNDS = 2
"""First rounds, whose residuals are those of wrong lights: samples are not weighed in them, that
second start takes all surfaces for dielectrics, and lamps stay as diffuse shading has them but for
their scale."""

DIELECTRIC_SIGMA = 0.1
"""Standard deviation of the normal distribution around a dielectric of middle roughness that
roughness and metallic have in these rounds of that start: most surfaces are dielectrics."""

COARSE_GAIN_MIN = 10.0
GAIN_MIN = 0.1
"""Gain in χ² that a joint step has to promise, on the coarse level and at last: 1 is one standard
deviation of one direction of the lights, 0.1 a third of one."""

COARSE_ROUND_GAIN_MIN = 0.02
COARSE_WEIGHT_FALL = 0.1
"""Shares of the sum lowered, at most, and of the light prior's weight left that end the rounds."""

PATCH_SIDE = 8
PATCHES_MIN = 4
"""Rows and columns of a level's pixels in a patch, and how many patches, or groups of pixels, tell
a variance; one less are the fewest degrees of freedom that it is taken to have."""

# --- Noise of samples -------------------------------------------------------------------------

NOISE_ESTIMATION_STEPS = 8
"""Steps of expectation and maximisation, each of which a step of the fit follows."""

NOISE_FREEDOMS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0)
NOISE_FREEDOM_START = 3.0
"""Degrees of freedom of Student's t that are tried, beside a normal distribution, which stays
unless another is likelier by more than a number costs; and where the steps begin."""

OUTLIER_WIDTHS = (10.0, 30.0, 100.0, 300.0)
"""Standard deviations of outliers that are tried, in those of ordinary samples: from a highlight
that the model does not have, to hot pixels in pictures of 8 bits and of floats. Beyond the first of
them a left-out pixel tells nothing where no explanation comes nearer: it is hot."""

OUTLIER_SHARE_START, OUTLIER_SHARE_MAX = 0.01, 0.2
OUTLIER_STEPS = 4
"""Share of outliers that EM begins with, the largest beside ordinary samples, and its steps."""

NOISE_VARIANCE_RATIO_MIN = 1 / 256
"""Smallest variance of a picture beside the median of all, one sixteenth of the deviation: a black
picture is explained to the last digit and says nothing."""

NOISE_READ_SHARE_MIN = 1e-3
"""Smallest share of variance without radiance, so that no black sample has all the weight."""

PICTURE_DEVIATION_NAMED = 2.0
"""Ratio of a picture's deviation to the median from which the result names it."""

WEIGHT_ROUNDS = 3
"""Times that all pixels are fitted and their weights by noise in turn, and where normals are
refined the prior around their neighbours' last ones."""

LEVERAGE_MAX = 0.9
"""Largest share of a sample's noise that the fit is said to take up."""

EVEN_WEIGHTS_LOSS_MAX = 0.02
"""Share of information (L. Kish: Σw²n/(Σw)² − 1) that equal weights may lose: 1 % in deviation."""

# --- The camera -------------------------------------------------------------------------------

LOG_FOCAL_LENGTH_SIGMA = 0.45
"""Standard deviation of the logarithm of the focal length around that of `FIRST_FOV`, 31 mm on a 35
mm camera: lenses of telephones and common zooms, 13 mm to 77 mm, are within two of them."""

RESPONSE_SIGMAS = (0.3, 0.1, 0.1)
"""Standard deviations of the exponent of a tone curve around 1, and of how far it differs in
shadows and in lights: gammas of displays and cameras are 1.8 to 2.6."""

FOV_MIN = 1.0
"""Degrees that a narrower field of view, and an orthographic one, counts as while it is moved."""

NUISANCE_DIFFERENCE = 0.02
"""Change of a number of the camera, a logarithm, for derivatives: float32 rounds 1e-5 of it."""

NUISANCE_STEP_MAX = 0.3
"""Largest change of such a number in a round: as far as a linear model holds."""

NUISANCE_GAIN_MIN = 1.0
"""Gain in χ² of a step, at which these numbers count as found: one standard deviation."""

NUISANCE_INFORMATION_MIN = 1e-6
"""Share of its information that a number of the camera keeps when lights are solved for, below
which that is rounding of float32 derivatives."""

NUISANCE_ERROR_RATIO = 0.02
"""As `CG_ERROR_RATIO`, where what the lights take is subtracted, and some tenths are left."""

# --- Gauss-Newton: all pixels -----------------------------------------------------------------

DESCENT_ROUGHNESS_NODES = (0.08, 1.0, 12)
DESCENT_METALLIC_NODES = (0.0, 1.0, 6)
"""(Lowest, highest, count) of the nodes from which pixels descend."""

DESCENT_STEPS = 12
"""Steps of a pixel's descent from a node, on sums over pictures that are made once."""

DESCENT_EXACT_STEPS = 1
DESCENT_EXACT_STEPS_FREE_NORMALS = 4
"""Steps on residuals after these, for the last digits; in these alone free normals turn."""

DESCENT_STEPS_AFTER_JOINT = 4
"""Steps of each pixel by itself after a joint step."""

RETRY_RATIO = 5.0
"""Ratio of a pixel's sum of squared residuals to the median of all from which it is tried again
from more nodes and from its neighbours' materials: beyond noise."""

RETRY_ROUGHNESS_NODES = (0.02, 1.0, 24)
RETRY_METALLIC_NODES = (0.0, 1.0, 11)
RETRY_STARTS = 6
"""Nodes for these pixels, as above, and from how many of the best they descend."""

LIGHTS_PIXELS = 16_384
"""Pixels of the second level, and those that final distributions are fitted to. Each of the 48
numbers of a picture's light is then as uncertain as a sample divided by √(3 · 16384 / 48) = 32,
which adds a two-thousandth to the error of a pixel."""

GLOBAL_ROUNDS_MAX = 4
"""Rounds of joint steps of that level and of trying pixels again; likewise for surroundings."""

GLOBAL_STEPS_MAX = 8
"""Joint steps in a round."""

GLOBAL_STEP_SHARES = (1.0, 0.4)
"""Shares of a joint step that are tried before the damping grows; each costs a pass over all."""

GLOBAL_DAMPING_FACTOR = 30.0
"""Factor on the damping after a failed step, and divisor after another."""

GLOBAL_DAMPING_MAX = 0.5
"""Damping from which a failed step is the last."""

WORSE_RATIO = 1.02
"""Ratio of a pixel's sum of squared residuals after a joint step to that before, above which it may
have fallen into another minimum and starts again."""

CG_ITERATIONS_MAX = 20
"""Products with the lights' system in a joint step, or as many as cost what a new preconditioner
does."""

CG_ERROR_RATIO = 0.1
"""Ratio of the remaining error to the first, in the norm of the preconditioner, at which conjugate
gradients stop: the descent of all pixels after them costs more."""

CG_GAIN_SHARE = 0.1
"""Share of the gain that makes a step worth while (`GAIN_MIN`) at which they stop too."""

# --- Comparison of explanations ---------------------------------------------------------------

COMPARE_PIXELS = 500
"""Pixels that explanations are compared at: spread over a picture their residuals are about
independent, and a mean square of so many is known to 6 %."""

COMPARE_SIDE = 64
"""Longer side in pixels of the averaged pictures that tell the shape where no normals are given."""

COMPARE_PIXELS_MIN = 32
"""Pixels from which on pictures are compared, and tell a bas-relief: fewer leave the 48 numbers of
a light free, and each of the eight of the relief has fewer than four."""

COMPARE_KEPT_MIN = 3
"""Pictures that have to be left to fit: three in colour are nine samples for the five unknowns of a
pixel with a known normal, and tell a normal that is not."""

COMPARE_SHARE = 4
"""One picture in so many is left out."""

COMPARE_PICTURES_MIN = 4
"""Left-out pictures altogether, in as many folds as that takes: what one curve or light leaves of
two of them says of the next two next to nothing."""

COMPARE_PATCHES = 8
"""Patches along the longer side of a picture or its mask, whose means tell how sure a score is, or
the scale: 64 tell a variance to a fifth. What light from other surfaces, gloss, shadows and blocks
of JPEG put in error together is at most as large."""

COMPARE_ERRORS_MIN = 2.0
"""Standard errors from which on a difference of scores, or between surroundings, counts; twice as
many after some of the left-out pictures alone, as others may differ."""

COMPARE_SHARED_MAX = 0.2
"""Share of the mean square of left-out errors that pixels and channels have in common up to which
the rest counts as noise: no other explanation could leave less by more than that."""

COMPARE_LAMP_LEFT_MIN = 0.02
"""Relative error that pixels and channels have in common up to which harmonics leave no lamp. Of
the clamped cosine the bands above 2 have 0.9 % of the energy (R. Ramamoorthi and P. Hanrahan, JOSA
A 18, 2001), a tenth of the radiance; surfaces that face few ways show a fifth of that."""

COMPARE_FOV_GAIN_MIN = math.log(2)
"""By how much lower the score of a fitted field of view has to be to contradict the given one: half
of the mean square error. Of one 30° off a twentieth stays, with normals 10° off nine tenths."""

COMPARE_LIGHT_STEPS = 3
"""Gauss-Newton steps of a left-out picture's light, in the files' values."""

COMPARE_DARKEST = 1e-3
"""Radiance, of white, below which the slope of a tone curve counts as it is there."""

# --- Lamps ------------------------------------------------------------------------------------

LAMP_PIXELS = 1500
"""Number of pixels that lamps are found by: some 20 unknowns a lamp have 100 samples each."""

# --- L-BFGS-B ---------------------------------------------------------------------------------

EXACT_RMSE = 1e-6
"""Root mean square residual, at mean radiance 0.4, up to which pictures count as explained to the
last digit. Rounding to float32 leaves 1e-8."""

TRAP_ROUGHNESS = 0.1
"""Roughness below which the first stages of L-BFGS do not go. Band weights and G1 depend on r⁴, so
roughness 0 is a stationary point of every pixel: one that overshoots to it stays there."""

TRAPPED_MARGIN = 0.005
"""Roughness above `TRAP_ROUGHNESS` up to which a pixel counts as caught at that bound."""

LBFGS_STAGES = ((TRAP_ROUGHNESS, 0.3), (TRAP_ROUGHNESS, 0.6), (0.0, 1.0))
"""(Lowest roughness, share of the iterations after which the stage ends). Between stages, pixels
that ended at the bound start again from the middle. The last alone is where a start is given."""

# --- Mixture prior on materials ---------------------------------------------------------------

PRIOR_ROUGHNESS_NODES = (0.03, 1.0, 33)
PRIOR_METALLIC_NODES = (0.0, 1.0, 7)
"""(Lowest, highest, count) of the nodes on which segments have their distributions."""

PRIOR_NODE_SPACING = 0.03
"""Spacing of the roughness nodes to which likelihoods that are sharper are widened."""

PRIOR_SIGMA_MIN = 0.01
"""Smallest standard deviation of a pixel's Gaussian prior in roughness and metallic."""

PRIOR_ROUNDS = ((0.05, 1024, 8), (0.02, 1024, 8), (PRIOR_SIGMA_MIN, 2048, 4), (0.0, 4096, 6))
"""Rounds that find lights and prior together: that deviation, wide at first, while lights are
wrong; pixels; and joint steps at most. Where the deviation is 0 pixels have that of their group."""

SPREAD_MIN = 0.002
"""Smallest standard deviation in a group of one material: below that of 1,000 pixels, 0.1/√1000."""

PIXELS_AT_ONCE = 8192
"""Pixels whose samples are held at a time by each processor; changes no result."""

EM_ITERATIONS, EM_PIXELS_AT_ONCE, GRID_PIXELS_AT_ONCE = 100, 512, 2048
"""Iterations of EM; pixels whose likelihoods a processor's cache holds, and each holds at once."""

SEGMENT_PIXELS_MIN = 16
"""Pixels from which a segment has a distribution of its own; below, it has that of the picture."""

PICTURE_PSEUDO_PIXELS = 10.0
"""Number of pixels that the distribution of the whole picture counts for in that of a segment."""

NODE_PROBABILITY_MIN = 1e-18
"""Smallest probability and likelihood of a node: one without pixels may be of others, and products
stay above float32's 1e-38, below which arithmetic is many times slower."""

GROUP_PROBABILITY_SHARE = 0.02
"""Share of the largest probability: neighbouring nodes above it are one group."""

LIKELIHOOD_CURVATURE_MIN = 1e-6
"""Smallest second difference of a log-likelihood between nodes, which may be flat."""

OFFSET_PRECISION_SHARE = 1e-3
"""Precision of a cluster's offset around 0, as a share of the summed precision of its pixels."""

# --- Scale ------------------------------------------------------------------------------------

SCALE_PIXELS = 4096
"""Pixels that tell how uncertain the common scale of lights and albedo is."""

SCALE_STEP_MAX = 0.1
"""Largest relative step of the scale by a linear change of the lights: its square leaves 1 %."""

GROUP_LEVERAGE_MAX = 0.5
"""Share of the information on the scale that a group counts as having, at most."""

UNIFORM_PRECISION = 12.0
"""1/variance of a number that may lie anywhere in [0, 1]."""

WHITE_RADIUS = 1
"""Rows and columns on each side of a reference's pixel that belong to it: 3 × 3."""

WHITE_TOLERANCE = 0.02
"""Relative standard deviation of a reference's albedo: what printed charts are made to."""

WHITE_ERROR = 1e-4
WHITE_STEPS_MAX = 40
"""Relative error of a reference's albedo that is left, and steps of `SCALE_STEP_MAX` at most."""

WHITE_ALBEDO_MIN = 1e-3
"""Albedo below which a reference's pixels count as that: they were taken for something else."""

# --- Normals ----------------------------------------------------------------------------------

STRIDED_SUBSET_EXCESS = 1.25
"""Times as many pixels as wanted that a strided subset may have."""

NORMALS_PATCH_SIDE = 4
"""Pixels along a side of the patches of a level whose offsets move together."""

PURE_ROUGHNESS_NODES = (0.05, 1.0, 20)
PURE_EVIDENCE_MAX = 1.0
PURE_SIGMAS = (0.1, 0.05)
"""Among surroundings, where segments have about one roughness, and metallic 0 or 1: (lowest,
highest, count) of the roughness that they are tried with; natural units of evidence that a pixel
adds at most, four times as many against a roughness; standard deviations of a pixel's roughness and
metallic around its segment's."""

TRANSPORT_WHOLE_PIXELS_MAX = WHOLE_PIXELS_MAX // 4
"""Pixels above which a scene that may have surroundings is fitted in tiles. Its tables take up to
4 kB a pixel with 16 colour pictures and the model paper, and 8 kB with principled: 4 GB."""

TRANSPORT_PIXELS = 400
"""Pixels that lights are fitted to while surroundings are compared, and pixels left out."""

TRANSPORT_RAYS = 2048
"""Rays of a pixel, about, for tables to within 1 %; while surroundings are compared a quarter, for
2 %."""

NORMALS_DIELECTRIC_ROUNDS = 3
"""First rounds of a search, in which metallic has a prior around 0 in place of the fitted one. A
first pass has these alone; all but lights then starts once more, which on nine rooms halved the
errors."""

NORMALS_DIELECTRIC_SIGMA = 0.2
"""Standard deviation of that prior on metallic."""

NORMALS_MATERIAL_SIGMAS_MIN = (0.1, 0.04, 0.02)
"""Smallest standard deviation of the fitted prior in the rounds after those; the last one stays."""

NORMALS_OFFSET_SIGMA_ALONE = math.radians(60.0)
"""Standard deviation of each tangent offset by itself, in radians: weak, because counted once a
pixel it holds back a turn that all normals have in common."""

NORMALS_OFFSET_SIGMA_START = math.radians(6.0)
"""Standard deviation of neighbours' tangent offsets, in radians, before the pictures tell it."""

NORMALS_OFFSET_SIGMA_RANGE = (math.radians(0.05), math.radians(12.0))
"""Smallest and largest standard deviation, in radians, that is found for it."""

NORMALS_HALF_WEIGHT_STEP = 3.0
"""Difference between neighbours' tangent offsets, in their standard deviations, at which a pair
counts half; larger ones, at outlines, count less."""

NORMALS_EDGE_SCALE = 0.1
"""Squared difference |Δn|² between neighbours' given normals, 18 degrees, at which the weight of
the pair has fallen to 1/e: from about here on an edge lies between them."""

NORMALS_GIVEN_SIGMA_MIN = 0.1
"""Smallest uncertainty of a given normal, as a share of the mean one: nothing is known for sure."""

# --- Tiles ------------------------------------------------------------------------------------

TILE_SIDE = 512
"""Rows and columns of a tile, at most: memory grows with its square."""

TILES_SUBSET_PIXELS_MAX = TILE_SIDE**2
"""Pixels that find the lights of a large picture, as many as a tile has: lights then make 1 % of a
pixel's own error."""

TILE_MARGIN = 32
"""Pixels around a tile that are fitted with it, not kept, where normals are refined."""

# --- Uncertainty ------------------------------------------------------------------------------

SIGMA_MAX = 0.5
"""Largest standard deviation of a material value: of one that is 0 or 1 and nobody knows which."""

ALBEDO_DEVIATION = 0.3
"""Standard deviation of a pixel's albedo before any picture, with a channel's colour."""

SAMPLE_USES = 3.0
"""Times that samples are used, which is what their variance counts for in a pixel's likelihood: for
its lights, its prior and itself; once more for normals that were refined. At 1, of roughness that
grey pictures tell 0.6 lies within two deviations, at 3 0.99 (rooms of seeds 5000 to 5003)."""

POPULATION_PIXELS = 3.0
"""Strength of a material's prior, in pseudo-observations. With 10 the roughness of simple rooms is
1.5 times worse, without any three pictures tell metallic hardly better than a guess."""

MISFIT_AMPLIFICATION = 120.0
"""G: by how much more of an error of the model lights and materials take up than what neighbours
share of the residuals. With wrong fields of view, orders, models and surroundings 50 to 600 fit."""

MISFIT_SHARE_MAX = 0.5
"""Largest deviation of a sample by the model's errors, as a share of the mean radiance: more would
say that the pictures show next to nothing of the scene."""

MISFIT_STEPS = 16
"""Distance of pixels that show what the model lacks, by the longer side: beyond a camera's blur."""

MISFIT_PAIRS = 2048
"""Pairs of such pixels, in each direction: what they share is known to a hundredth of s²."""

MISFIT_ERRORS = 3.0
"""Standard errors that are taken off: noise alone is above it once in 700 scenes."""

HIGHLIGHT_SHARE = 0.05
"""Share of its light that a dielectric shows as its highlight, which tells the scale: an error of
samples is so many times smaller than the error of the scale that it makes."""

SCALE_NOISE_RATIO = 2.0
"""Least relative deviation of a scale that was found, in relative deviations of the samples: bias
by noise, which the jackknife does not see (2 to 9 % with noise of 2.5 %)."""

OMITTED_VARIANCE_SHARE_MAX = 1e-3
"""Share of the pixels' variances, in the mean, that the lights' modes left out may add together."""

LIGHT_INFORMATION_MIN = 1e-10
"""Least share of its information that a direction of the light keeps beside fitted materials."""
