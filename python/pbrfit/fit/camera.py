"""Whether the camera is as it is said to be: tone curve, vignetting, field of view.

Score tests (`nuisances`) say of which numbers another value promises something. Those are fitted
with the coarse level, and what that leaves is compared by the same score as normals.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import misfit, scale, settings
from pbrfit.fit.coarse import Lights, Watch, fit_level, rounds
from pbrfit.fit.levels import Level
from pbrfit.fit.noise import NoiseModel
from pbrfit.fit.nuisances import FIELD_OF_VIEW, RESPONSE, VIGNETTING, Nuisance, Nuisances
from pbrfit.fit.run import Run

Array = NDArray[np.float64]


def doubt_camera(run: Run, x: Array, lights: Lights) -> tuple[Lights, Lights | None]:
    """Lights, with a correction of the pictures if they ask for it; and with another field of view.

    `lights` are those that were found from x. The numbers whose score test promises most are fitted
    first, and kept where the score is lower and only noise is left; of a field of view it is enough
    if most of the misfit is gone, and not if the given one leaves only noise. Wrong normals and bad
    pictures ask for another camera too, but it does not help them much. A correction is `run`'s
    from then on. A given field of view stays: `run.camera` tells of the other one, and what that
    leaves is returned beside.
    """
    untried = {"fov": (FIELD_OF_VIEW,), "response": RESPONSE, "vignetting": VIGNETTING}
    if run.camera.how != "given":
        del untried["fov"]
    if run.options.solver != "gauss-newton" or run.options.response in ("srgb", "linear"):
        del untried["response"]
    told = run.camera.figures or lights.shared is None or run.camera.how == "assumed"
    if told or lights.exact or lights.cut_short or not lights.can_be_judged:
        return lights, None
    level = Level.of(run.objective, settings.COARSE_PIXELS)
    if len(level.patches()) < settings.CAMERA_PATCHES_MIN:
        return lights, None
    least = dict.fromkeys(untried, settings.CAMERA_GAIN_MIN)
    least["response"] = 0.0 if run.options.response == "fit" else settings.CAMERA_GAIN_MIN
    figures: dict[str, float] = {}
    with run.stage("camera") as notes:
        other = None
        tests = _score_tests(run, lights, untried)
        figures |= {f"score_test_{name}": gain for name, gain in tests.items()}
        while untried:
            name = max(untried, key=lambda name: tests[name] / max(least[name], 1e-300))
            numbers = untried.pop(name)
            if tests[name] < least[name] or run.out_of_time():
                break
            notes.append(f"score test of {name} {tests[name]:.3g}")
            if name == "fov":  # from the start, because materials have bent to the given one
                found, nuisances = _with_camera(run, x, numbers, None)
            else:
                found, nuisances = _with_camera(run, lights.x, numbers, lights.noise)
            kept = _keeps(lights, found, name, nuisances.surprise(), figures)
            if name == "fov":
                figures["other_fov_degrees"] = nuisances.scene.fov
                figures["other_fov_sigma"] = nuisances.fov_sigma
            notes.append(f"{found.misfit.in_words()}{'' if kept else ', not kept'}")
            if kept and name == "fov":
                other = found
                few, end = level.objective, level.objective.layout.maps.stop
                before = run.objective.part_of(lights.x, level.pixels)
                run.scale_by_other = scale.change(found.x[end:], before[end:], few)
                changes = (found.x[:end] - before[:end]).reshape(-1, few.pixels)[few.channels :]
                run.materials_by_other = np.sqrt(np.square(changes).mean(axis=1))
                break
            if kept:
                run.see(nuisances)
                lights = replace(found, x=x.copy())
                run.objective.put_part(lights.x, nuisances.pixels, found.x)
                tests = _score_tests(run, lights, untried)
        run.camera = replace(run.camera, figures=figures, contradicted=other is not None)
        if not notes:
            notes.append("as given, by the score tests")
    return lights, other


def _score_tests(
    run: Run, lights: Lights, groups: Mapping[str, Sequence[Nuisance]]
) -> dict[str, float]:
    """What each group of numbers promises under some lights, χ²."""
    assert lights.shared is not None
    level = Level.of(run.objective, settings.COARSE_PIXELS)
    few, part = level.objective, run.objective.part_of(lights.x, level.pixels)
    if lights.noise is not None:
        few = few.weighed(lights.noise.weights(few, part))
    # A copy: where nothing is changed, what follows has to be the same to the last bit.
    fit = copy(lights.shared).joint_fit(few, part, fit_level(few, part))
    nuisances = Nuisances(run.scene, [one for group in groups.values() for one in group])
    if groups:
        nuisances.estimate(few, part, fit, lights.misfit)
    return {name: nuisances.test(group) for name, group in groups.items()}


def _with_camera(
    run: Run, x: Array, numbers: Sequence[Nuisance], noise: NoiseModel | None
) -> tuple[Lights, Nuisances]:
    """What the level leaves with other numbers of the camera, from x; its x is of the level."""
    level = Level.of(run.objective, settings.COARSE_PIXELS)
    part = run.objective.part_of(x, level.pixels)
    fitted = [] if run.camera.how == "given" else [FIELD_OF_VIEW]
    if run.scene.correction is not None:  # another was fitted before
        fitted += [*RESPONSE, *VIGNETTING]
    fitted += [one for one in numbers if one not in fitted]
    nuisances = Nuisances(run.scene, fitted)
    nuisances.pixels = level.pixels
    watch = Watch(run, x, level)
    found = rounds(run, level, part, watch, nuisances=nuisances, noise=noise)
    return replace(found, x=part, unknowns=found.unknowns + len(numbers)), nuisances


def _keeps(
    before: Lights, found: Lights, name: str, surprise: float, figures: dict[str, float]
) -> bool:
    """Whether other numbers, as unlikely as they are by their prior, are better ones."""
    samples = found.samples * found.misfit.effective_share
    in_common = 0.0
    if name == "fov" and not samples > found.unknowns + 1:
        # What little is left is shared by all. Unknowns that both have cancel.
        in_common = before.unknowns
    scores = [
        misfit.score(one.deviance, one.unknowns - in_common, samples) for one in (before, found)
    ]
    scores[1] += surprise
    figures["score_given"], figures[f"score_other_{name}"] = scores
    share = math.exp(found.deviance - before.deviance)
    share *= max(found.misfit.design_effect, 1.0) / max(before.misfit.design_effect, 1.0)
    told = found.is_noise
    if name == "fov":  # a given one that leaves noise alone is contradicted by none
        told = (told and not before.is_noise) or share <= settings.CAMERA_MISFIT_SHARE_MAX
    return scores[1] < scores[0] and told
