// Twin of distribution.py.
#include "../frames.glsl"
#include "ggx.glsl"

// The texel's frame, turned by its rotation.
mat3 frame_at(Place here) {
#ifdef HAS_NORMAL
  mat3 frame = tangent_frame(normalise(read(map_normal, here, 0).xyz));
#else
  mat3 frame = mat3(1.0);
#endif
#ifdef HAS_ROTATION
  frame = turned_frame(frame, normalise(read(map_rotation, here, 0).xy));
#endif
  return frame;
}

#if LOBES > 0
const float SPOT = 1.0 / 256.0;  // where the texels of a dense map lie evenly: parabolic.py

// The specular colour of a half vector in the texel's frame, from the parabolic maps.
vec3 looked_up(Place here, vec3 local) {
  vec2 disc = local.xy / (1.0 + max(local.z, 0.0)) * vec2(1.0, -1.0);
#ifdef SPECULAR_SPACING_DENSE
  disc *= inversesqrt(sqrt(dot(disc, disc) + SPOT * SPOT));
#endif
  vec2 texel = ((disc + 1.0) * float(textureSize(map_specular, 0).x) - 1.0) / 2.0;
#if LOBES == 1
  return read_table(map_specular, texel, 0).rgb;
#else
  vec3 total = vec3(0.0);
  vec4 weights;
  for (int lobe = 0; lobe < LOBES; lobe++) {
    if (lobe % 4 == 0) weights = read(map_index, here, lobe / 4);
    total += read_table(map_specular, texel, lobe).rgb * weights[lobe % 4];
  }
  return total;
#endif
}

#ifdef HAS_TILT
// 1 - tilt at the angle of a cosine.
float tilted(float cosine) {
  return 1.0 - read_table(map_tilt, vec2(degrees(arc_cosine(cosine)), 0.0), 0).r;
}
#endif

// D, which the specular part is divided by: as printed, of the tilt curve, or Smith's.
float denominator_of(vec3 light, vec3 view) {
#if defined(HAS_MASKING)
  vec2 masking = vec2(number_masking[0], number_masking[1]);
  return smith_denominator(light, view, masking * masking);
#elif defined(HAS_TILT)
  float a = tilted(max(light.z, 0.0)), b = tilted(max(view.z, 0.0));
  return a + b - a * b;
#else
  float a = max(light.z, 0.0), b = max(view.z, 0.0);
  return a + b - a * b;
#endif
}

vec3 specular_at(Place here, vec3 local, float share, float squared) {
#ifdef HAS_FRESNEL
  float r0 = read(map_fresnel, here, 0).r;
  share *= r0 + (1.0 - r0) * power(max(1.0 - sqrt(squared) / 2.0, 0.0), float(FRESNEL_EXPONENT));
#endif
  vec3 colour = looked_up(here, local) * (PI * share);
#ifdef HAS_SPECULAR_MASK
#if MASK_CHANNELS == 3
  colour *= read(map_specular_mask, here, 0).rgb;
#else
  colour *= read(map_specular_mask, here, 0).r;
#endif
#endif
  return colour;
}
#endif

vec3 value(Place here, vec3 light, vec3 view) {
  mat3 frame = frame_at(here);
  vec3 total = light + view;
  light = light * frame;  // a vector before a matrix: its products with the columns
  float n_dot_l = max(light.z, 0.0);
  vec3 found = read(map_diffuse, here, 0).rgb * n_dot_l;
#if LOBES > 0
  view = view * frame;
  // The length before it is turned: rounding would decide it where light and view are opposite.
  float squared = max(dot(total, total), 1e-24);
  float share = n_dot_l / (denominator_of(light, view) + GRAZING);
  found += specular_at(here, (total * inversesqrt(squared)) * frame, share, squared);
#endif
  return found;
}
