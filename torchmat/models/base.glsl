// Twin of base.py: what every model's shader can read, and `shade`, which calls the model's `value`.
//
// Before this stand, made from the description: SIZE and LEVELS, a define for each option, HAS_NAME for each map,
// `uniform sampler2DArray map_NAME` for each that is a texture, `uniform float number_NAME[]` for the others.

// The texels around a place in the maps of one level, and how near each is.
struct Place { ivec2 low; ivec2 high; vec2 share; int level; };

// Of light and view above the horizon: pi f_r cos, linear. Each model defines it.
vec3 value(Place here, vec3 light, vec3 view);

// Halves of odd sizes are rounded up, as rendering/mipmap.py has them.
ivec2 size_at(int level) {
  return (SIZE + (1 << level) - 1) >> level;
}

ivec2 wrapped(ivec2 texel, ivec2 size) {
#ifdef TILES
  return (texel + 4 * size) % size;  // of what is at most four sizes below 0
#else
  return clamp(texel, ivec2(0), size - 1);
#endif
}

// Texels counted from the upper left, 0 in the middle of the first, of a map of that size.
vec2 texels_of(vec2 uv, ivec2 size) {
  vec2 down = vec2(uv.x, 1.0 - uv.y);
#ifdef TILES
  down = fract(down);
#endif
  return down * vec2(size) - 0.5;
}

Place around(vec2 uv, ivec2 size, int level) {
  vec2 texel = texels_of(uv, size), below = floor(texel);
  ivec2 low = ivec2(below), high = low + 1;
#ifdef TILES
  low += size * ivec2(lessThan(low, ivec2(0)));  // a remainder takes longer
  high -= size * ivec2(equal(high, size));
#else
  low = clamp(low, ivec2(0), size - 1);
  high = clamp(high, ivec2(0), size - 1);
#endif
  return Place(low, high, texel - below, level);
}

Place around(vec2 uv, int level) {
  return around(uv, size_at(level), level);
}

Place at_texel(ivec2 texel) {
  return Place(texel, texel, vec2(0.0), 0);
}

// A map, bilinear: hardware filters with weights of 8 bits. A map of one channel a layer has four of them in each `layer` here.
vec4 read(highp sampler2DArray map, Place here, int layer) {
  vec4 upper = mix(texelFetch(map, ivec3(here.low, layer), here.level),
                   texelFetch(map, ivec3(here.high.x, here.low.y, layer), here.level), here.share.x);
  vec4 lower = mix(texelFetch(map, ivec3(here.low.x, here.high.y, layer), here.level),
                   texelFetch(map, ivec3(here.high, layer), here.level), here.share.x);
  return mix(upper, lower, here.share.y);
}

// A table that all texels share, bilinear, at texels counted from the middle of the first; its border goes on.
vec4 read_table(highp sampler2DArray table, vec2 texel, int layer) {
  ivec2 last = textureSize(table, 0).xy - 1;
  vec2 below = floor(texel), share = texel - below;
  ivec2 low = clamp(ivec2(below), ivec2(0), last), high = clamp(ivec2(below) + 1, ivec2(0), last);
  return mix(mix(texelFetch(table, ivec3(low, layer), 0), texelFetch(table, ivec3(high.x, low.y, layer), 0), share.x),
             mix(texelFetch(table, ivec3(low.x, high.y, layer), 0), texelFetch(table, ivec3(high, layer), 0), share.x), share.y);
}

float opacity_at(Place here) {
#ifdef HAS_OPACITY
  return read(map_opacity, here, 0).r;
#else
  return 1.0;
#endif
}

vec3 shade_flat(Place here, vec3 light, vec3 view) {
  return light.z > 0.0 && view.z > 0.0 ? max(value(here, light, view), 0.0) : vec3(0.0);
}

// Coordinates of the whole texture as those of the part that the maps are (models/cutout.py).
vec2 placed(vec2 uv) {
#ifdef CUTOUT
  const float part[6] = CUTOUT;  // top, left, height, width, whole height, whole width
#ifdef CUTOUT_REPEATS
  uv = fract(uv);
#endif
  return vec2((uv.x * part[5] - part[1]) / part[3], 1.0 - ((1.0 - uv.y) * part[4] - part[0]) / part[2]);
#else
  return uv;
#endif
}

// Of relief_maps.glsl, or of flat.glsl: which point of the maps of one level is seen through a point of the plane, whatever the light,
// and the value there.
vec2 seen_at(vec2 uv, int level, vec3 view);
vec3 shade_seen(vec2 seen, int level, vec3 light, vec3 view);

// The value at a point of the plane for unit light and view in its frame, between two levels of the maps.
vec3 shade(vec2 uv, float level, vec3 light, vec3 view) {
  if (!(light.z > 0.0 && view.z > 0.0)) return vec3(0.0);
  uv = placed(uv);
  level = clamp(level, 0.0, float(LEVELS - 1));
  float lower = floor(level), share = level - lower;
  vec3 found = vec3(0.0);
  for (int step = 0; step < (share > 0.0 ? 2 : 1); step++) {
    int here = int(lower) + step;
    found += (step == 0 ? 1.0 - share : share) * shade_seen(seen_at(uv, here, view), here, light, view);
  }
  return found;
}

// How much of the plane's point the surface covers.
float cover(vec2 uv, float level) {
  level = clamp(level, 0.0, float(LEVELS - 1));
  float lower = floor(level);
  uv = placed(uv);
  return mix(opacity_at(around(uv, int(lower))), opacity_at(around(uv, min(int(lower) + 1, LEVELS - 1))), level - lower);
}
