// A material without a relief at a point of the maps of one level.
vec3 shade_level(vec2 uv, int level, vec3 light, vec3 view) {
  Place here = around(uv, level);
  return shade_flat(here, light, view) * opacity_at(here);
}
