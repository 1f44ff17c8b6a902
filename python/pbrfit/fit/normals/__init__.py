"""Normals refined together with materials and lights.

Normals of an estimator are ten degrees off and more, and every wrong normal bends its material and
the lights. Pictures under several lights know better: a pixel has a number a picture and channel,
and with its normal seven unknowns. A normal is unknown as its tangent offset (a, b): it is along
n₀ + a t₁ + b t₂, with tangents t at the given normal n₀ (docs/model.md).

1. The coarse level (`pbrfit.fit.coarse.rounds`) finds lights and normals from the given ones,
   with the priors of `free` and `offset_prior`.
2. `all_pixels`: all pixels change their normals in these lights.
3. A fit with these normals and lights held (`pbrfit.fit.estimator`) finds materials with all
   priors.
4. All pixels change their normals again, near the materials of that fit, and 3. once more.

`refined_fit` decides whether this is worth while, and what of it is kept.
"""
