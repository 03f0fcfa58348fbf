// Twin of linear.Lptm.
#include "bases.glsl"
#include "relightable.glsl"

vec3 value(Place here, vec3 light, vec3 view) {
  float weights[6] = polynomial(light);
  vec4 first = read(map_luminance, here, 0), last = read(map_luminance, here, 1);
  float luminance = dot(first, vec4(weights[0], weights[1], weights[2], weights[3])) + dot(last.xy, vec2(weights[4], weights[5]));
  return decoded(luminance * read(map_chroma, here, 0).rgb);
}
