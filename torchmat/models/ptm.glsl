// Twin of linear.Ptm.
#include "bases.glsl"
#include "relightable.glsl"

vec3 value(Place here, vec3 light, vec3 view) {
  float weights[6] = polynomial(light);
  vec3 total = vec3(0.0);
  for (int term = 0; term < 6; term++) total += weights[term] * read(map_polynomial, here, term).rgb;
  return decoded(total);
}
