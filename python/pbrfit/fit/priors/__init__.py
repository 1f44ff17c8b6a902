"""Priors on materials and lights, and the steps that minimise data and priors together."""
