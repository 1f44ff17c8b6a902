// The paper's model under a panorama.
vec3 reflected_environment(Surface s) {
  Gathered light = gathered(s);
  float t = 1.0 - clamp(s.facing, 1e-4, 1.0);
  // Of Schlick's (1−v·h)^5 the mean over light from everywhere.
  float grazing = 8.233e-5
      + t * (2.0221e-3 + t * (9.30996e-3 + t * (7.79715e-3 + t * 8.95196e-3)));
  vec3 f0 = mix(vec3(0.04), s.albedo, s.metallic);
  vec3 body = (1.0 - f0) * (1.0 - grazing) * (1.0 - s.metallic) * s.albedo;
  return panoramaUnit * (body * light.matt + f0 * light.base + light.grazing);
}
