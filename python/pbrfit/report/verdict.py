"""Which maps of a result can be used, how the fit went in plain sentences, its key numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from pbrfit.report import normals
from pbrfit.report.html import Cell, Table, number, paragraph
from pbrfit.report.notation import percent, plain
from pbrfit.report.pictures import Picture, median_share, worst
from pbrfit.result.camera import Camera
from pbrfit.result.data import Status
from pbrfit.result.result import Result
from pbrfit.result.verdict import PARAMETERS, Level, Verdict, thresholds
from pbrfit.transport.decision import Kind

MODEL_FAILS = 0.05
"""Median residual, relative to the pictures' RMS, above which it is hardly noise alone."""

LACKS: Mapping[Kind, str] = {
    "none": "shadows, near lamps, light between surfaces",
    "occlusion": "near lamps, light between surfaces",
    "bounce": "near lamps",
}
"""What pictures may hold that the model does not, by what surroundings do."""

SCALE_UNKNOWN = 0.1
"""Relative deviation of the scale between albedo and light above which a sentence says so."""

NEGATIVE_LIGHT = 0.5
"""Negative over positive luminance of a light above which a sentence warns. Light from a single
direction, cut off at l = 3, has 0.445."""

METRICS = {
    "recon_rmse": "residual of the pictures (RMSE)",
    "albedo_rmse": "albedo, error (RMSE)",
    "albedo_scaled_rmse": "albedo, error at the best scale (RMSE)",
    "roughness_rmse": "roughness, error (RMSE)",
    "metallic_rmse": "metallic, error (RMSE)",
    "relight_rmse": "relit under ground-truth lights, error (RMSE)",
}


CLASSES: Mapping[Level, str] = {
    "usable": "usable",
    "rough guide": "rough",
    "not determined": "poor",
}
"""Colours of the style sheet by verdict."""


def chips(result: Result) -> str:
    """HTML of the verdict on each map in a word or two, with its reason one click away.

    Nothing where the result has none.
    """
    if result.uncertainty is None:
        return ""
    return "".join(
        f'<details class="verdict {CLASSES[one.level]}" name="verdict"><summary><i></i>'
        f"<span>{escape(name)}:</span> <b>{escape(one.level)}</b></summary>"
        f"<div>{_reason(name, one)}</div></details>"
        for name, one in result.uncertainty.verdicts.items()
    )


def _reason(name: str, one: Verdict) -> str:
    expected = f'<data value="{float(one.expected_error)!r}">{escape(one.error_in_words)}</data>'
    cause = f"{one.cause[0].upper()}{one.cause[1:]}." if one.cause else ""
    remedy = f"{one.remedy[0].upper()}{one.remedy[1:]}." if one.remedy else ""
    texts = [paragraph(text) for text in (cause, remedy) if text]
    return (
        f"<p>Expected error of {escape(name)}: {expected}</p>{''.join(texts)}"
        f"{paragraph(how_to_read(), 'note')}"
    )


def how_to_read() -> str:
    """What the words and figures of verdicts mean."""
    rule = thresholds()
    return (
        "Expected error: the RMSE of a map, of values between 0 and 1, that noise, misfit, lights "
        f"and priors lead to. {rule[0].upper()}{rule[1:]}. No map is usable where left-out "
        "pictures are explained worse than by the nearest picture."
    )


def sentences(result: Result, pictures: Sequence[Picture]) -> list[str]:
    """How the fit ended, what it leaves of the pictures, what is to be doubted."""
    lines = (
        _without_verdicts(result),
        f"{_ended(result)} {_explained(result, pictures)}",
        _truth(result),
        normals.sentence(result),
        _scale(result),
        _doubts(result, pictures),
    )
    return [line for line in lines if line]


def _lacks(result: Result) -> str:
    """What pictures may hold that the model does not."""
    if result.lamps is None:
        return LACKS[result.transport.kind]
    return "shadows, light between surfaces" + ("" if result.lamps.near.any() else ", near lamps")


def _ended(result: Result) -> str:
    how = "converged" if result.status is Status.CONVERGED else "stopped"
    count = result.history.iterations
    why = "" if result.stop_reason == how else f" ({result.stop_reason})"
    steps = f"{count} iteration{'s' * (count != 1)}"
    return f"The fit {how} after {steps} and {result.seconds:.1f} s{why}."


def _explained(result: Result, pictures: Sequence[Picture]) -> str:
    share = median_share(pictures)
    if share is None:
        return (
            f"The residual of the pictures is {plain(result.metrics['recon_rmse'])} "
            "(RMSE, in the pictures' unit)."
        )
    text = f"The median residual is {percent(share)} relative to the picture's RMS"
    if len(pictures) > 1:
        [last] = worst(pictures, 1)
        assert last.fit is not None
        text += f", the largest {percent(last.fit.share)} (picture {last.name})"
    text += "."
    if share >= MODEL_FAILS:
        text += (
            f" If the pictures are not that noisy, the model lacks something: "
            f"{_lacks(result)}, or correct normals. Do not trust the maps where the "
            "residuals are large."
        )
    else:
        text += (
            " A small residual does not mean that the maps are right: other materials and lights "
            "may give the same pictures."
        )
    return text


def _truth(result: Result) -> str:
    if "albedo_rmse" not in result.metrics:
        return ""
    errors = ", ".join(f"{name} {plain(result.metrics[f'{name}_rmse'])}" for name in PARAMETERS)
    return f"Errors against ground truth: {errors} (RMSE of values between 0 and 1)."


def _without_verdicts(result: Result) -> str:
    if result.uncertainty is None:
        return "The uncertainty of the maps was not estimated, so none of them has a verdict."
    if result.uncertainty.noise is None:
        return "There are no more samples than unknowns, so nothing tells the noise."
    return ""


def _scale(result: Result) -> str:
    uncertainty = result.uncertainty
    if uncertainty is None or max(uncertainty.albedo_scale) <= SCALE_UNKNOWN:
        return ""
    return (
        "The pictures hardly determine the brightness of the lights, so all albedos may be wrong "
        f"by one common factor (standard deviation {percent(max(uncertainty.albedo_scale))})."
    )


def _doubts(result: Result, pictures: Sequence[Picture]) -> str:
    """Assumptions that may make the maps wrong without a trace in the residual."""
    doubts = list(filter(None, [(result.camera or Camera(result.fov, "assumed")).doubt()]))
    given = result.normals if result.given_normals is None else result.given_normals
    if (given[result.mask] == (0.0, 0.0, 1.0)).all():
        doubts.append(
            "all normals face the camera, so shading by shape ends up in material and light"
            if result.given_normals is None
            else "all given normals face the camera, and refined ones may still be far from the "
            "shape"
        )
    negative = float(np.median([one.light.negative for one in pictures]))
    if negative > NEGATIVE_LIGHT:
        doubts.append(
            f"in the median picture negative light is {percent(negative)} of the positive, "
            "which no lamp can be, so it explains something else, such as shadows"
        )
    return f"Warning: {'; '.join(doubts)}." if doubts else ""


Fact = tuple[str, str, float | None]
"""What it is, in words, and the number in full."""


def key_numbers(result: Result, pictures: Sequence[Picture]) -> list[Table]:
    """Two compact tables: the fit, and its errors."""
    height, width = result.mask.shape
    valid = int(np.count_nonzero(result.mask))
    across = f"{result.fov:.4g}° across" if result.fov else "orthographic"
    done: list[Fact] = [
        ("pictures", str(len(result.pictures)), len(result.pictures)),
        ("size", f"{width} × {height} pixels", None),
        ("pixels fitted", f"{valid:,} of {width * height:,}", valid),
        ("field of view", across, result.fov),
        ("reflection model", result.model, None),
        ("status", str(result.status), None),
        ("iterations", f"{result.history.iterations:,}", result.history.iterations),
        ("evaluations", f"{result.evaluations:,}", result.evaluations),
        ("run time", f"{result.seconds:.1f} s", result.seconds),
    ]
    if result.lamps is not None:
        done.insert(4, ("light", result.lamps.in_words(), len(result.lamps)))
    known = {METRICS[key]: result.metrics[key] for key in METRICS if key in result.metrics}
    if result.uncertainty is not None and result.uncertainty.noise is not None:
        known["noise of a sample (standard deviation)"] = result.uncertainty.noise
        for name, value in result.uncertainty.summary()["median_deviation"].items():
            known[f"{name}, median deviation"] = value
    well: list[Fact] = [(label, plain(value), value) for label, value in known.items()]
    share = median_share(pictures)
    if share is not None:
        well.insert(
            1, ("median residual", f"{percent(share)} relative to the picture's RMS", share)
        )
    return [
        Table((), [(Cell(label), number(text, value)) for label, text, value in facts])
        for facts in (done, well)
    ]
