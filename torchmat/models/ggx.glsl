// Twins of ggx.py: GGX's distribution and Smith's masking.

const float LEAST_SQUARE = 1e-12;
const float SMOOTHEST = 1e-6;
const float GRAZING = 1e-4;

// squares: those of the roughness along and across.
float stretched(vec3 direction, float cosine, vec2 squares) {
  return sqrt(max(cosine * cosine + dot(direction.xy * direction.xy, squares), LEAST_SQUARE));
}

// 2 (N.L)(N.V) / G of height-correlated masking.
float smith_denominator(vec3 light, vec3 view, vec2 squares) {
  float n_dot_l = max(light.z, 0.0), n_dot_v = max(view.z, 0.0);
  return n_dot_l * stretched(view, n_dot_v, squares) + n_dot_v * stretched(light, n_dot_l, squares);
}

vec2 squared_alpha(vec2 roughness) {
  vec2 square = roughness * roughness;
  return square * square + SMOOTHEST;
}

float schlick_rise(float apart) {
  float square = apart * apart;
  return square * square * apart;
}

// 1, and less below the 2 % that any matter reflects.
float usual_f90(float mean_f0) {
  return min(50.0 * mean_f0, 1.0);
}

// pi D G / (4 (N.L)(N.V)) N.L of directions in the frame of the surface: the lobe without its Fresnel term.
float ggx_share(vec3 light, vec3 view, vec3 h, vec2 squares) {
  float n_dot_l = max(light.z, 0.0), n_dot_v = max(view.z, 0.0);
  // A direction below the horizon is masked as one as far above it.
  float denominator = n_dot_l * stretched(view, view.z, squares) + n_dot_v * stretched(light, light.z, squares);
  float slope = h.z * h.z + h.x * h.x / squares.x + h.y * h.y / squares.y;
  return n_dot_l / (slope * slope * sqrt(squares.x * squares.y) * (2.0 * denominator + 2.0 * GRAZING));
}
