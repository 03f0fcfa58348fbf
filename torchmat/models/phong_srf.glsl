// Twin of phong_srf.py.
#include "lobes.glsl"

vec3 lobe_value(vec3 light, vec3 view) {
  vec3 diffuse = vec3(number_lobe[0], number_lobe[1], number_lobe[2]);
  vec3 specular = vec3(number_lobe[3], number_lobe[4], number_lobe[5]);
#ifdef BASE_PHONG
  return phong_of_half(diffuse, specular, vec3(number_lobe[6], 0.0, 0.0), light, view);
#else
  return ashikhmin_shirley_lobe(diffuse, specular, vec3(number_lobe[6], number_lobe[7], number_lobe[8]), light, view);
#endif
}

vec3 residual(Place here, int term) {
  return read(map_residual, here, term).rgb;
}

vec3 value(Place here, vec3 light, vec3 view) {
  vec3 total = lobe_value(light, view);
#if defined(RESIDUAL_COSINE)
  return total + light.z * residual(here, 0);
#elif defined(RESIDUAL_QUADRATIC)
  float known[4] = float[4](light.x, light.y, view.x, view.y);
  total += residual(here, 0);
  int term = 5;
  for (int i = 0; i < 4; i++) {
    total += known[i] * residual(here, 1 + i);
    for (int j = i; j < 4; j++) total += known[i] * known[j] * residual(here, term++);
  }
  return total;
#else
  vec3 h = half_vector(light, view);
  total += h.x * residual(here, 0) + h.y * residual(here, 1) + h.z * residual(here, 2);
#ifdef RESIDUAL_HALF_LIGHT
  total += light.x * residual(here, 3) + light.y * residual(here, 4) + light.z * residual(here, 5) + residual(here, 6);
#endif
  return total;
#endif
}
