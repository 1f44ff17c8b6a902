// The principled model under a lamp: docs/model.md#hard-light. What depends on the view alone is
// computed once for all lamps.

// Fresnel's equations for glass of index 1.5.
float glass(float c) {
  float g = sqrt(1.25 + c * c);
  float across = (g - c) / (g + c), along = (c * (g + c) - 1.0) / (c * (g - c) + 1.0);
  return 0.5 * across * across * (1.0 + along * along);
}

float slanted(float x, float alpha) {
  return sqrt(x * x + alpha * alpha * max((1.0 - x) * (1.0 + x), 0.0));
}

vec3 reflected_lamps(Surface s) {
  float facing = clamp(s.facing, 1e-4, 1.0), alpha = s.roughness * s.roughness;
  Parts parts = partsOf(s, energyOf(facing, s.roughness));
  float ofView = slanted(facing, alpha);
  vec3 sum = vec3(0.0);
  for (int i = 0; i < lampCount; i++) {
    vec3 light = lampDirections[i];
    float cosine = mean_cosine(dot(s.normal, light), lampExtents[i]);
    if (cosine <= 0.0) continue;
    vec3 bisector = normalize(s.view + light);
    float seen = clamp(dot(s.view, bisector), 0.0, 1.0);
    float lobe = distribution(s.normal, bisector, widened(alpha, lampExtents[i])) * 0.5 * cosine
        / (cosine * ofView + facing * slanted(cosine, alpha));
    vec3 metal = parts.metal * (s.albedo + (1.0 - s.albedo) * fifth(1.0 - seen));
    sum += lampColors[i] * (PI * cosine * parts.body + lobe * (parts.dielectric * glass(seen) + metal));
  }
  return sum;
}
