// The paper's model under a lamp: docs/model.md#hard-light.
float masking(float cosine, float k) {
  return cosine / (cosine * (1.0 - k) + k);
}

vec3 reflected_lamp(Surface s, vec3 light, float extent) {
  float cosine = mean_cosine(dot(s.normal, light), extent);
  if (cosine <= 0.0) return vec3(0.0);
  vec3 bisector = normalize(s.view + light);
  float grazing = fifth(1.0 - clamp(dot(s.view, bisector), 0.0, 1.0));
  float alpha = s.roughness * s.roughness, k = 0.5 * alpha * alpha;
  float facing = max(s.facing, 1e-4);
  float lobe = distribution(s.normal, bisector, widened(alpha, extent)) * masking(facing, k) * masking(cosine, k)
      / (4.0 * facing);
  vec3 f0 = mix(vec3(0.04), s.albedo, s.metallic);
  vec3 fresnel = f0 + (1.0 - f0) * grazing;
  return (1.0 - fresnel) * (1.0 - s.metallic) * cosine * s.albedo + fresnel * lobe;
}

vec3 reflected_lamps(Surface s) {
  vec3 sum = vec3(0.0);
  for (int i = 0; i < lampCount; i++) {
    sum += lampColors[i] * reflected_lamp(s, lampDirections[i], lampExtents[i]);
  }
  return sum;
}
