// Twin of microfacet.py.
#include "../frames.glsl"
#include "ggx.glsl"

mat3 frame_at(Place here) {
#ifdef HAS_NORMAL
  mat3 frame = tangent_frame(normalise(read(map_normal, here, 0).xyz));
#else
  mat3 frame = mat3(1.0);
#endif
#ifdef HAS_ROTATION
  vec2 turn = normalise(read(map_rotation, here, 0).xy);
  frame = turned_frame(frame, turn == vec2(0.0) ? vec2(1.0, 0.0) : turn);
#endif
  return frame;
}

float mean_of(vec3 colour) {
  return (colour.r + colour.g + colour.b) / 3.0;
}

// What gets through a layer both ways: 1 - F of either cosine.
vec3 through(vec3 reflected, float most, vec2 cosines) {
  vec3 one = max(1.0 - reflected - (most - reflected) * schlick_rise(1.0 - cosines.x), 0.0);
  return one * max(1.0 - reflected - (most - reflected) * schlick_rise(1.0 - cosines.y), 0.0);
}

#ifdef HAS_ROLLOFF
float rolled(float cosine) {
  return max(1.0 + number_rolloff[0] * (1.0 - cosine) + number_rolloff[1] * schlick_rise(1.0 - cosine), 0.0);
}
#endif

#ifdef HAS_SHEEN
vec3 sheen_at(Place here, vec3 h, vec2 cosines) {
  float exponent = 1.0 / (number_sheen_roughness[0] * number_sheen_roughness[0]);
  float peak = (2.0 + exponent) / 8.0 * power(dot(h.xy, h.xy), exponent / 2.0);
  return read(map_sheen, here, 0).rgb * (peak * cosines.x / (cosines.x + cosines.y - cosines.x * cosines.y + GRAZING));
}
#endif

vec3 value(Place here, vec3 light, vec3 view) {
  mat3 frame = frame_at(here);
  vec3 total = light + view;
  float squared = max(dot(total, total), 1e-24);
  float rise = schlick_rise(max(1.0 - sqrt(squared) / 2.0, 0.0));
  vec3 h = (total * inversesqrt(squared)) * frame;  // a vector before a matrix: its products with the columns
  light = light * frame;
  view = view * frame;
  vec2 cosines = max(vec2(light.z, view.z), 0.0);

  vec3 f0 = read(map_specular_f0, here, 0).rgb;
  float f90 = usual_f90(mean_of(f0));
#ifdef HAS_F90
  f90 *= read(map_f90, here, 0).r;
#endif
#ifdef PARTS_ANISOTROPY
  vec2 roughness = read(map_roughness, here, 0).rg;
#else
  vec2 roughness = read(map_roughness, here, 0).rr;
#endif
  vec3 found = ggx_share(light, view, h, squared_alpha(roughness)) * mix(f0, vec3(f90), rise);

  vec3 diffuse = read(map_diffuse, here, 0).rgb * cosines.x;
#ifdef HAS_ROLLOFF
  diffuse *= rolled(cosines.x) * rolled(cosines.y);
#endif
#if defined(PARTS_LAYERED) && !defined(HAS_COAT)
  diffuse *= through(f0, f90, cosines);
#endif
  found += diffuse;
#ifdef HAS_COAT
  float coat = read(map_coat, here, 0).r, coat_f90 = usual_f90(coat);
#ifdef PARTS_LAYERED
  found *= through(vec3(coat), coat_f90, cosines);
#endif
  found += ggx_share(light, view, h, squared_alpha(read(map_coat_roughness, here, 0).rr)) * mix(coat, coat_f90, rise);
#endif
#ifdef HAS_SHEEN
  found += sheen_at(here, h, cosines);
#endif
  return found;
}
