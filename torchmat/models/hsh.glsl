// Twin of linear.Hsh.
#include "bases.glsl"
#include "relightable.glsl"

vec3 value(Place here, vec3 light, vec3 view) {
  float weights[16] = hemispherical(light, TERMS == 4 ? 2 : TERMS == 9 ? 3 : 4);
  vec3 total = vec3(0.0);
  for (int term = 0; term < TERMS; term++) total += weights[term] * read(map_harmonic, here, term).rgb;
  return decoded(total);
}
