// Twin of sphere_images.py.
#include "sphere_geometry.glsl"

const int COUNT = ANGLES_DEG_COUNT;
const float angles[COUNT] = ANGLES_DEG;

// k of a row of the table at a sine.
float turn_at(int row, float sine) {
  float last = float(textureSize(map_turn, 0).x - 1);
  return read_table(map_turn, vec2((clamp(sine, -1.0, 1.0) + 1.0) * last / 2.0, float(row)), 0).r;
}

vec3 picture(vec4 place, int number, float turn) {
  float size = float(textureSize(map_images, 0).x), inside = 1.0 - 1.0 / size;
  vec2 at = turned_on_sphere(place, turn);
  // The pictures stand below each other in Python's atlas, where a neighbour would be mixed in.
  at.y = inside < SHORTENED ? clamp(at.y, -inside, inside) : at.y;
  return read_table(map_images, ((vec2(at.x, -at.y) + 1.0) * size - 1.0) / 2.0, number).rgb;
}

vec3 value(Place here, vec3 light, vec3 view) {
  vec4 place = place_on_sphere(light, view);
  float sine = sine_to_half(place);
  int lower = 0;
  for (int number = 1; number < COUNT; number++) lower += place.x >= radians(angles[number]) ? 1 : 0;
  int upper = min(lower + 1, COUNT - 1), rows = textureSize(map_turn, 0).y;
  vec2 apart = radians(vec2(angles[lower], angles[upper])) - place.x;
  vec3 colour;
  if (lower == upper) {
    colour = picture(place, lower, TURN_BEYOND * apart.x);
  } else {
    vec2 k = rows == 1 ? vec2(turn_at(0, sine)) : vec2(turn_at(2 * lower, sine), turn_at(2 * lower + 1, sine));
    colour = mix(picture(place, lower, k.x * apart.x), picture(place, upper, k.y * apart.y), -apart.x / (apart.y - apart.x));
  }
  return colour * read(map_tint, here, 0).rgb;
}
