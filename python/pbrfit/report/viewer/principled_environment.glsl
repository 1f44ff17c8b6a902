// The principled model under a panorama.
vec3 reflected_environment(Surface s) {
  Gathered light = gathered(s);
  Parts parts = partsOf(s, energyOf(clamp(s.facing, 1e-4, 1.0), s.roughness));
  float plastic = parts.dielectric * parts.kappa;
  return panoramaUnit * (PI * parts.body * light.matt
      + (0.04 * plastic + parts.metal * s.albedo) * light.base
      + (plastic + parts.metal) * light.grazing);
}
