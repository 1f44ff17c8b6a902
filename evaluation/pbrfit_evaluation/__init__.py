"""Suites that measure this package and write a report: `pbrfit evaluate SUITE`."""
