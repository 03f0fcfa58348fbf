// Twin of shading_map.py.
#include "../brdf/analytic.glsl"
#include "../brdf/merl.glsl"

#ifndef BRDF_TABLE
float lobe(int place) {
  return place < NUMBER_LOBE ? number_lobe[min(place, NUMBER_LOBE - 1)] : 0.0;
}
#endif

// What the BRDF says, the mean of its channels.
float brightness(vec3 light, vec3 view) {
#ifdef BRDF_TABLE
  return max(merl_value(map_reflectance, 36, light, view), 0.0) + float(AMBIENT_LEVEL);
#else
  vec3 diffuse = vec3(lobe(0), lobe(1), lobe(2)), specular = vec3(lobe(3), lobe(4), lobe(5)), shape = vec3(lobe(6), lobe(7), lobe(8));
#if defined(BRDF_LAMBERT)
  vec3 found = lambert_lobe(diffuse, specular, shape, light, view);
#elif defined(BRDF_PHONG)
  vec3 found = phong_lobe(diffuse, specular, shape, light, view);
#elif defined(BRDF_BLINN)
  vec3 found = blinn_lobe(diffuse, specular, shape, light, view);
#elif defined(BRDF_ASHIKHMIN_SHIRLEY)
  vec3 found = ashikhmin_shirley_lobe(diffuse, specular, shape, light, view);
#elif defined(BRDF_WARD)
  vec3 found = ward_lobe(diffuse, specular, shape, light, view);
#elif defined(BRDF_COOK_TORRANCE)
  vec3 found = cook_torrance_lobe(diffuse, specular, shape, light, view);
#elif defined(BRDF_GGX)
  vec3 found = ggx_lobe(diffuse, specular, shape, light, view);
#elif defined(BRDF_GGX_ANISOTROPIC)
  vec3 found = ggx_anisotropic_lobe(diffuse, specular, shape, light, view);
#endif
  return max((found.r + found.g + found.b) / 3.0, 0.0) + float(AMBIENT_LEVEL);
#endif
}

// How much of sector j, which is lit from azimuth 2 pi j / AZIMUTHS: linear between neighbours, all alike at the normal.
float sector_weight(int sector, vec3 light) {
  float sine = min(length(light.xy), 1.0), place = azimuth_of(light.xy) * (float(AZIMUTHS) / (2.0 * PI)), below = floor(place);
  float near = sector == int(below) % AZIMUTHS ? 1.0 - (place - below) : sector == (int(below) + 1) % AZIMUTHS ? place - below : 0.0;
  return (1.0 - sine) / float(AZIMUTHS) + sine * near;
}

vec3 value(Place here, vec3 light, vec3 view) {
  float r = brightness(light, view), brightest = number_brightest[0];
  float place = clamp(divide(min(r, brightest), brightest), 0.0, 1.0) * float(SLICES - 1);
  float below = min(floor(place), float(SLICES - 2));
  vec3 found = vec3(0.0);
  for (int sector = 0; sector < AZIMUTHS; sector++) {
    int layer = sector * SLICES + int(below);
    vec3 colour = mix(read(map_slices, here, layer).rgb, read(map_slices, here, layer + 1).rgb, place - below);
    found += (AZIMUTHS == 1 ? 1.0 : sector_weight(sector, light)) * colour;
  }
#ifdef OVERFLOW_SCALE
  found *= r > brightest ? divide(r, brightest) : 1.0;
#endif
  return found;
}
