// One pixel of the view: the model that the result was fitted with, then display as in
// pbrfit.display.tone. What stands above this file: the version, and of SH, LAMPS and ENVIRONMENT those
// that the light has, so that no program pays for another kind of light. With neither it shows maps.
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;

uniform usampler2D geometry;  // octahedral normal (2), roughness, correction of n·v
uniform usampler2D surface;   // square root of albedo (3), metallic
uniform vec4 geometryUnit;    // size of one code of each
uniform vec4 surfaceUnit;
uniform float tangent;        // of half the field of view; 0 = orthographic
uniform vec2 offset;          // added to roughness and metallic
uniform float gain;           // 2^exposure
uniform int toneMap;          // 0 none, 1 neutral
uniform int shown;            // 0 relit, 1 albedo, 2 roughness, 3 metallic, 4 normals, 5 all in strips
uniform int stride;           // texels from one pixel to the next
uniform vec4 box;             // around the mask, texels: left, top, right, bottom

out vec4 color;

const float PI = 3.14159265358979;

// What a light meets.
struct Surface {
  vec3 normal, view;
  float facing;  // n·v
  vec3 albedo;
  float roughness, metallic;
};

MODEL
// The octahedron |x| + |y| + |z| = 1, its lower half folded outwards, and back to the sphere.
vec3 unfolded(vec2 p) {
  vec3 d = vec3(p, 1.0 - abs(p.x) - abs(p.y));
  float fold = max(-d.z, 0.0);
  d.x -= d.x >= 0.0 ? fold : -fold;
  d.y -= d.y >= 0.0 ? fold : -fold;
  return normalize(d);
}

// Khronos PBR Neutral Tone Mapper, 2024.
vec3 neutral(vec3 c) {
  float least = min(c.r, min(c.g, c.b));
  c -= least < 0.08 ? least - 6.25 * least * least : 0.04;
  float peak = max(c.r, max(c.g, c.b));
  if (peak < 0.76) return c;
  float lowered = 1.0 - 0.24 * 0.24 / (peak + 0.24 - 0.76);
  float grey = 1.0 - 1.0 / (0.15 * (peak - lowered) + 1.0);
  return mix(c * (lowered / peak), vec3(lowered), grey);
}

vec3 srgb(vec3 linear) {
  vec3 c = clamp(linear, 0.0, 1.0);
  vec3 power = 1.055 * pow(max(c, 0.0031308), vec3(1.0 / 2.4)) - 0.055;
  return mix(power, 12.92 * c, lessThanEqual(c, vec3(0.0031308)));
}

vec3 relit(Surface s) {
  vec3 radiance = vec3(0.0);
#ifdef SH
  radiance += reflected_sh(s);
#endif
#ifdef LAMPS
  radiance += reflected_lamps(s);
#endif
#ifdef ENVIRONMENT
  radiance += reflected_environment(s);
#endif
  vec3 exposed = max(gain * radiance, 0.0);
  return srgb(toneMap == 1 ? neutral(exposed) : exposed);
}

void main() {
  ivec2 size = textureSize(geometry, 0);
  ivec2 pixel = min(ivec2(gl_FragCoord.xy) * stride + stride / 2, size - 1);
  ivec2 texel = ivec2(pixel.x, size.y - 1 - pixel.y);  // row 0 of the maps is the top
  uvec4 codes = texelFetch(geometry, texel, 0);
  if (codes.a == 0u) {
    color = vec4(0.0);  // outside the mask
    return;
  }
  vec4 g = vec4(codes.rgb, float(codes.a) - 32768.0) * geometryUnit;
  vec4 s = vec4(texelFetch(surface, texel, 0)) * surfaceUnit;
  vec2 centre = (2.0 * vec2(pixel) + 1.0 - vec2(size)) / float(size.x);
  vec3 normal = unfolded(2.0 * g.xy - 1.0);
  vec3 view = normalize(vec3(-centre * tangent, 1.0));
  float facing = dot(normal, view) + g.a;
  normal += g.a * view;  // what n·v lacks, n·l lacks as well
  Surface here = Surface(normal, view, facing, s.rgb * s.rgb,
      clamp(g.z + offset.x, 0.0, 1.0), clamp(s.a + offset.y, 0.0, 1.0));

  int what = shown;
  if (shown == 5) {  // slanted strips over the box of the mask
    float slant = 0.12 * (float(texel.y) - 0.5 * (box.y + box.w));
    float along = 5.0 * (float(pixel.x) + 0.5 - box.x + slant) / (box.z - box.x);
    what = clamp(int(floor(along)), 0, 4);
  }
  vec3 code;
  if (what == 1) {
    code = srgb(here.albedo);
  } else if (what == 2) {
    code = vec3(here.roughness);
  } else if (what == 3) {
    code = vec3(here.metallic);
  } else if (what == 4) {
    code = 0.5 + 0.5 * normal;
  } else {
    code = relit(here);
  }
  color = vec4(code, 1.0);
}
