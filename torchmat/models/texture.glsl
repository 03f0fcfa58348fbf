// Twin of linear.Texture.
vec3 value(Place here, vec3 light, vec3 view) {
  return read(map_albedo, here, 0).rgb * light.z;
}
