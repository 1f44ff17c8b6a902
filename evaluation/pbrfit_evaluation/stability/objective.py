"""The fast objective against float64: its pixels, near a perfect fit, its sums, its bits."""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from pbrfit import _core
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.stability.double_precision import Case, evaluate, sums
from pbrfit_evaluation.stability.extreme_pixels import (
    KINDS,
    MANY_PICTURES,
    make_case,
    random_case,
    random_lights,
    random_pixels,
)
from pbrfit_evaluation.stability.measure import (
    ONE_SIGN,
    RANDOM,
    Array,
    Effort,
    ratio,
    worst,
    worst_entry,
)

QUANTITIES = ("loss", "albedo", "roughness", "metallic", "lights")

RESIDUALS = 10.0 ** -np.arange(1.0, 9.25, 0.5)
"""Share of the signal."""

MEANINGFUL = 0.1
"""The loss means something while it is off by less than this fraction."""

ALIKE = "one sign, all pixels alike"
FORMS = (RANDOM, ONE_SIGN, ALIKE)

FEW_PIXELS = 1024
MANY = 256
"""Pixels and pictures of the problems in which equal terms are looked for a bad value."""

THREADS = (1, 2, 3, 8)
REPEATS = 3


# ------------------------------------------------------------------------- loss and gradient


def kernel(effort: Effort, rng: Generator, threads: int) -> Values:
    """Loss and gradient of random and extreme pixels.

    By kind of pixel, `of_sum` are errors relative to the loss, or to the norm of a block of the
    gradient; `of_entry` the worst entry relative to its natural scale.
    """
    of_sum: dict[str, dict[str, float]] = {name: {} for name in QUANTITIES}
    of_entry: dict[str, dict[str, float]] = {name: {} for name in QUANTITIES}
    for kind in (*KINDS, MANY_PICTURES):
        count, pictures = effort.pixels_of_a_kind, effort.pictures
        if kind is MANY_PICTURES:
            count, pictures = count // 32, pictures * 32
        case = make_case(rng, kind, count, pictures)
        loss, gradient = case.problem(threads).value_and_grad(case.x)
        true = evaluate(case)
        of_sum["loss"][kind.name] = ratio(abs(loss - true.loss), true.loss)
        of_entry["loss"][kind.name] = ratio(abs(loss - true.loss), true.loss_scale)
        for name, block in case.blocks().items():
            errors = gradient[block] - true.gradient[block]
            of_sum[name][kind.name] = ratio(_norm(errors), _norm(true.gradient[block]))
            of_entry[name][kind.name] = worst_entry(errors, true.gradient_scale[block])
    figures = {"loss_error": worst(of_sum["loss"])}
    figures |= {f"{name}_block_error": worst(of_sum[name]) for name in QUANTITIES[1:]}
    figures |= {f"{name}_entry_error": worst(of_entry[name]) for name in QUANTITIES[1:]}
    return {"figures": figures, "of_sum": of_sum, "of_entry": of_entry}


def _norm(values: Array) -> float:
    return float(np.linalg.norm(values))


# ------------------------------------------------------------------------------ cancellation


def cancellation(effort: Effort, rng: Generator, threads: int) -> Values:
    """Pictures that differ from the rendered ones by 10⁻¹ to 10⁻⁹ of the signal.

    `residual` is the true root mean square residual relative to that of the signal, `reported`
    what the fast loss says it is, `gradient_error` that of the gradient over its norm.
    """
    pixels = random_pixels(rng, effort.residual_pixels)
    lighting = random_lights(rng, effort.pictures)
    signal = pixels.render(lighting, threads)
    size = math.sqrt(float(np.mean(signal**2)))
    residual: dict[str, list[float]] = {RANDOM: [], ONE_SIGN: []}
    reported: dict[str, list[float]] = {RANDOM: [], ONE_SIGN: []}
    errors: dict[str, list[float]] = {
        f"{name}, {form}": [] for form in residual for name in ("materials", "lights")
    }
    noises = {RANDOM: rng.normal(size=signal.shape), ONE_SIGN: np.ones(signal.shape)}
    for form, noise in noises.items():
        for level in RESIDUALS:
            case = Case(pixels, lighting, (signal * (1 + level * noise)).astype(np.float32))
            loss, gradient = case.problem(threads).value_and_grad(case.x)
            true = evaluate(case)
            residual[form].append(math.sqrt(true.loss) / size)
            reported[form].append(math.sqrt(loss) / size)
            lights = case.blocks()["lights"]
            for name, block in (("materials", slice(lights.start)), ("lights", lights)):
                error = _norm(gradient[block] - true.gradient[block])
                errors[f"{name}, {form}"].append(error / _norm(true.gradient[block]))
    true_, said = ({form: np.array(of[form]) for form in of} for of in (residual, reported))
    relative = {form: np.abs((said[form] / true_[form]) ** 2 - 1) for form in true_}
    lost = {
        form: np.max(true_[form], where=~(relative[form] <= MEANINGFUL), initial=0.0)
        for form in true_
    }
    at_1e3 = {name: values[_at(1e-3)] for name, values in errors.items()}
    averaged = at_1e3.pop(f"lights, {RANDOM}")
    figures = {
        "residual_floor": worst({form: np.max(np.abs(said[form] - true_[form])) for form in true_}),
        "loss_error_at_1e-5": worst({form: of[_at(1e-5)] for form, of in relative.items()}),
        "loss_lost_at": worst(lost),
        "reported_at_1e-7": worst({form: of[_at(1e-7)] for form, of in said.items()}),
        "gradient_error_at_1e-3": worst(at_1e3),
        "lights_gradient_error_random_at_1e-3": (averaged, ""),
    }
    curves = {"residual": residual, "reported": reported, "gradient_error": errors}
    return {"figures": figures, **curves}


def _at(level: float) -> int:
    """Index of the residual nearest to a level."""
    return int(np.argmin(np.abs(np.log(RESIDUALS / level))))


# ------------------------------------------------------------------------- accumulated error


def accumulation(effort: Effort, rng: Generator, threads: int) -> Values:
    """Loss and light gradients of up to 16 million samples against float64 sums.

    By form of the residuals and number of samples (pixels times pictures): relative error of the
    `loss`; worst error of the gradient by the `lights`, relative to the sum of its terms' sizes;
    and `naive`, error of the loss when all squares are added up one by one in float32.
    """
    samples = [pixels * effort.summed_pictures for pixels in effort.summed_pixels]
    loss: dict[str, list[float]] = {form: [] for form in FORMS}
    lights: dict[str, list[float]] = {form: [] for form in FORMS}
    naive: dict[str, list[float]] = {form: [] for form in FORMS}
    for form in FORMS:
        for pixels in effort.summed_pixels:
            case = _summed_case(form, pixels, effort.summed_pictures, rng, threads)
            of_loss, of_lights, true = _sum_errors(case, threads)
            loss[form].append(of_loss)
            lights[form].append(of_lights)
            naive[form].append(_naive_error(case, true, threads))
    figures = {
        f"{name}_error_{short}": worst(
            {f"{n:,} samples": error for n, error in zip(samples, of[form], strict=True)}
        )
        for name, of in (("loss", loss), ("lights", lights))
        for form, short in ((RANDOM, "random"), (ONE_SIGN, "one_sign"))
    }
    # The worst of many values for terms that are all equal.
    few, of_lights_all = list(loss[ALIKE]), list(lights[ALIKE])
    many: list[float] = []
    for _ in range(effort.draws):
        for found, pictures in ((few, effort.summed_pictures), (many, MANY)):
            case = _summed_case(ALIKE, FEW_PIXELS, pictures, rng, threads)
            of_loss, of_lights, _true = _sum_errors(case, threads)
            found.append(of_loss)
            of_lights_all.append(of_lights)
    for key, errors in (
        ("loss_error_equal", few),
        ("loss_error_equal_many", many),
        ("lights_error_equal", of_lights_all),
    ):
        figures[key] = float(np.max(errors)), f"{effort.draws} draws"
    pixels, pictures = effort.summed_many
    case = _summed_case(RANDOM, pixels, pictures, rng, threads)
    of_loss, of_lights, _true = _sum_errors(case, threads)
    figures["error_many_pictures"] = worst({"loss": of_loss, "lights": of_lights})
    return {"figures": figures, "samples": samples, "loss": loss, "lights": lights, "naive": naive}


def _sum_errors(case: Case, threads: int) -> tuple[float, float, float]:
    """Error of the loss, of the gradient by lights, and the true loss."""
    found, gradient = case.problem(threads).value_and_grad(case.x)
    true = sums(case)
    errors = gradient[case.blocks()["lights"]] - true.by_lights
    of_loss = abs(found - true.loss) / true.loss
    return of_loss, worst_entry(errors, true.by_lights_scale), true.loss


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


def _naive_error(case: Case, loss: float, threads: int) -> float:
    """Error of a float32 running sum of the squared residuals."""
    total = np.float32(0)
    step = 65536
    for start in range(0, len(case.pixels), step):
        rows = slice(start, start + step)
        residual = case.pixels[rows].render(case.lighting, threads) - case.images[:, rows]
        squared = np.square(residual.astype(np.float32)).ravel()
        # numpy's sums are pairwise, its running sums are not.
        total = np.cumsum(np.concatenate([[total], squared]), dtype=np.float32)[-1]
    return abs(float(total) / case.images.size - loss) / loss


# ------------------------------------------------------------------------------- determinism


def determinism(effort: Effort, rng: Generator, _: int) -> Values:
    """Every bit of loss and gradient at different numbers of threads, and again and again."""
    between_threads = between_calls = 0
    for count, pictures in effort.repeated:
        case = random_case(rng, count, pictures)
        first = _bits(case.problem(THREADS[0]), case.x)
        for threads in THREADS:
            problem = case.problem(threads)
            calls = [_bits(problem, case.x) for _ in range(REPEATS)]
            between_threads += int(np.count_nonzero(calls[0] != first))
            between_calls += sum(int(np.count_nonzero(bits != calls[0])) for bits in calls[1:])
    sizes = ", ".join(f"{count} × {pictures}" for count, pictures in effort.repeated)
    where = f"pixels × pictures: {sizes}"
    return {
        "figures": {
            "differs_between_threads": (between_threads, where),
            "differs_between_calls": (between_calls, where),
        }
    }


def _bits(problem: _core.Problem, x: Array) -> NDArray[np.uint64]:
    loss, gradient = problem.value_and_grad(x)
    return np.concatenate([[loss], gradient]).view(np.uint64)
