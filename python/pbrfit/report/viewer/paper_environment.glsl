// The paper's model under a panorama.
vec3 reflected_environment(Surface s) {
  Gathered light = gathered(s);
  float grazing = 1.0 - clamp(s.facing, 1e-4, 1.0), square = grazing * grazing;
  vec3 f0 = mix(vec3(0.04), s.albedo, s.metallic);
  vec3 fresnel = f0 + (1.0 - f0) * square * square * grazing;
  vec3 body = (1.0 - fresnel) * (1.0 - s.metallic) * s.albedo;
  return panoramaUnit * (body * light.matt + f0 * light.base + light.grazing);
}
