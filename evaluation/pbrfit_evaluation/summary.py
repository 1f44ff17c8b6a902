"""`pbrfit_evaluation.report.summary` under an earlier name, for suites that still use it."""

from pbrfit_evaluation.jobs import SUMMARY as FILE
from pbrfit_evaluation.report.summary import machine, write_summary
from pbrfit_evaluation.suite import Row

__all__ = ["FILE", "Row", "machine", "write_summary"]
