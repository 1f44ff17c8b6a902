// Light of a panorama, by the model's full reflection: docs/relight.md#panoramas. Round lobes in the
// plane of incidence stand for the mirror-like part; the panorama is there as blurred as they are.
precision highp sampler2DArray;
const int LOBES = 8;  // with two hemispheres at the end
uniform sampler2D panorama;           // its mip levels are blurred by 2^level σ_0
uniform sampler2DArray hemispheres;   // an even one, and the matt one
uniform sampler2D lobeNodes;          // by √n·v and lobe (columns) and roughness: angle, level, a, b
uniform mat3 toPanorama;              // of directions, as the light is turned
uniform float panoramaUnit;           // radiance of 1 in these textures

vec2 placeOf(vec3 direction) {
  vec3 d = toPanorama * direction;
  return vec2(0.5 + atan(d.x, -d.z) / (2.0 * PI), 0.5 - asin(clamp(d.y, -1.0, 1.0)) / PI);
}

// What the lobes bring of F0, and of the rest; and what a white matt surface reflects.
struct Gathered { vec3 base, grazing, matt; };

Gathered gathered(Surface s) {
  ivec2 cells = ivec2(textureSize(lobeNodes, 0).x / LOBES, textureSize(lobeNodes, 0).y) - 1;
  vec2 along = vec2(sqrt(clamp(s.facing, 1e-4, 1.0)), s.roughness) * vec2(cells);
  ivec2 node = min(ivec2(along), cells - 1);
  vec2 part = along - vec2(node);
  vec3 away = s.facing * s.normal - s.view;
  float sine = length(away);
  away = sine > 1e-9 ? away / sine : vec3(0.0);
  float mirror = acos(clamp(s.facing, -1.0, 1.0));
  vec2 facing = placeOf(s.normal);
  Gathered sum = Gathered(vec3(0.0), vec3(0.0), textureLod(hemispheres, vec3(facing, 1.0), 0.0).rgb);
  for (int k = 0; k < LOBES; k++) {
    ivec2 at = ivec2(LOBES * node.x + k, node.y);
    vec4 lobe = mix(
        mix(texelFetch(lobeNodes, at, 0), texelFetch(lobeNodes, at + ivec2(LOBES, 0), 0), part.x),
        mix(texelFetch(lobeNodes, at + ivec2(0, 1), 0),
            texelFetch(lobeNodes, at + ivec2(LOBES, 1), 0), part.x), part.y);
    vec3 radiance;
    if (k < LOBES - 2) {
      float angle = mirror + lobe.x;
      radiance = textureLod(panorama, placeOf(sin(angle) * away + cos(angle) * s.normal), lobe.y).rgb;
    } else {
      radiance = k < LOBES - 1 ? textureLod(hemispheres, vec3(facing, 0.0), 0.0).rgb : sum.matt;
    }
    sum.base += lobe.z * radiance;
    sum.grazing += lobe.w * radiance;
  }
  return sum;
}
