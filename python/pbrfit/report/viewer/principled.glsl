// The principled model: docs/model.md.
//
//   I = kd Σ_k A_l Y_k(n) L_k + Σ_j (A a_j + B b_j) G_j
//
// In the pixel's frame (z = normal, x towards the mirror's side) only the ten SH functions even in y
// answer; G_j are the light's coefficients of these. a_j and b_j come from a table, divided by s^m
// with s the sine between normal and view; s^m is put into G_j by an axis x that is s long.
uniform sampler2D lobes;  // cubic B-spline over (√n·v, √r): five texels a node, then Ē(r)

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

// The four B-splines that are not 0 at `part` of a cell.
vec4 spline(float part) {
  float rest = 1.0 - part;
  float p2 = part * part, r2 = rest * rest;
  return vec4(r2 * rest, 4.0 - 3.0 * p2 * (1.0 + rest), 4.0 - 3.0 * r2 * (1.0 + part), p2 * part)
      / 6.0;
}

// a_0 ... a_9, b_0 ... b_9 in order, and Ē.
void lobe(float cosine, float roughness, out vec4 found[5], out float mean) {
  int nodes = textureSize(lobes, 0).y - 2;
  vec2 place = sqrt(vec2(cosine, roughness)) * float(nodes - 1);
  ivec2 cell = min(ivec2(place), nodes - 2);
  vec4 across = spline(place.x - float(cell.x)), along = spline(place.y - float(cell.y));
  for (int t = 0; t < 5; t++) found[t] = vec4(0.0);
  mean = 0.0;
  for (int j = 0; j < 4; j++) {
    int row = cell.y + j;
    for (int i = 0; i < 4; i++) {
      float weight = across[i] * along[j];
      int first = 5 * (cell.x + i);
      for (int t = 0; t < 5; t++) found[t] += weight * texelFetch(lobes, ivec2(first + t, row), 0);
    }
    mean += along[j] * texelFetch(lobes, ivec2(5 * (nodes + 2), row), 0).r;
  }
}

// Light that meets the microfacets of a lobe once more than the lobe knows of, as a factor.
vec3 multiplied(vec3 f0, float energy, float mean) {
  vec3 average = f0 + (1.0 - f0) / 21.0;
  return 1.0 + average * mean / (1.0 - average * (1.0 - mean)) * (1.0 - energy) / energy;
}

vec3 radiance(vec3 normal, vec3 view, float facing, vec3 albedo, float roughness, float metallic) {
  vec4 t[5];
  float mean;
  lobe(clamp(facing, 1e-4, 1.0), roughness, t, mean);
  float base = 3.54490770181103 * t[0].x, grazing = 3.54490770181103 * t[2].z;  // 2 √π
  vec3 metal = metallic * multiplied(albedo, base + grazing, mean);
  vec3 plastic = (1.0 - metallic) * multiplied(vec3(0.04), base + grazing, mean);
  vec3 body = (1.0 - metallic) * (1.0 - 0.04 * base - grazing) / PI * albedo;

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

  vec3 a = t[0].x * g0 + t[0].y * g1 + t[0].z * g2 + t[0].w * g3 + t[1].x * g4
      + t[1].y * g5 + t[1].z * g6 + t[1].w * g7 + t[2].x * g8 + t[2].y * g9;
  vec3 b = t[2].z * g0 + t[2].w * g1 + t[3].x * g2 + t[3].y * g3 + t[3].z * g4
      + t[3].w * g5 + t[4].x * g6 + t[4].y * g7 + t[4].z * g8 + t[4].w * g9;
  return body * diffuse + (0.04 * plastic + metal * albedo) * a + (plastic + metal) * b;
}
