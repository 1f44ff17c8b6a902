"""Numerical stability of the core: measurements against exact or float64 references."""
