// A material without a relief at a point of the maps of one level.
vec2 seen_at(vec2 uv, int level, vec3 view) {
  return uv;
}

vec3 shade_seen(vec2 seen, int level, vec3 light, vec3 view) {
  Place here = around(seen, level);
  return shade_flat(here, light, view) * opacity_at(here);
}
