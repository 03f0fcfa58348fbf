// Twin of relief_maps.shade_points: parallax, soft shadow, and the light by way of other texels.
#include "../geometry/rays.glsl"
#include "bases.glsl"

// What a place sends of a light by way of other texels (indirect.py).
vec3 sent_at(Place here, vec3 light) {
#if defined(HAS_AMBIENT)
  vec3 found = read(map_ambient, here, 0).rgb;
#ifdef HAS_AMBIENT_FALLOFF
  found *= 1.0 - number_ambient_falloff[0] + number_ambient_falloff[0] * max(light.z, 0.0);
#endif
  return found;
#elif defined(HAS_INDIRECT)
  float weights[16] = hemispherical(light, 3);
  vec3 arriving = vec3(0.0);
  for (int term = 0; term < 9; term++) arriving += weights[term] * read(map_transfer, here, term).rgb;
  return number_indirect[0] * read(DIFFUSE_MAP, here, 0).rgb * max(arriving, 0.0);
#else
  return vec3(0.0);
#endif
}

vec2 seen_at(vec2 uv, int level, vec3 view) {
  return trace_view(uv, level, view);
}

vec3 shade_seen(vec2 seen, int level, vec3 light, vec3 view) {
  Place here = around(seen, level);
  return (shade_flat(here, light, view) * soft_shadow(seen, level, light) + sent_at(here, light)) * opacity_at(here);
}
