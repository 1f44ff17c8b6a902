"""The solvers suite: its measures, its verdicts and its command."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest

from evaluation_tasks import recorded
from pbrfit_evaluation.grid import Case
from pbrfit_evaluation.grid.figures import Of
from pbrfit_evaluation.solvers import figures, measure
from pbrfit_evaluation.suite import Verdict


def test_exact_is_exact_in_every_map() -> None:
    assert measure.is_exact(3e-8, 1e-6)
    assert not measure.is_exact(3e-8, 1e-6, "exact-float64")
    for bad in (1.1e-6, math.nan):
        assert not measure.is_exact(3e-8, bad)
        assert not measure.is_exact(bad, 0.0)


def results(*of: tuple[str, str, int, Mapping[str, float]]) -> Of:
    pairs = [(Case(at, way, seed, 8), {"scores": scores}) for at, way, seed, scores in of]
    return recorded(*pairs, conditions=dict.fromkeys(at for at, *_ in of), ways=measure.WAYS)


def judged(of: Of) -> list[Verdict]:
    return list(figures.verdicts(of, figures.rows(of)))


def test_the_mark_is_the_lower_of_lbfgsb_and_gauss_newton_from_the_truth() -> None:
    at = "noise-0.01"
    recon = [("truth", 1, 0.1), ("truth", 2, 0.3), ("lbfgsb", 1, 0.2), ("lbfgsb", 2, 0.2)]
    recon += [("gauss-newton", 1, 0.2), ("gauss-newton", 2, 0.1), ("gauss-newton", 3, 9.0)]
    of = results(*((at, way, seed, {"recon": error}) for way, seed, error in recon))
    assert figures.above_mark(of, at, "gauss-newton") == pytest.approx({1: 3.0, 2: -0.75})


def test_exact_rooms_are_counted_and_gauss_newton_ends_no_higher_than_lbfgsb() -> None:
    def rooms(good: int, second: float = 1e-9) -> list[Verdict]:
        one = {"residual": 1e-9, "worst_map": 0.0, "seconds": 1.0}
        return judged(
            results(
                *(("exact", "lbfgsb", 1000 + i, one) for i in range(67)),
                *(
                    (at, "gauss-newton", 1000 + i, one | {"exact": i < good} | more)
                    for at in measure.RESIDUAL
                    for i in range(67)
                    for more in [{"residual": second} if i == 1 else {}]
                ),
            )
        )

    of64 = rooms(64)
    assert len(of64) == 3
    assert all(v.holds for v in of64)
    assert all((v.value, v.bar) == (64, 64) for v in of64[:2])
    assert of64[0].where == "not: 1064, 1065, 1066"
    assert not any(v.holds for v in rooms(63)[:2])
    above = rooms(67, second=2e-9)[2]
    assert above.value == pytest.approx(2.0)
    assert (above.holds, above.where) == (False, "seed 1001; above in 1 of 67")


def test_noise_is_held_against_the_mark_and_lbfgsbs_maps() -> None:
    errors = {"truth": 1, "gauss-newton": 0.103, "lbfgsb": 0.1, "gauss-newton-priors": 0.05}
    errors |= {"lbfgsb-priors": 0.05}
    recon = {way: 1.0 if way == "lbfgsb" else 2.0 for way in errors} | {"gauss-newton": 1.00025}
    found = judged(
        results(
            *(
                (
                    "noise-0.01",
                    way,
                    1000,
                    dict.fromkeys(figures.ERRORS, error) | {"recon": recon[way]},
                )
                for way, error in errors.items()
            )
        )
    )
    assert [v.holds for v in found] == [True, False, True]
    assert [v.value for v in found] == pytest.approx([5e-4, 1.03, 1.0], rel=1e-3)
    assert found[1].what == "noise 0.01, no priors: worst mean error, gauss-newton over lbfgsb"
