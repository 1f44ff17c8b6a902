"""Posteriors under misfit: whether deviations, intervals and verdicts are right."""
