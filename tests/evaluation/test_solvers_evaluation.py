"""The solvers suite: its measures, its verdicts and its command."""

from __future__ import annotations

from collections.abc import Mapping

from evaluation_tasks import recorded
from pbrfit_evaluation.grid import Case
from pbrfit_evaluation.grid.figures import Of
from pbrfit_evaluation.solvers import figures, measure


def results(*of: tuple[str, str, int, Mapping[str, float]]) -> Of:
    pairs = [(Case(at, way, seed, 8), {"scores": scores}) for at, way, seed, scores in of]
    return recorded(*pairs, conditions=dict.fromkeys(at for at, *_ in of), ways=measure.WAYS)


def test_exact_rooms_are_counted_and_noise_is_held_against_the_mark() -> None:
    def missed(good: int, recon: float, error: float) -> list[str]:
        one = {"residual": 1e-9, "worst_map": 0.0, "seconds": 1.0}
        rooms = [
            (at, way, 1000 + i, one | {"exact": i < good})
            for at, way in (("exact", "lbfgsb"), *((at, "gauss-newton") for at in measure.RESIDUAL))
            for i in range(67)
        ]
        errors = {"truth": 1.0, "gauss-newton": error, "lbfgsb": 0.1}
        residuals = {"truth": 2.0, "gauss-newton": recon, "lbfgsb": 1.0}
        noisy = [
            ("noise-0.01", way, 1, dict.fromkeys(figures.ERRORS, of) | {"recon": residuals[way]})
            for way, of in errors.items()
        ]
        found = results(*rooms, *noisy)
        verdicts = figures.verdicts(found, figures.rows(found))
        return [f"{one.what} ({one.where})" for one in verdicts if not one.holds]

    assert missed(64, 1.0004, 0.1019) == []
    found = missed(63, 1.0006, 0.1021)
    assert len(found) == 4
    assert found[0].endswith("that are exact (not: 1063, 1064, 1065, 1066)")
    assert found[2].startswith("noise 0.01: gauss-newton's objective over the mark, less 1 (seed 1")
    assert "no priors: worst mean error, gauss-newton over lbfgsb" in found[3]
