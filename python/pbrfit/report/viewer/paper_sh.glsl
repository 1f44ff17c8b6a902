// The paper's model under SH light: docs/model.md.
//
//   I = Σ_k (kd A_l Y_k(n) + ks h_l(r) Y_k(mirror)) L_k          l = band of k
uniform sampler2D bands;      // h_0 ... h_3 at evenly spaced roughness
uniform vec3 light[16];       // as it is turned now

const vec4 COSINE = vec4(PI, 2.0 * PI / 3.0, PI / 4.0, 0.0);  // A_l

// Radiance of the light towards d, band by band weighted: Σ_k weight_l Y_k(d) L_k.
vec3 filtered(vec3 d, vec4 weight) {
  float x = d.x, y = d.y, z = d.z;
  float xx = x * x, yy = y * y, zz = z * z;
  vec3 first = 0.488602511902920 * (y * light[1] + z * light[2] + x * light[3]);
  vec3 second = 1.09254843059208 * (x * y * light[4] + y * z * light[5] + x * z * light[7]
      + 0.5 * (xx - yy) * light[8]) + 0.315391565252520 * (3.0 * zz - 1.0) * light[6];
  vec3 third = 0.590043589926644 * (y * (3.0 * xx - yy) * light[9] + x * (xx - 3.0 * yy) * light[15])
      + 2.89061144264055 * z * (x * y * light[10] + 0.5 * (xx - yy) * light[14])
      + 0.457045799464466 * (5.0 * zz - 1.0) * (y * light[11] + x * light[13])
      + 0.373176332590115 * z * (5.0 * zz - 3.0) * light[12];
  return weight[0] * 0.282094791773878 * light[0] + weight[1] * first + weight[2] * second
      + weight[3] * third;
}

vec4 bandWeights(float roughness) {
  int last = textureSize(bands, 0).x - 1;
  float position = roughness * float(last);
  int cell = min(int(position), last - 1);
  return mix(texelFetch(bands, ivec2(cell, 0), 0), texelFetch(bands, ivec2(cell + 1, 0), 0),
             position - float(cell));
}

vec3 reflected_sh(Surface s) {
  float cosine = max(s.facing, 1e-4);  // not in the mirror direction
  float grazing = 1.0 - cosine;
  float schlick = grazing * grazing * grazing * grazing * grazing;
  float k = 0.5 * s.roughness * s.roughness * s.roughness * s.roughness;
  float g1 = cosine / (cosine * (1.0 - k) + k);
  vec3 f0 = mix(vec3(0.04), s.albedo, s.metallic);
  vec3 fresnel = f0 + (1.0 - f0) * schlick;
  vec3 diffuse = (1.0 - fresnel) * (1.0 - s.metallic) * s.albedo / PI;
  vec3 specular = fresnel * (0.25 * g1);
  return diffuse * filtered(s.normal, COSINE)
      + specular * filtered(2.0 * s.facing * s.normal - s.view, bandWeights(s.roughness));
}
