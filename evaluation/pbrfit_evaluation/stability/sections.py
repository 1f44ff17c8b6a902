"""The sections of the stability suite: what measures each, what its figures may be, and why.

Bounds hold for float32 arithmetic in any order with sums in blocks of up to about a thousand terms
and float64 beyond; they name nothing of how it is done.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from pbrfit.threads import one_blas_thread
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.stability import edges, objective, stiff_fits
from pbrfit_evaluation.stability.double_precision import ROUNDING
from pbrfit_evaluation.stability.objective import ALIKE, MANY, ONE_SIGN, RANDOM
from pbrfit_evaluation.suite import Options

# Of the loss relative to itself, of entries of the gradient relative to their natural scale, of
# blocks of it relative to their norm, of sums of equal terms.
LOSS_BOUND = 5e-7
ENTRY_BOUND = 2e-6
BLOCK_BOUND = 1e-6
EQUAL_TERMS_BOUND = 256 * ROUNDING
FLOAT64_BOUND = 34 * 2.0**-53

_BLOCK = "error over norm of the block"
_ENTRY = "worst entry over its natural scale"
_TERMS = "worst entry over its terms"

Measure = Callable[..., Values]
"""Random numbers, threads and the section's sizes -> `rows`: what was found, by case and key."""


@dataclass(frozen=True)
class Section:
    """`bounds`, by key: a figure in words, and at most what it may be (None = reported only)."""

    measure: Measure
    text: str
    why: str
    bounds: Mapping[str, tuple[str, float | None]]


SECTIONS = {
    "fast objective": Section(
        objective.kernel,
        "Loss and gradient of random and extreme pixels, against the same objective in float64 "
        "throughout; residuals are as large as the signal. Errors are relative to the loss or the "
        "norm of a block, and entry by entry to the natural scale: the same sum with every term "
        "replaced by its size, which is what rounding errors are proportional to.",
        "17 u of a whole: rounding of some 60 operations a number adds up at random to about √60 "
        "u, twice that where terms cancel. 34 u of an entry: the worst of millions; 8 u of lights: "
        "sums over very many pixels, in which roundings average out.",
        {
            "loss_error": ("loss, relative error", BLOCK_BOUND),
            **{
                f"{of}_block_error": (f"gradient by {of}: {_BLOCK}", BLOCK_BOUND)
                for of in ("albedo", "roughness", "metallic", "lights")
            },
            **{
                f"{of}_entry_error": (f"gradient by {of}: {_ENTRY}", ENTRY_BOUND)
                for of in ("albedo", "roughness", "metallic")
            },
            "lights_entry_error": (f"gradient by lights: {_ENTRY}", 5e-7),
        },
    ),
    "cancellation": Section(
        objective.cancellation,
        "Pictures equal what the point renders, but for residuals of 10⁻¹ to 10⁻⁹ of the signal. "
        "Pictures are float32 too: the comparison is with the true residual of the rounded "
        "pictures.",
        "Rounding adds to the residuals a few u of the terms, and the triangle inequality turns "
        "that into 8 u of their RMS. Residuals of 10⁻⁵ are off by some 10⁻⁷, one part in a "
        "hundred, the loss by twice that if all are off the same way; an error δ of a residual d "
        "that has one sign everywhere changes the loss by 2δ/d, 10 % at 20 δ. In the gradient "
        "terms cancel in the sum over pictures, which may cost another factor of ten. That by "
        "lights has no bound where residuals are random: they average out over the pixels, the "
        "rounding of a light does not.",
        {
            "residual_floor": ("reported less true residual, as RMS over the signal's RMS", 5e-7),
            "loss_error_at_1e-5": ("loss at residuals of 10⁻⁵, relative error", 0.02),
            "loss_lost_at": (
                "largest residual tried at which the loss is off by more than 10 %",
                2e-6,
            ),
            "reported_at_1e-7": ("residual reported at a true one of 10⁻⁷", 6e-7),
            "gradient_error_at_1e-3": (
                "gradient at residuals of 10⁻³, error over norm of the block",
                1e-3,
            ),
            "lights_gradient_error_random_at_1e-3": (
                f"gradient by lights at residuals of 10⁻³ with {RANDOM}",
                None,
            ),
        },
    ),
    "accumulated error": Section(
        objective.accumulation,
        "Sums over samples (pixels times pictures; times three channels) against float64 sums over "
        "short pieces, themselves added without rounding. The hard case is residuals of one sign, "
        "hardest when all pixels are alike, so that every addition rounds the same way.",
        "8 u of the loss, as for few samples: float64 takes over early. 34 u with one sign: "
        "residuals are 3/10 of the signal, and the rounding of a light is the same in all pixels. "
        "256 u of equal terms: a float32 sum of n of them is off by up to n/4 u, and blocks hold "
        "up to a thousand, however samples are divided into pixels and pictures.",
        {
            "loss_error_random": (f"loss, relative error, {RANDOM}", LOSS_BOUND),
            "loss_error_one_sign": (f"loss, relative error, {ONE_SIGN}", ENTRY_BOUND),
            "lights_error_random": (f"gradient by lights: {_TERMS}, {RANDOM}", ENTRY_BOUND),
            "lights_error_one_sign": (f"gradient by lights: {_TERMS}, {ONE_SIGN}", ENTRY_BOUND),
            "loss_error_equal": (f"loss, relative error, {ALIKE}", EQUAL_TERMS_BOUND),
            "loss_error_equal_many": (
                f"loss, relative error, {ALIKE}, {MANY} pictures",
                EQUAL_TERMS_BOUND,
            ),
            "lights_error_equal": (f"gradient by lights: {_TERMS}, {ALIKE}", EQUAL_TERMS_BOUND),
            "error_many_pictures": (f"loss and lights, {RANDOM}, many pictures", ENTRY_BOUND),
        },
    ),
    "tiny numbers": Section(
        objective.tiny,
        "Radiance, lights, roughness, albedo and metallic in the subnormal ranges of float32 "
        "(below 1.2·10⁻³⁸) and float64 (below 2.2·10⁻³⁰⁸), and the range of exposures over which "
        "the loss is right. The solver scales pictures to a mean of 0.4 first.",
        "Entries as for other pixels; below the smallest normal float32 an error of that size "
        "times the same bound is allowed. Nothing depends on materials without light, and r³ "
        "underflows for r below 10⁻¹⁰⁸. Squares of 10⁻¹⁵ and 10¹⁵ lie well inside float32's range.",
        {
            "not_finite": ("results that are infinite or not a number", 0),
            "entry_error": ("worst entry, error over natural scale + 10⁻³⁸", ENTRY_BOUND),
            "nonzero": ("entries of the gradient that should be 0 and are not", 0),
            "exposure_error": (
                "loss for exposures from 10⁻¹⁵ to 10¹⁵, relative error",
                LOSS_BOUND,
            ),
        },
    ),
    "stiff fits": Section(
        stiff_fits.measure,
        "Whole fits of small rooms without noise, without priors where none are named: lights that "
        "hardly differ, too few pictures, materials at the ends of their ranges, samples that the "
        "model cannot explain. The answer may be poor where the pictures do not tell it, but it "
        "has to be finite and say so.",
        "Whatever the pictures leave open has to be some number within its bounds at every step, "
        "and no loop is without an end, however singular the equations are. With equal lights, or "
        "with one picture, a pixel has three numbers for five unknowns. gauss-newton ends no "
        "higher than lbfgsb, but for what float32 sums can differ by; residuals below 3·10⁻⁷ of "
        "the pictures count as that.",
        {
            "fits_not_finite": ("numbers of fits that are infinite or not a number", 0),
            "fits_beyond": ("numbers of maps beyond [0, 1]", 0),
            "fits_iterations_over": ("iterations beyond the limit", 0),
            "fits_overlooked": (
                "unknowns that pictures cannot tell, called usable",
                0,
            ),
            "fits_above_lbfgsb": ("residual of gauss-newton over that of lbfgsb, less 1", 1e-6),
        },
    ),
    "edges": Section(
        edges.measure,
        "Random scenes of 4 to 25 pixels and 2 to 16 pictures at the edges that their names tell: "
        "under harmonics, or a far lamp in each picture. The paper's model against its definition "
        "in 50 digits; then `pbrfit.decompose`, which may refuse a scene in words.",
        "34 u of an entry's natural scale, and in float64 34·2⁻⁵³ over n·v: an error of 2⁻⁵³ in "
        "that sum of products is so much larger beside it. Under lamps a rounding of a vector "
        "counts by what it changes: lobes may be 10⁻⁶ radians wide.",
        {
            "float32_error": ("loss and gradient, worst over its natural scale", ENTRY_BOUND),
            "float64_error": ("the same in float64, times the least n·v", FLOAT64_BOUND),
            "lamps_error": ("radiance and gradient under lamps, over its scale", FLOAT64_BOUND),
            "fits_failed": ("fits that ended in an error", 0),
            "fits_warned": ("arithmetic warnings of a fit", 0),
            "fits_not_finite": ("numbers of a fit that are infinite or not a number", 0),
            "fits_beyond": ("numbers of maps, deviations and bounds out of range", 0),
            "fits_misjudged": ("maps called usable that are no rough guide", 0),
            "mixed_misjudged": ("the same of mixtures of metal and dielectric under lamps", None),
        },
    ),
}
"""By name, in the order of the report."""


@dataclass(frozen=True)
class Task:
    """One section; each draws its own pixels, lights and pictures, whatever the others do."""

    section: str
    sizes: tuple[int, ...]
    seed: int

    @property
    def key(self) -> str:
        """Name of the record."""
        return self.section.replace(" ", "-")


def run(task: Task, threads: int) -> Values:
    """Measure one section."""
    section = SECTIONS[task.section]
    rng = np.random.default_rng([task.seed, 1 + list(SECTIONS).index(task.section)])
    # Small matrices: more BLAS threads only get into each other's way, and change the last bits.
    with one_blas_thread():
        return section.measure(rng, threads, *task.sizes)


def cases(options: Options) -> list[Task]:
    """All sections."""
    return [Task(section, getattr(options, section), options.seed) for section in SECTIONS]
