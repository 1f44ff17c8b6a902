"""Words about a fit: why a map is no better, and what would help; what was left out.

Of what may be wrong the first that holds is named, from what leaves least hope to what is mere
noise. None of this changes a deviation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pbrfit.fit.discrepancy import Discrepancy
from pbrfit.fit.independent_lights import Shown
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.priors.penalties import idle_priors
from pbrfit.result.light_sides import main_directions, one_side
from pbrfit.result.options import Priors
from pbrfit.result.uncertainty import Uncertainty
from pbrfit.result.verdict import Verdict, doubted
from pbrfit.scene.arrays import CHANNELS
from pbrfit.scene.scene import Scene
from pbrfit.transport.decision import Transport
from pbrfit.values.arrays import Array, Floats

FEW_PICTURES = 6
"""Pictures below which few are named: 3 samples each for 5 unknowns of a pixel, beside lights."""


def with_causes(
    uncertainty: Uncertainty,
    scene: Scene,
    *,
    normals: Floats,
    discrepancy: Discrepancy | None,
    shown: Shown | None,
    transport: Transport,
    lighting: Array | None,
    albedo: Floats,
) -> dict[str, Verdict]:
    """Verdicts with cause and remedy, where maps are not usable.

    `normals` (H, W, 3) are those of the result, `lighting` is (N, 16, 3), None under lamps,
    `albedo` (H, W, 3) the map that was found.
    """
    cause, remedy = next(_causes(scene, normals, discrepancy, transport, lighting))
    found = {
        name: verdict
        if verdict.level == "usable"
        else replace(verdict, cause=cause, remedy=f"{remedy} would help")
        for name, verdict in uncertainty.verdicts.items()
    }
    of_albedo, scale = found["albedo"], np.mean(uncertainty.albedo_scale)
    by_scale = np.nanmean(np.square(albedo)) * scale**2
    if of_albedo.level != "usable" and by_scale > 0.5 * of_albedo.expected_error**2:
        cause = f"the brightness of albedo is uncertain by {100 * scale:.0f} %"
        remedy = "a patch of known albedo (option white) would help"
        found["albedo"] = replace(of_albedo, cause=cause, remedy=remedy)
    if shown is None:
        return found
    if shown.is_little:
        lights, count = max(shown.lights), len(scene.images)
        cause = f"only {lights} independent light{'s' * (lights != 1)} in {count} pictures"
        found = doubted(found, cause, "pictures under other lights would help")
    dark = [name for name, lights in zip(CHANNELS, shown.lights, strict=False) if not lights]
    if dark and shown.numbers:
        cause, remedy = f"no {' and no '.join(dark)} light", "pictures under white light would help"
        found["albedo"] = replace(
            found["albedo"], level="not determined", cause=cause, remedy=remedy
        )
    return found


def _causes(
    scene: Scene,
    normals: Floats,
    discrepancy: Discrepancy | None,
    transport: Transport,
    lighting: Array | None,
) -> Iterator[tuple[str, str]]:
    """What is wrong, and what would help, from the worst on; the last always holds."""
    count = len(scene.images)
    if (normals[scene.valid] == (0.0, 0.0, 1.0)).all():
        yield "all normals face the camera", "normals (pbrfit normals)"
    sides = None if lighting is None or count < 2 else one_side(main_directions(lighting))
    if sides is not None:
        yield f"light from one side, {sides[0]}, in all pictures", f"pictures lit from {sides[1]}"
    if count < FEW_PICTURES:
        yield f"only {count} picture{'s' * (count > 1)}", "pictures under other lights"
    clipped = 0.0 if scene.limits is None else np.mean(scene.limits[:, scene.valid] > 0)
    if clipped > 0.05:  # highlights, which tell roughness and metallic, are a few percent
        yield f"{100 * clipped:.0f} % of the samples are clipped", "shorter exposures or RAW files"
    if discrepancy is not None and discrepancy.misfit**2 > discrepancy.of_noise:
        depth = lighting is not None and not transport.blocks
        lacks = "a depth map or better normals" if depth else "better normals"
        yield "the model does not explain what is in the pictures", lacks
    yield "noise hides the highlights", "more pictures, or longer exposures,"


def left_out_words(
    scene: Scene, layout: ParameterLayout, priors: Priors, lighting: Array | None = None
) -> Iterator[str]:
    """What the scene did not need, in words; `lighting` as above."""
    masked = 0 if scene.mask is None else int(np.count_nonzero(~scene.mask))
    if masked:
        yield f"{masked} pixels outside the mask"
    without = scene.valid.size - masked - layout.pixels
    if without:
        yield f"{without} pixels without a usable sample"
    if scene.limits is not None:
        counted = ... if scene.all_valid else scene.valid
        exposed = sum(np.count_nonzero(of[counted]) for of in scene.limits)
        yield f"{exposed:,} over- or underexposed values"
    if scene.weights is not None:
        single = int(np.count_nonzero(scene.weights[:, scene.valid] == 0))
        if single:
            yield f"{single} values of weight 0 at other pixels"
    if layout.channels == 1:
        yield "second and third colour channel: equal to the first"
    if layout.sh_order < 3 and scene.lighting is not None:
        yield "band 3 of the lights: the known lights have none"
    if layout.lighting is None:
        yield "lights and their gradient: known, so only materials were fitted"
    for name, why in idle_priors(layout, priors, lighting).items():
        yield f"prior {name}: {why}"
