// Twins of safe.py: what divides, scales and raises to powers without NaN.

const float TINY = 1.17549435e-38;
const float PI = 3.14159265358979;

float divide(float numerator, float denominator) {
  return abs(denominator) < TINY ? 0.0 : numerator / denominator;
}

float power(float base, float exponent) {
  if (base < TINY) return exponent == 0.0 ? 1.0 : 0.0;
  return exp(exponent * log(base));
}

// The largest component is divided out first, so that no square under- or overflows.
vec3 normalise(vec3 vector) {
  float largest = max(max(abs(vector.x), abs(vector.y)), abs(vector.z));
  if (largest < TINY) return vec3(0.0);
  vector /= largest;
  return vector / sqrt(dot(vector, vector));
}

vec2 normalise(vec2 vector) {
  return normalise(vec3(vector, 0.0)).xy;
}

// The built-in one may be off by 4096 units in the last place.
float arc_tangent(float y, float x) {
  float steep = max(abs(x), abs(y));
  if (steep < TINY) return 0.0;
  float t = min(abs(x), abs(y)) / steep;
  // Half the angle twice: the series is then of numbers below 0.2.
  float h = t / (1.0 + sqrt(1.0 + t * t));
  h = h / (1.0 + sqrt(1.0 + h * h));
  float s = h * h;
  float angle = 4.0 * h * (1.0 - s * (1.0 / 3.0 - s * (1.0 / 5.0 - s * (1.0 / 7.0 - s * (1.0 / 9.0 - s / 11.0)))));
  angle = abs(y) > abs(x) ? PI / 2.0 - angle : angle;
  angle = x < 0.0 ? PI - angle : angle;
  return y < 0.0 ? -angle : angle;
}

float arc_cosine(float x) {
  x = clamp(x, -1.0, 1.0);
  return arc_tangent(sqrt((1.0 - x) * (1.0 + x)), x);
}

// Cosine and sine of an angle; the built-in ones may be off by 5e-4.
vec2 turn_of(float angle) {
  float quarter = floor(angle / (PI / 2.0) + 0.5), x = angle - quarter * (PI / 2.0), s = x * x;
  float sine = x * (1.0 - s / 6.0 * (1.0 - s / 20.0 * (1.0 - s / 42.0 * (1.0 - s / 72.0))));
  float cosine = 1.0 - s / 2.0 * (1.0 - s / 12.0 * (1.0 - s / 30.0 * (1.0 - s / 56.0 * (1.0 - s / 90.0))));
  int side = int(quarter - 4.0 * floor(quarter / 4.0));
  return side == 0 ? vec2(cosine, sine) : side == 1 ? vec2(-sine, cosine) : side == 2 ? vec2(-cosine, -sine) : vec2(sine, -cosine);
}
