// Twin of merl.MerlBrdf, linear between bins, of a grey table [half, difference * azimuths].
#include "../frames.glsl"

// Half polar, difference polar and difference azimuth in bins of the table (half_difference.py).
vec3 bins_of(vec3 light, vec3 view, ivec3 count) {
  vec3 h = half_vector(light, view), apart = light - view, together = light + view;
  float half_sine = length(h.xy), half_polar = arc_tangent(half_sine, h.z);
  vec2 turn = half_sine < TINY ? vec2(1.0, 0.0) : normalise(h.xy);
  float along = dot(apart.xy, turn) * h.z - apart.z * half_sine, across = apart.y * turn.x - apart.x * turn.y;
  float difference = arc_tangent(length(apart), length(together));
  return vec3(sqrt(half_polar * (2.0 / PI)), difference * (2.0 / PI), azimuth_of(vec2(along, across)) / PI) * vec3(count);
}

// Entries at a row of half angles and a fraction of a bin of difference angles: at an azimuth, or the mean over all.
float entry(highp sampler2DArray table, int row, int bin, int azimuth, ivec3 count) {
  return texelFetch(table, ivec3(clamp(bin, 0, count.y - 1) * count.z + azimuth, clamp(row, 0, count.x - 1), 0), 0).r;
}

float mean_entry(highp sampler2DArray table, int row, int bin, ivec3 count) {
  float total = 0.0;
  for (int azimuth = 0; azimuth < count.z; azimuth++) total += entry(table, row, bin, azimuth, count);
  return total / float(count.z);
}

// pi f_r cos.
float merl_value(highp sampler2DArray table, int azimuths, vec3 light, vec3 view) {
  ivec2 size = textureSize(table, 0).xy;
  ivec3 count = ivec3(size.y, size.x / azimuths, azimuths);
  vec3 bins = bins_of(light, view, count), below = floor(bins - 0.5), share = bins - 0.5 - below;
  ivec3 low = ivec3(below);
  ivec2 around = ivec2((low.z + azimuths) % azimuths, (low.z + 1) % azimuths);
  float found = 0.0;
  for (int corner = 0; corner < 4; corner++) {
    ivec2 side = ivec2(corner & 1, corner >> 1);
    float here = mix(entry(table, low.x + side.x, low.y + side.y, around.x, count),
                     entry(table, low.x + side.x, low.y + side.y, around.y, count), share.z);
    found += (side.x == 0 ? 1.0 - share.x : share.x) * (side.y == 0 ? 1.0 - share.y : share.y) * here;
  }
  // At the poles the azimuth means nothing: the mean over it there, rising to the table within half a bin.
  if (bins.x < 0.5) {
    float upright = mix(mean_entry(table, 0, low.y, count), mean_entry(table, 0, low.y + 1, count), share.y);
    found = mix(upright, found, 2.0 * bins.x);
  }
  if (bins.y < 0.5) {
    float together = mix(mean_entry(table, low.x, 0, count), mean_entry(table, low.x + 1, 0, count), share.x);
    found = mix(together, found, 2.0 * bins.y);
  }
  return found * PI * light.z;
}
