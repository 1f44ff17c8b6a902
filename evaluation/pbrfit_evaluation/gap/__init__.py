"""The gap between reflection models and the integral of the BRDF that renderers use, and Cycles.

Models are compared with brute-force integration (`principled.py`), so what is measured is the model
alone: no fit, no pictures, no noise. `brute_force.py` has the paper's own BRDF, which tells what of
the gap is its closed form. Renders of spheres agree with the principled integral (docs/cycles.md).
"""
