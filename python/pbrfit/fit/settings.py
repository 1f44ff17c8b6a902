"""Every number that a fit decides by: its quantity, its unit, and what happens on either side.

Sums of squared residuals are in units of x: pictures are divided so that their mean radiance is
0.4 (`Normalization`). A share is a number in [0, 1] without unit. Numbers that belong to a formula
stand beside it.
"""

from __future__ import annotations

# --- Start and normalization ------------------------------------------------------------------


# --- Misfit: whether residuals are noise ------------------------------------------------------


# --- Gauss-Newton: lights from a subset of the pixels -----------------------------------------


# --- Gauss-Newton: all pixels -----------------------------------------------------------------


# --- L-BFGS, and the choice between solvers ---------------------------------------------------


# --- Mixture prior on materials ---------------------------------------------------------------


# --- Normals ----------------------------------------------------------------------------------


# --- Tiles ------------------------------------------------------------------------------------


# --- Uncertainty ------------------------------------------------------------------------------
