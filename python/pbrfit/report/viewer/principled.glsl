// The principled model, what all kinds of light need: docs/model.md.
uniform sampler2D lobes;  // six texels a node of (n·v, r)
uniform vec3 axes[2];     // by n·v and r: cells, and c and w of w(1+c) x/(x+c) + (1−w) x

// The cell that x is in, and where in it.
int place(vec3 axis, float x, out float part) {
  float along = axis.x * (axis.z * (1.0 + axis.y) / (x + axis.y) + 1.0 - axis.z) * x;
  int cell = min(int(along), int(axis.x) - 1);
  part = along - float(cell);
  return cell;
}

// One texel of the four nodes around, interpolated.
vec4 between(ivec2 node, int texel, vec2 part) {
  ivec2 at = ivec2(6 * node.x + texel, node.y);
  return mix(
      mix(texelFetch(lobes, at, 0), texelFetch(lobes, at + ivec2(6, 0), 0), part.x),
      mix(texelFetch(lobes, at + ivec2(0, 1), 0), texelFetch(lobes, at + ivec2(6, 1), 0), part.x),
      part.y);
}

// What a lobe reflects of light from everywhere: of F0 and of the rest; Ē and κ.
struct Energy { float base, grazing, mean, kappa; };

Energy energy(vec4 a03, vec4 a89_b01, vec4 rest) {
  return Energy(3.54490770181103 * a03.x, 3.54490770181103 * a89_b01.z, rest.x, rest.y);  // 2 √π
}

Energy energyOf(float cosine, float roughness) {
  vec2 part;
  ivec2 node = ivec2(place(axes[0], cosine, part.x), place(axes[1], roughness, part.y));
  return energy(between(node, 0, part), between(node, 2, part), between(node, 5, part));
}

// Light that meets the microfacets of a lobe once more than the lobe knows of, as a factor.
vec3 multiplied(vec3 f0, Energy e) {
  float reflected = e.base + e.grazing;
  vec3 average = f0 + (1.0 - f0) / 21.0;
  return 1.0 + average * e.mean / (1.0 - average * (1.0 - e.mean)) * (1.0 - reflected) / reflected;
}

// Factors of the matt part (kd), of a dielectric's lobe and of a metal's. κ makes up for Schlick's F of
// a dielectric, and belongs to its lobe where that has it: not under lamps.
struct Parts { vec3 body; float dielectric, kappa; vec3 metal; };

Parts partsOf(Surface s, Energy e) {
  float again = multiplied(vec3(0.04), e).x, rest = 1.0 - s.metallic;
  return Parts(rest * (1.0 - e.kappa * again * (0.04 * e.base + e.grazing)) / PI * s.albedo,
      rest * again, e.kappa, s.metallic * multiplied(s.albedo, e));
}
