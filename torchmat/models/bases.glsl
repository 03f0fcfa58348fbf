// Twins of bases.py: functions of light and view that linear models weigh.
#include "../frames.glsl"

// The biquadratic of the projected light: lx lx, ly ly, lx ly, lx, ly, 1.
float[6] polynomial(vec3 light) {
  return float[6](light.x * light.x, light.y * light.y, light.x * light.y, light.x, light.y, 1.0);
}

float factorial(int number) {
  float found = 1.0;
  for (int factor = 2; factor <= number; factor++) found *= float(factor);
  return found;
}

// Hemispherical harmonics of the light, band by band: `bands` squared of the 16 numbers.
float[16] hemispherical(vec3 light, int bands) {
  float weights[16];
  vec2 direction = light.xy * (2.0 * sqrt(max(divide(light.z, 1.0 + light.z), 0.0))), turn = vec2(1.0, 0.0);
  float x = 2.0 * light.z - 1.0, first = 1.0;
  for (int order = 0; order < bands; order++) {
    float legendre = first, previous = 0.0;
    for (int degree = order; degree < bands; degree++) {
      if (degree > order) {
        float next = (float(2 * degree - 1) * x * legendre - float(degree + order - 1) * previous) / float(degree - order);
        previous = legendre;
        legendre = next;
      }
      float scale = float(2 * degree + 1) * factorial(degree - order) / (2.0 * PI * factorial(degree + order));
      scale = legendre * sqrt(order == 0 ? scale : 2.0 * scale);
      int centre = degree * (degree + 1);
      weights[centre - order] = scale * turn.y;
      weights[centre + order] = scale * turn.x;
    }
    first *= float(2 * order + 1);
    turn = vec2(turn.x * direction.x - turn.y * direction.y, turn.y * direction.x + turn.x * direction.y);
  }
  return weights;
}
