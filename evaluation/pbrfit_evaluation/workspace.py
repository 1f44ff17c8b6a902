"""`prepare` and `publish` under an earlier name, for suites that still use it."""

from pbrfit_evaluation.jobs import prepare, publish

__all__ = ["prepare", "publish"]
