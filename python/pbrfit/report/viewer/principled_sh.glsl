// The principled model under SH light: docs/model.md.
//
//   I = kd Σ_k A_l Y_k(n) L_k + Σ_j (A a_j + B b_j) G_j
//
// In the pixel's frame (z = normal, x towards the mirror's side) only the ten SH functions even in y
// answer; G_j are the light's coefficients of these. a_j and b_j come from a table, divided by s^m
// with s the sine between normal and view; s^m is put into G_j by an axis x that is s long.
uniform vec3 light[16];  // as it is turned now

const vec3 COSINE = vec3(PI, 2.0 * PI / 3.0, PI / 4.0);  // A_l

// Slopes of the light's radiance in band 2, and in band 3, as a homogeneous polynomial, at d: by x,
// y and z. By Euler's theorem d · slope is the degree times the polynomial.
mat3 slope2(vec3 d) {
  return mat3(
      1.09254843059208 * (d.y * light[4] + d.z * light[7] + d.x * light[8])
          - 0.630783130505040 * d.x * light[6],
      1.09254843059208 * (d.x * light[4] + d.z * light[5] - d.y * light[8])
          - 0.630783130505040 * d.y * light[6],
      1.09254843059208 * (d.y * light[5] + d.x * light[7])
          + 1.26156626101008 * d.z * light[6]);
}

mat3 slope3(vec3 d) {
  float xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z;
  float xy = d.x * d.y, yz = d.y * d.z, xz = d.x * d.z;
  return mat3(
      0.590043589926644 * (6.0 * xy * light[9] + 3.0 * (xx - yy) * light[15])
          + 2.89061144264055 * (yz * light[10] + xz * light[14])
          + 0.457045799464466 * ((4.0 * zz - 3.0 * xx - yy) * light[13] - 2.0 * xy * light[11])
          - 2.23905799554069 * xz * light[12],
      0.590043589926644 * (3.0 * (xx - yy) * light[9] - 6.0 * xy * light[15])
          + 2.89061144264055 * (xz * light[10] - yz * light[14])
          + 0.457045799464466 * ((4.0 * zz - xx - 3.0 * yy) * light[11] - 2.0 * xy * light[13])
          - 2.23905799554069 * yz * light[12],
      2.89061144264055 * (xy * light[10] + 0.5 * (xx - yy) * light[14])
          + 3.65636639571573 * (yz * light[11] + xz * light[13])
          + 1.11952899777035 * (2.0 * zz - xx - yy) * light[12]);
}

// a_0 ... a_9, b_0 ... b_9, Ē and κ.
struct Lobe { vec4 a03, a47, a89_b01, b25, b69, rest; };

Lobe lobeOf(float cosine, float roughness) {
  vec2 part;
  ivec2 node = ivec2(place(axes[0], cosine, part.x), place(axes[1], roughness, part.y));
  return Lobe(between(node, 0, part), between(node, 1, part), between(node, 2, part),
      between(node, 3, part), between(node, 4, part), between(node, 5, part));
}

vec3 reflected_sh(Surface s) {
  vec3 normal = s.normal, view = s.view;
  Lobe f = lobeOf(clamp(s.facing, 1e-4, 1.0), s.roughness);
  Parts parts = partsOf(s, energy(f.a03, f.a89_b01, f.rest));
  vec3 axis = dot(normal, view) * normal - view;
  float ss = dot(axis, axis);
  vec3 g0 = light[0];
  mat3 slope = mat3(light[3], light[1], light[2]);
  vec3 g1 = slope * normal, g2 = slope * axis;
  slope = slope2(normal);
  vec3 nn = slope * normal, nu = slope * axis;
  vec3 g3 = 0.792665459521202 * nn;
  vec3 g4 = 0.915291232863769 * nu;
  vec3 g5 = 0.915291232863769 * (slope2(axis) * axis + 0.5 * ss * nn);
  vec3 diffuse = COSINE[0] * 0.282094791773878 * g0 + COSINE[1] * 0.488602511902920 * g1
      + COSINE[2] * 0.5 * nn;
  slope = slope3(normal);
  nn = slope * normal, nu = slope * axis;
  slope = slope3(axis);
  vec3 g6 = 0.446616390460452 * nn;
  vec3 g7 = 0.546991133695863 * nu;
  vec3 g8 = 0.691895136958641 * (slope * normal + 0.5 * ss * nn);
  vec3 g9 = 0.564930013687251 * (slope * axis + 0.75 * ss * nu);

  vec3 a = f.a03.x * g0 + f.a03.y * g1 + f.a03.z * g2 + f.a03.w * g3 + f.a47.x * g4
      + f.a47.y * g5 + f.a47.z * g6 + f.a47.w * g7 + f.a89_b01.x * g8 + f.a89_b01.y * g9;
  vec3 b = f.a89_b01.z * g0 + f.a89_b01.w * g1 + f.b25.x * g2 + f.b25.y * g3 + f.b25.z * g4
      + f.b25.w * g5 + f.b69.x * g6 + f.b69.y * g7 + f.b69.z * g8 + f.b69.w * g9;
  float plastic = parts.kappa * parts.dielectric;
  return parts.body * diffuse + (0.04 * plastic + parts.metal * s.albedo) * a
      + (plastic + parts.metal) * b;
}
