// Twins of rays.py: rays against the height that `map_height` holds, or the finer one of fine_relief.py.
#include "../safe.glsl"

const float LARGEST_SLOPE = 28.636253;  // of a ray 2 degrees above the plane
const float SHORTEST = 1e-6;
const int REFINEMENTS = 4;
const float SOFTNESS = 0.05;

// The texels of the height that rays meet.
ivec2 height_size_at(int level) {
#ifdef FINE
  return 2 * size_at(level);
#else
  return size_at(level);
#endif
}

float height_at(vec2 uv, int level) {
#ifdef FINE
  return read(map_fine_height, around(uv, height_size_at(level), level), 0).r;
#else
  return read(map_height, around(uv, level), 0).r;
#endif
}

// The least and the greatest height of a level.
vec2 span_at(int level) {
  return vec2(number_height_range[2 * level], number_height_range[2 * level + 1]);
}

// How far a ray moves in uv for each unit of height.
vec2 ray_slope(vec3 direction, ivec2 size) {
  float steep = max(abs(direction.z), length(direction.xy) / LARGEST_SLOPE);
  return direction.xy / (direction.z < 0.0 ? -steep : steep) * vec2(1.0, float(size.x) / float(size.y));
}

int steps_of(vec2 slope, float span, ivec2 size) {
  return int(ceil(length(slope * vec2(size)) * span)) + 2;
}

// Where the view ray through a point of the plane meets the surface first: a linear search from the top, then regula falsi.
vec2 trace_view(vec2 uv, int level, vec3 view) {
  ivec2 size = height_size_at(level);
  vec2 slope = ray_slope(view, size), range = span_at(level);
  float span = range.y - range.x;
  int count = steps_of(slope, span, size);
  float top_gap = height_at(uv + range.y * slope, level) - range.y;
  float above = range.y, gap_above = top_gap, below = above, gap_below = top_gap;
  bool found = false;
  for (int step = 0; step <= count && !found; step++) {
    float z = range.y - span * (float(step) / float(count)), gap = height_at(uv + z * slope, level) - z;
    found = gap >= 0.0;
    if (found) { below = z; gap_below = gap; } else { above = z; gap_above = gap; }
  }
  if (!found) { above = below; gap_above = gap_below; }  // by rounding: what is highest is met
  for (int step = 0; step < REFINEMENTS; step++) {
    float z = mix(above, below, clamp(divide(gap_above, gap_above - gap_below), 0.0, 1.0));
    float gap = height_at(uv + z * slope, level) - z;
    if (gap < 0.0) { above = z; gap_above = gap; } else { below = z; gap_below = gap; }
  }
  return uv + mix(above, below, clamp(divide(gap_above, gap_above - gap_below), 0.0, 1.0)) * slope;
}

// By how much a ray from the surface misses all of it, as a difference of slopes; it is not followed on once that is `enough`.
float clearance(vec2 uv, int level, vec3 direction, float enough) {
  ivec2 size = height_size_at(level);
  vec2 slope = ray_slope(direction, size), range = span_at(level);
  float span = range.y - range.x, run = max(length(slope), SHORTEST), least = 1.0 / run;
  if (!(span > 0.0)) return least;
  float start = height_at(uv, level), above = start - range.y;
  int count = steps_of(slope, span, size);
  for (int step = 1; step <= count; step++) {
    float z = span * (float(step) / float(count));
    // Above the highest point rays come ever freer: no later step can be the least.
    if (least <= enough || above + z > least * (z * run)) break;
    least = min(least, (start + z - height_at(uv + z * slope, level)) / (z * run));
  }
  return least;
}

// How much of the light reaches the surface.
float soft_shadow(vec2 uv, int level, vec3 light) {
  return light.z > 0.0 ? clamp(clearance(uv, level, light, -SOFTNESS / 2.0) / SOFTNESS + 0.5, 0.0, 1.0) : 0.0;
}
