// Twin of linear.Relightable: sums that lie in linear light or in codes of a screen.
#include "../colour.glsl"

vec3 decoded(vec3 total) {
#ifdef SPACE_SRGB
  return srgb_to_linear(max(total, 0.0));
#else
  return total;
#endif
}
