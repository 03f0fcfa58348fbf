// Twin of linear.Lambert.
#include "../safe.glsl"

vec3 value(Place here, vec3 light, vec3 view) {
  return read(map_albedo, here, 0).rgb * max(dot(light, normalise(read(map_normal, here, 0).xyz)), 0.0);
}
