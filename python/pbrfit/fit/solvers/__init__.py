"""From a start to a fit: the strategies, a running fit with its clock, L-BFGS-B."""
