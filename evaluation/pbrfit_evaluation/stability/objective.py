"""The fast objective against float64: its pixels, near a perfect fit, its sums, its range."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from pbrfit._core import InputError
from pbrfit.report.notation import scientific
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.scores import MAPS
from pbrfit_evaluation.stability.double_precision import (
    KINDS,
    Case,
    Rows,
    compare,
    random_case,
    random_lights,
    random_pixels,
    worst_entry,
)

PICTURES = 8
"""Of a problem."""


# ------------------------------------------------------------------------- loss and gradient


def kernel(rng: Generator, threads: int, pixels: int) -> Values:
    """Loss and gradient by kind of pixel; what depends on a pixel is summed over pictures, too."""
    drawn = ((name, change, 1) for name, change in KINDS.items())
    many = ("random, 32 times as many pictures", KINDS["random"], 32)
    rows: Rows = {}
    for name, change, times in (*drawn, many):
        case = change(rng, random_case(rng, pixels // times, PICTURES * times))
        found, blocks = compare(case, threads), case.blocks()
        rows[name] = {"loss_error": found.loss_error}
        rows[name] |= {f"{of}_block_error": found.block_error(at) for of, at in blocks.items()}
        rows[name] |= {f"{of}_entry_error": found.entry_error(at) for of, at in blocks.items()}
    return {"rows": rows}


# ------------------------------------------------------------------------------ cancellation

RANDOM, ONE_SIGN = "random signs", "one sign"
"""Forms of the residuals."""

RESIDUALS = 10.0 ** -np.arange(1.0, 9.25, 0.5)
"""Share of the signal."""

MEANINGFUL = 0.1
"""The loss means something while it is off by less than this fraction."""


def cancellation(rng: Generator, threads: int, pixels: int) -> Values:
    """Pictures that differ from the rendered ones by 10⁻¹ to 10⁻⁹ of the signal."""
    drawn, lighting = random_pixels(rng, pixels), random_lights(rng, PICTURES)
    signal = drawn.render(lighting, threads)
    size = math.sqrt(float(np.mean(signal**2)))
    rows: Rows = {}
    noises = {RANDOM: rng.normal(size=signal.shape), ONE_SIGN: np.ones(signal.shape)}
    for form, noise in noises.items():
        for level in RESIDUALS:
            case = Case(drawn, lighting, (signal * (1 + level * noise)).astype(np.float32))
            found, lights = compare(case, threads), case.blocks()["lights"]
            true, said = (math.sqrt(loss) / size for loss in (found.true.loss, found.loss))
            off = abs((said / true) ** 2 - 1)
            blocks = {"materials": slice(lights.start), "lights": lights}
            by = {name: found.block_error(block) for name, block in blocks.items()}
            row = {
                "residual": true,
                "residual_floor": abs(said - true),
                "loss_error": off,
                "loss_lost_at": 0.0 if off <= MEANINGFUL else true,
                **{f"gradient_by_{name}_error": error for name, error in by.items()},
            }
            if _near(level, 1e-3):
                # Random residuals average out over the pixels, the rounding of a light does not.
                if form == RANDOM:
                    row["lights_gradient_error_random_at_1e-3"] = by.pop("lights")
                row["gradient_error_at_1e-3"] = float(np.max(list(by.values())))
            elif _near(level, 1e-5):
                row["loss_error_at_1e-5"] = off
            elif _near(level, 1e-7):
                row["reported_at_1e-7"] = said
            rows[f"{form}, {scientific(level)}"] = row
    return {"rows": rows}


def _near(level: float, other: float) -> bool:
    return math.isclose(level, other, rel_tol=1e-6)


# ------------------------------------------------------------------------- accumulated error

ALIKE = "one sign, all pixels alike"
FORMS = {RANDOM: "random", ONE_SIGN: "one_sign", ALIKE: "equal"}

FEW_PIXELS = 1024
MANY = 256
"""Pixels and pictures of the problems in which equal terms are looked for a bad value."""


def accumulation(
    rng: Generator, threads: int, largest: int, pixels_of_many: int, draws: int
) -> Values:
    """Loss and light gradients of up to 16 · 4^`largest` samples against float64 sums."""
    pictures = 2 * PICTURES
    rows: Rows = {f"{pictures * 4**k:,} samples": {} for k in range(3, largest + 1)}
    for form, short in FORMS.items():
        for k, row in enumerate(rows.values(), start=3):
            errors = _sum_errors(_summed_case(form, 4**k, pictures, rng, threads), threads)
            row[f"loss_error_{short}"], row[f"lights_error_{short}"] = errors
    # The worst of many values for terms that are all equal.
    equal = []
    for _ in range(draws):
        few, many = (
            _sum_errors(_summed_case(ALIKE, FEW_PIXELS, count, rng, threads), threads)
            for count in (pictures, MANY)
        )
        equal.append((*few, *many))
    of_few, by_lights, of_many, by_lights_of_many = np.max(equal, axis=0).tolist()
    rows[f"{draws} draws"] = {"loss_error_equal": of_few, "lights_error_equal": by_lights}
    rows[f"{draws} draws, {MANY} pictures"] = {
        "loss_error_equal_many": of_many,
        "lights_error_equal": by_lights_of_many,
    }
    case = _summed_case(RANDOM, pixels_of_many, MANY, rng, threads)
    rows["many pictures"] = {"error_many_pictures": float(np.max(_sum_errors(case, threads)))}
    return {"rows": rows}


def _sum_errors(case: Case, threads: int) -> tuple[float, float]:
    """Error of the loss, and of the gradient by lights over the sum of its terms' sizes."""
    found, lights = compare(case, threads), case.blocks()["lights"]
    errors = found.gradient[lights] - found.true.gradient[lights]
    return found.loss_error, worst_entry(errors, found.true.lights_terms)


def _summed_case(form: str, count: int, pictures: int, rng: Generator, threads: int) -> Case:
    if form == RANDOM:
        return random_case(rng, count, pictures)
    pixels = random_pixels(rng, count)
    lighting = random_lights(rng, pictures, variation=0.1)
    if form == ALIKE:
        pixels = pixels[np.zeros(count, dtype=np.intp)]
        lighting = np.repeat(lighting[:1], pictures, axis=0)
    images = np.empty((pictures, count, 3), dtype=np.float32)
    step = 16384
    for start in range(0, count, step):
        rows = slice(start, start + step)
        images[:, rows] = 0.7 * pixels[rows].render(lighting, threads)
    return Case(pixels, lighting, images)


# ------------------------------------------------------------------ tiny numbers, and exposures

SMALLEST_NORMAL = float(np.finfo(np.float32).tiny)

EXPOSURES = 10.0 ** np.arange(-30.0, 20.5, 1.0)
"""Factors on lights and pictures; from 1e-15 to 1e15 the loss has to be right."""

DIM = "lights of 10⁻³¹⁰, black pictures"
MIRROR = "roughness of 10⁻³²³ to 10⁻³⁰⁸"
BLACK = "no light, black pictures"
UNLIT = "no light"

MUST_BE_ZERO = {
    BLACK: (*MAPS, "lights"),
    UNLIT: MAPS,
    DIM: MAPS,
    MIRROR: ("roughness",),
}
"""Blocks of the gradient that are 0."""


def tiny(rng: Generator, threads: int, pixels: int) -> Values:
    """Radiance, lights, roughness, albedo and metallic in the subnormal ranges; exposures."""
    plain = random_case(rng, pixels, PICTURES)
    rows: Rows = {}
    for name, case in _tiny_cases(plain, rng).items():
        found, blocks = compare(case, threads), case.blocks()
        of_loss = abs(found.loss - found.true.loss) / (found.true.loss_scale + SMALLEST_NORMAL)
        of_entries = found.entry_error(slice(None), SMALLEST_NORMAL)
        numbers = np.append(found.gradient, found.loss)
        rows[name] = {
            "not_finite": int(np.count_nonzero(~np.isfinite(numbers))),
            "entry_error": float(np.max([of_loss, of_entries])),
            "nonzero": sum(
                int(np.count_nonzero(found.gradient[blocks[block]]))
                for block in MUST_BE_ZERO.get(name, ())
            ),
        }
    for factor in EXPOSURES:
        key = "exposure_error" if abs(math.log10(factor)) < 15.5 else "error_beyond"
        rows[f"exposure {scientific(factor)}"] = {key: _exposed(plain, factor, threads)}
    return {"rows": rows}


def _tiny_cases(plain: Case, rng: Generator) -> dict[str, Case]:
    """Ordinary pixels with one thing tiny."""
    p = plain.pixels
    tiny64, tiny32 = (10.0 ** rng.uniform(*span, len(p)) for span in ((-323, -308), (-45, -38)))
    black = np.zeros_like(plain.images)
    dark = replace(p, albedo=np.stack([tiny64] * 3, axis=-1), metallic=tiny64)
    faint = (1e-40 * plain.images).astype(np.float32)
    return {
        "radiance and lights of 10⁻⁴⁰": Case(p, 1e-40 * plain.lighting, faint),
        DIM: Case(p, 1e-310 * plain.lighting, black),
        MIRROR: replace(plain, pixels=replace(p, roughness=tiny64)),
        "roughness of 10⁻⁴⁵ to 10⁻³⁸": replace(plain, pixels=replace(p, roughness=tiny32)),
        "albedo and metallic of 10⁻³²³ to 10⁻³⁰⁸": replace(plain, pixels=dark),
        BLACK: Case(p, np.zeros_like(plain.lighting), black),
        UNLIT: replace(plain, lighting=np.zeros_like(plain.lighting)),
    }


def _exposed(case: Case, factor: float, threads: int) -> float:
    """Relative error of the loss with lights and pictures times a factor; refused: infinite."""
    few = slice(0, 512)
    images = (factor * case.images[:, few]).astype(np.float32)
    exposed = Case(case.pixels[few], factor * case.lighting, images)
    try:
        return compare(exposed, threads).loss_error
    except InputError:  # beyond what float32 sums of squares can hold
        return math.inf
