"""What each figure of the stability suite is, and what it may be, and why."""

from __future__ import annotations

from dataclasses import dataclass

from pbrfit_evaluation.stability.measure import ONE_SIGN, RANDOM, ROUNDING
from pbrfit_evaluation.stability.objective import ALIKE, MANY, QUANTITIES, REPEATS, THREADS
from pbrfit_evaluation.stability.stiff_fits import ABOVE_NONE, LIMITS, REFERENCE

# Of band weights and slopes, of the loss relative to itself, of entries of the gradient relative to
# their natural scale, of blocks of it relative to their norm, of sums of equal terms.
BAND_BOUND = 1e-14
SLOPE_BOUND = 5e-14
LOSS_BOUND = 5e-7
ENTRY_BOUND = 2e-6
BLOCK_BOUND = 1e-6
EQUAL_TERMS_BOUND = 256 * ROUNDING

_ENTRIES = "34 u, as for the entries of the gradient."
_EQUAL = (
    "256 u; equal terms round equally. A float32 sum of n equal terms is off by up to n/4 u, and "
    "blocks hold up to a thousand."
)
_NOISE = (
    "8 u, as away from branch points; float32 makes the objective a staircase whose steps no "
    "smaller change of x can resolve."
)


@dataclass(frozen=True)
class Bound:
    """One figure: its key, what it is in words, at most what (None = reported only), and why."""

    key: str
    what: str
    most: float | None
    why: str


def _noise(kind: str, what: str) -> tuple[Bound, Bound]:
    what = f"fast objective, noise of the {what}"
    return (
        Bound(f"fast_{kind}_noise", what, LOSS_BOUND, _NOISE),
        Bound(f"fast_{kind}_jump", f"{what}: largest change from step to step", LOSS_BOUND, _NOISE),
    )


def _compared(rule: str, key: str, what: str) -> Bound:
    return Bound(
        f"paper_{rule}_{key}_error",
        f"for comparison, paper's rule, {rule}: {what}",
        None,
        "What the package would do if it took that rule.",
    )


BOUNDS: dict[str, tuple[Bound, ...]] = {
    "band weights": (
        Bound(
            "value_error",
            "h, absolute error",
            BAND_BOUND,
            "Weights are at most 4, whose float64 spacing is 9·10⁻¹⁶: a dozen roundings.",
        ),
        Bound(
            "slope_error",
            "dh/dr, absolute error",
            SLOPE_BOUND,
            "Slopes reach 10, and 25 terms of a series with its roundings make a few 10⁻¹⁴.",
        ),
        Bound(
            "slope_relative_error",
            "dh/dr for r < 0.4, relative error",
            1e-14,
            "Terms hardly cancel here: some dozens of roundings of 10⁻¹⁶ each, though slopes fall "
            "like r³.",
        ),
        _compared("float64", "value", "h"),
        _compared("float32", "value", "h"),
        _compared("float64", "slope", "dh/dr"),
        _compared("float32", "slope", "dh/dr"),
    ),
    "fast objective": (
        Bound(
            "loss_error",
            "loss, relative error",
            BLOCK_BOUND,
            "17 u; residuals are as large as the signal here and off by a few u of it. Where one "
            "bright picture makes the loss, the rounding of its light does not average out.",
        ),
        *(
            Bound(
                f"{name}_block_error",
                f"gradient by {name}: error over norm of the block",
                BLOCK_BOUND,
                "17 u; rounding of some 60 operations a number adds up at random to about √60 u, "
                "twice that where terms cancel.",
            )
            for name in QUANTITIES[1:]
        ),
        *(
            Bound(
                f"{name}_entry_error",
                f"gradient by {name}: worst entry over its natural scale",
                ENTRY_BOUND,
                "34 u; the worst of millions, still below the 60 u or more that so many operations "
                "could add up to.",
            )
            for name in QUANTITIES[1:-1]
        ),
        Bound(
            "lights_entry_error",
            "gradient by lights: worst entry over its natural scale",
            5e-7,
            "8 u; sums over very many pixels, in which roundings average out.",
        ),
    ),
    "branch points": (
        Bound(
            "band_jump",
            "h across r = 0.4, jump beyond the true change",
            2 * BAND_BOUND,
            "Twice the bound on the error, one for each side.",
        ),
        Bound(
            "band_slope_jump",
            "dh/dr across r = 0.4, jump beyond the true change",
            2 * SLOPE_BOUND,
            "Twice the bound on the error, one for each side.",
        ),
        Bound(
            "weight_jump",
            "float64 weights across r = 0, 0.4, 1: change less slope times step",
            BAND_BOUND,
            "No jump beyond the bands' own errors, relative to the sum of the terms' sizes.",
        ),
        Bound(
            "clamp_jump",
            "float64 weights across n·v = 10⁻⁴, relative to the sum of the terms' sizes",
            2e-11,
            "Weights may go with the clamped cosine, of which the step is 10⁻¹¹ and the rounding "
            "of n·v some 10⁻¹²; a jump would stay as the step shrinks.",
        ),
        Bound(
            "slope_against_difference",
            "analytic slope, float64, against a central difference",
            1e-11,
            "Fourth-order difference with step 10⁻⁴: truncation and rounding both stay near "
            "10⁻¹², relative to the loss and the natural scale of the slope.",
        ),
        Bound(
            "fast_slope_against_difference",
            "analytic slope, fast objective, against the same difference",
            LOSS_BOUND,
            "8 u, as for the loss.",
        ),
        *_noise("loss", "loss, relative"),
        *_noise("gradient", "slope by roughness, relative to its natural scale"),
    ),
    "cancellation": (
        Bound(
            "residual_floor",
            "reported less true residual, as RMS over the signal's RMS",
            5e-7,
            "8 u: rounding adds to the residuals a few u of the terms, and the triangle inequality "
            "turns that into this.",
        ),
        Bound(
            "loss_error_at_1e-5",
            "loss at residuals of 10⁻⁵, relative error",
            0.02,
            "Residuals of 10⁻⁵ are off by some 10⁻⁷, one part in a hundred; the loss by twice that "
            "if all are off the same way.",
        ),
        Bound(
            "loss_lost_at",
            "largest residual tried at which the loss is off by more than 10 %",
            2e-6,
            "An error δ of a residual d that has one sign everywhere changes the loss by 2δ/d, "
            "which is 10 % at 20 δ; δ is one or two u.",
        ),
        Bound(
            "reported_at_1e-7",
            "residual reported at a true one of 10⁻⁷",
            6e-7,
            "The residual itself and the floor.",
        ),
        Bound(
            "gradient_error_at_1e-3",
            "gradient at residuals of 10⁻³, error over norm of the block",
            1e-3,
            "Residuals of 10⁻³ carry an error of about 10⁻⁷, 10⁻⁴ of them; terms cancel in the sum "
            "over pictures, which may cost another factor of ten.",
        ),
        Bound(
            "lights_gradient_error_random_at_1e-3",
            f"gradient by lights at residuals of 10⁻³ with {RANDOM}",
            None,
            "No bound: random residuals average out over the pixels, the rounding of a light, "
            "which is the same in all of them, does not. So it grows with the root of their "
            "number.",
        ),
    ),
    "accumulated error": (
        Bound(
            "loss_error_random",
            f"loss, relative error, {RANDOM}",
            LOSS_BOUND,
            "8 u, as for few samples: float64 takes over early.",
        ),
        Bound(
            "loss_error_one_sign",
            f"loss, relative error, {ONE_SIGN}",
            ENTRY_BOUND,
            "34 u; residuals are 3/10 of the signal here, and the rounding of a light is the same "
            "in all pixels: a few u of the signal are three times as many of the residual, and "
            "twice that in its square.",
        ),
        Bound(
            "lights_error_random",
            f"gradient by lights: worst entry over its terms, {RANDOM}",
            ENTRY_BOUND,
            _ENTRIES,
        ),
        Bound(
            "lights_error_one_sign",
            f"gradient by lights: worst entry over its terms, {ONE_SIGN}",
            ENTRY_BOUND,
            _ENTRIES,
        ),
        Bound("loss_error_equal", f"loss, relative error, {ALIKE}", EQUAL_TERMS_BOUND, _EQUAL),
        Bound(
            "loss_error_equal_many",
            f"loss, relative error, {ALIKE}, {MANY} pictures",
            EQUAL_TERMS_BOUND,
            "The same: pictures are no reason to sum for longer.",
        ),
        Bound(
            "lights_error_equal",
            f"gradient by lights: worst entry over its terms, {ALIKE}",
            EQUAL_TERMS_BOUND,
            _EQUAL,
        ),
        Bound(
            "error_many_pictures",
            f"loss and lights, {RANDOM}, many pictures of fewer pixels",
            ENTRY_BOUND,
            "34 u, however samples are divided into pixels and pictures.",
        ),
    ),
    "tiny numbers": (
        Bound(
            "not_finite",
            "results that are infinite or not a number",
            0,
            "Every input is finite and small.",
        ),
        Bound(
            "entry_error",
            "worst entry, error over natural scale + 10⁻³⁸",
            ENTRY_BOUND,
            "As for other pixels, but below 1.2·10⁻³⁸, the smallest normal float32, an error of "
            "that size times the same bound is allowed.",
        ),
        Bound(
            "nonzero",
            "entries of the gradient that should be 0 and are not",
            0,
            "Nothing depends on materials without light, and r³ underflows for r below 10⁻¹⁰⁸.",
        ),
        Bound(
            "differs_from_mirror",
            "numbers that differ between r = 0 and subnormal r",
            0,
            "r⁴ underflows, so the two are the same surface to the last bit.",
        ),
        Bound(
            "exposure_error",
            "loss for exposures from 10⁻¹⁵ to 10¹⁵, relative error",
            LOSS_BOUND,
            "8 u, as at exposure 1: squares of 10⁻¹⁵ and 10¹⁵ lie well inside float32's range.",
        ),
        Bound(
            "time_ratio",
            "time of an evaluation over that with ordinary numbers",
            None,
            "Some processors take a hundred cycles for a subnormal operand; a clock decides no "
            "verdict.",
        ),
    ),
    "determinism": (
        Bound(
            "differs_between_threads",
            f"numbers that differ between {', '.join(map(str, THREADS))} threads",
            0,
            "Sums are taken in an order that does not depend on the threads, to the last bit.",
        ),
        Bound(
            "differs_between_calls",
            f"numbers that differ between {REPEATS} calls",
            0,
            "An evaluation depends on its input alone.",
        ),
    ),
    "stiff fits": (
        Bound(
            "fits_not_finite",
            "numbers of fits that are infinite or not a number",
            0,
            "Maps, lights, deviations, history: whatever the pictures leave open has to be some "
            "number.",
        ),
        Bound("fits_beyond", "numbers of maps beyond [0, 1]", 0, "Bounds hold at every step."),
        Bound(
            "fits_iterations_over",
            "iterations beyond the limit",
            0,
            "No loop without an end, however singular the equations are.",
        ),
        Bound(
            "fits_overlooked",
            "unknowns that pictures cannot tell, neither flagged nor on a bound",
            0,
            "With equal lights, or with one picture, a pixel has three numbers for five unknowns.",
        ),
        Bound(
            "fits_above_lbfgsb",
            f"residual of {ABOVE_NONE} over that of {REFERENCE}, less 1",
            1e-6,
            "It ends no higher, but for what float32 sums can differ by; residuals below 3·10⁻⁷ of "
            "the pictures count as that.",
        ),
        Bound(
            "fits_limit_over",
            f"iterations beyond a limit of {', '.join(map(str, LIMITS))}",
            0,
            "A limit is a limit in every stage.",
        ),
        Bound(
            "fits_time_evaluations",
            "evaluations after the start with a time limit of 0",
            1,
            "At most the one that was under way.",
        ),
        Bound(
            "fits_late",
            "time beyond a limit of a fifth of a fit, over the whole fit's",
            None,
            "At most a step; a clock decides no verdict.",
        ),
        Bound(
            "fits_threads",
            "numbers of a fit that differ between 1 and 3 threads",
            0,
            "To the last bit, through every stage.",
        ),
    ),
}
"""By section, in the order of the report."""
