"""`pbrfit evaluate normals`: disturbances are what they say, verdicts can fail, files are written.

How well normals are refined is not tested here: fits are replaced by ones that turn normals part of
the way to the true ones, so that what the suite has to find is known.
"""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluation_tasks import recorded
from pbrfit.model.geometry import angles_between
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit_evaluation import normals
from pbrfit_evaluation.estimator_errors import LOWEST_COSINE
from pbrfit_evaluation.generated.measure import WAYS
from pbrfit_evaluation.grid import Case
from pbrfit_evaluation.normals import figures, measure
from pbrfit_evaluation.normals.measure import DISTURBANCES, MEAN_OF_THETA, disturbed
from pbrfit_evaluation.scores import MAPS


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene("furnished", size=48, lights=3, held_out=1, seed=2003)


@pytest.mark.parametrize(
    ("kind", "degrees", "within"),
    [("correlated", 2.0, 0.1), ("correlated", 10.0, 0.1), ("estimator", 5.0, 0.01)],
)
def test_turns_have_the_mean_angle_of_two_components(
    scene: Scene, kind: Any, degrees: float, within: float
) -> None:
    off = angles_between(disturbed(scene, kind, degrees, 5), scene.normals)[scene.valid]
    assert off.mean() == pytest.approx(MEAN_OF_THETA * degrees, rel=within)
    assert np.median(off) < off.mean()  # a few are large


@pytest.mark.parametrize("kind", DISTURBANCES)
def test_disturbed_normals_are_unit_face_the_camera_and_keep_the_mask(kind: Any) -> None:
    whole = make_scene("spheres", size=24, lights=3, held_out=1, seed=2001)
    mask = np.zeros((24, 24), bool)
    mask[3:20, 4:23] = True
    masked = replace(whole, mask=mask, segments=None)
    found = disturbed(masked, kind, 25.0, 1)
    np.testing.assert_array_equal(np.isfinite(found).all(axis=-1), masked.valid)
    inside = found[masked.valid]
    np.testing.assert_allclose(np.linalg.norm(inside, axis=-1), 1, rtol=1e-12)
    assert np.einsum("pi,pi->p", inside, masked.views[masked.valid]).min() >= 0.9 * LOWEST_COSINE
    np.testing.assert_array_equal(found, disturbed(masked, kind, 25.0, 1))
    assert np.nanmax(np.abs(found - disturbed(masked, kind, 25.0, 2))) > 0.1
    np.testing.assert_array_equal(disturbed(masked, kind, 0.0, 1), masked.normals)


Pairs = list[tuple[Case, dict[str, Any]]]


def room_of(condition: str, seed: int, off: float, auto: float, angle: float = 0.0) -> Pairs:
    """Fits of a scene whose errors are all `off` without refinement and `auto` with it."""
    given = MEAN_OF_THETA * measure.turn_of(condition)[1]
    pairs = []
    for way, error, mean in (("off", off, given), ("auto", auto, angle), ("on", auto, angle)):
        values = {
            "scores": dict.fromkeys(figures.METRICS, error) | {"seconds": 1.0},
            "angle": {"mean": mean, "median": mean},
            "given": {"mean": given},
            "decision": {"refined": way != "off"},
        }
        pairs.append((Case(condition, way, seed, 16), values))
    return pairs


ASKED = {"disturbances": DISTURBANCES, "degrees": (5.0, 10.0, 20.0), "part": measure.PARTS}


def test_demands_hold_up_to_their_bounds() -> None:
    """Right normals, and each size of wrong ones, on both sides of what is demanded."""

    def missed(*pairs: Any) -> list[str]:
        results = recorded(*pairs, **ASKED)
        verdicts = figures.verdicts(results, figures.rows(results))
        return [one.what for one in verdicts if not one.holds]

    true = room_of("true", 1, 0.1, 0.1)
    for theta, auto, angle, failing in (
        (5.0, 0.119, 1.5, 0),
        (5.0, 0.131, 1.5, 3),  # 84.5 %: metallic alone holds
        (10.0, 0.181, 3.2, 5),  # 59.5 %, angle 0.255
        (20.0, 0.199, 12.4, 0),
        (20.0, 0.201, 12.6, 5),
    ):
        found = missed(*true, *room_of(f"correlated-{theta:g}", 1, 0.3, auto, angle))
        assert len(found) == failing, (theta, auto)
        assert any("metallic loss" in what for what in found) == (failing == 5)
    assert missed(*room_of("true", 1, 0.1, 0.103, 0.29)) == []
    assert len(missed(*room_of("true", 1, 0.1, 0.1031, 0.31))) == len(figures.METRICS) + 1
    values = {"scores": dict.fromkeys(MAPS, 0.1), "angle": {"mean": 0.1}}
    for back, fails in (((True, True, True, False, False), 0), ((True, True, False, False), 1)):
        cases = [Case("exact-correlated", "on", seed, 16) for seed in range(len(back))]
        pairs = [(of, values | {"came_back": one}) for of, one in zip(cases, back, strict=True)]
        assert len(missed(*pairs)) == fails


def test_every_suite_says_whether_normals_are_refined() -> None:
    """The default may change, and with it figures that are compared with older ones."""
    folder = Path(normals.__file__).parents[1]
    calls = [
        (path.relative_to(folder), node)
        for path in folder.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "decompose"
    ]
    assert calls
    assert all(
        "refine_normals" in way.options for way in WAYS.values() if way.options
    )  # passed on by **
    for path, call in calls:
        assert {"refine_normals", None} & {keyword.arg for keyword in call.keywords}, path
