"""The solvers suite: its measures, its verdicts and its command."""

from __future__ import annotations

import json
import math
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from pbrfit.cli import main
from pbrfit_evaluation.jobs import Record
from pbrfit_evaluation.solvers import SUITE, figures, measure
from pbrfit_evaluation.solvers.measure import Case
from pbrfit_evaluation.suite import Results, Verdict


def test_exact_is_exact_in_every_map() -> None:
    assert measure.is_exact(3e-8, [1e-6, 1e-6, 0.0])
    assert not measure.is_exact(3e-8, [1e-6, 1e-6, 0.0], measure.RECON_FLOAT64)
    for bad in (1.1e-6, math.nan):
        assert not measure.is_exact(3e-8, [0.0, bad])
        assert not measure.is_exact(bad, [0.0])


@pytest.mark.slow
def test_the_mark_is_the_lower_of_lbfgsb_and_gauss_newton_from_the_truth() -> None:
    found = measure.run_noise(Case("noise", 1000, 12, 15, noise=0.01), 1)
    assert list(found) == list(measure.NOISE_FITS)
    mark = min(found[name]["recon"] for name in (measure.FROM_TRUTH, "lbfgsb"))
    for scores in found.values():
        assert scores["above_mark"] == pytest.approx((scores["recon"] / mark) ** 2 - 1)
        assert scores["relight"] > 0
    assert found[measure.FROM_TRUTH]["recon"] < 0.01  # what the unknowns take up


def recorded(task: Any, values: Any) -> tuple[Any, Record]:
    return task, Record(task.key, values, None, 1.0)


def judged(part: str, pairs: Sequence[tuple[Any, Record]]) -> list[Verdict]:
    [of] = [one for one in SUITE.parts if one.name == part]
    results = Results(Namespace(), pairs)
    return list(of.verdicts(results, of.figures(results)))


def test_exact_rooms_are_counted_and_gauss_newton_ends_no_higher_than_lbfgsb() -> None:
    def rooms(good: int, second: float = 1e-9) -> list[Verdict]:
        pairs = []
        for i in range(67):
            run = {"exact": i < good, "recon": 1e-9, "worst_map": 0.0, "seconds": 1.0}
            runs = dict.fromkeys(measure.EXACT_FITS, run)
            runs["gauss-newton"] = run | {"recon": second if i == 1 else 1e-9}
            pairs.append(recorded(Case("exact", 1000 + i, 128, 500), runs))
        return judged("exact", pairs)

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
    def run(above: float, error: float) -> dict[str, float]:
        return {"above_mark": above, **dict.fromkeys(figures.NOISE_METRICS, error)}

    values = {
        "gauss-newton": run(5e-4, 0.103),
        "lbfgsb": run(0.1, 0.1),
        "gauss-newton, priors": run(0.5, 0.05),
        "lbfgsb, priors": run(0.5, 0.05),
    }
    found = judged("noise", [recorded(Case("noise", 1000, 8, 9, noise=0.01), values)])
    assert [v.holds for v in found] == [True, False, True]
    assert [v.value for v in found] == pytest.approx([5e-4, 1.03, 1.0])
    assert found[1].what == "gauss-newton over lbfgsb, noise 0.01, no priors: worst mean error"


@pytest.mark.parametrize("part", SUITE.parts, ids=lambda part: part.name)
def test_nothing_is_held_where_nothing_was_finished(part: Any) -> None:
    case = Case(part.name, 1000, 8, 9)
    results = Results(Namespace(), [(case, Record(case.key, None, "OSError: full", 1.0))])
    assert not list(part.verdicts(results, part.figures(results)))


def test_the_command_runs_parts(tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = ["evaluate", "solvers", "--quick", "--quiet", "--scenes", "1", "--size", "12"]
    options += ["--iterations", "3", "--out", str(out), "--part", "exact", "--jobs", "1"]
    assert main(options) == 1  # nothing holds after three iterations
    rows = json.loads((out / "summary.json").read_text("utf-8"))["rows"]
    by_name = {row["name"]: row for row in rows}
    assert by_name["exact: gauss-newton's residual over lbfgsb's"]["metrics"]["bar"] == 1
    assert by_name["rooms without noise"]["metrics"]["recon"] > 0
    assert "exact,exact_1000,gauss-newton/recon," in (out / "scenes.csv").read_text("utf-8")
