// Twins of analytic.py: pi f_r cos of a formula. `shape` holds its last numbers: widths or exponents as logarithms, then the axis.
#include "../frames.glsl"

const float LEAST_COSINE = 1e-12;

// The half vector, and its cosine to the light from a length: that does not cancel where both are nearly opposite.
vec4 half_and_cosine(vec3 light, vec3 view) {
  vec3 total = light + view, h = normalise(total);
  float cosine = dot(h, total) / 2.0;
  return vec4(h, cosine > 0.0 ? max(cosine, LEAST_COSINE) : cosine);
}

vec3 fresnel_of(vec3 reflectance, float cosine) {
  float apart = 1.0 - clamp(cosine, 0.0, 1.0), square = apart * apart;
  return reflectance + (1.0 - reflectance) * (square * square * apart);
}

vec2 along_axis(vec2 v, float axis) {
  vec2 turn = turn_of(axis);
  return vec2(v.x * turn.x + v.y * turn.y, v.y * turn.x - v.x * turn.y);
}

// exp(-|flat|^2 / up^2) / up^4, 0 where nothing of it is left.
float gaussian(vec2 flat_part, float up) {
  float square = dot(flat_part, flat_part), height = up * up;
  return square > 100.0 * height ? 0.0 : exp(-square / height) / (height * height);
}

vec3 lambert_lobe(vec3 diffuse, vec3 specular, vec3 shape, vec3 light, vec3 view) {
  return diffuse * light.z;
}

vec3 phong_lobe(vec3 diffuse, vec3 specular, vec3 shape, vec3 light, vec3 view) {
  float exponent = exp(shape.x), r_dot_l = light.z * view.z - light.x * view.x - light.y * view.y;
  return (diffuse + specular * ((exponent + 2.0) / 2.0 * power(r_dot_l, exponent))) * light.z;
}

vec3 blinn_lobe(vec3 diffuse, vec3 specular, vec3 shape, vec3 light, vec3 view) {
  float exponent = exp(shape.x);
  float scale = (exponent + 2.0) * (exponent + 4.0) / (8.0 * (exp(-exponent * (log(2.0) / 2.0)) + exponent));
  return (diffuse + specular * (scale * power(half_vector(light, view).z, exponent))) * light.z;
}

vec3 ashikhmin_shirley_lobe(vec3 diffuse, vec3 specular, vec3 shape, vec3 light, vec3 view) {
  vec2 widths = exp(shape.xy);
  vec4 h = half_and_cosine(light, view);
  vec2 turned = along_axis(h.xy, shape.z);
  float exponent = divide(dot(widths, turned * turned), dot(h.xy, h.xy));
  float scale = sqrt((widths.x + 1.0) * (widths.y + 1.0)) / (8.0 * PI);
  // (N.L) / (H.L max(N.L, N.V)) as two quotients: the product of the denominators underflows near the horizon.
  float share = light.z < view.z ? divide(light.z, view.z) : 1.0;
  float lobe = PI * scale * power(h.z, exponent) * divide(share, h.w);
  return diffuse * light.z + lobe * fresnel_of(specular, h.w);
}

vec3 ward_lobe(vec3 diffuse, vec3 specular, vec3 shape, vec3 light, vec3 view) {
  vec2 widths = exp(shape.xy);
  vec4 h = half_and_cosine(light, view);
  float spread = gaussian(along_axis(h.xy, shape.z) / widths, h.z) / (4.0 * widths.x * widths.y);
  return diffuse * light.z + specular * (divide(divide(light.z, h.w), h.w) * spread);
}

vec3 cook_torrance_lobe(vec3 diffuse, vec3 specular, vec3 shape, vec3 light, vec3 view) {
  float roughness = exp(shape.x);
  vec4 h = half_and_cosine(light, view);
  float facets = gaussian(h.xy / roughness, h.z) / (4.0 * roughness * roughness);
  // G / (N.V), divided through before it overflows.
  float lobe = min(divide(1.0, view.z), divide(2.0 * h.z, h.w) * min(divide(light.z, view.z), 1.0));
  return diffuse * light.z + fresnel_of(specular, h.w) * (facets * lobe);
}

// Twice (N.d) / G1.
float twice_smith(vec3 direction, vec2 widths, float axis) {
  vec2 wide = widths * along_axis(direction.xy, axis);
  return direction.z + sqrt(direction.z * direction.z + dot(wide, wide));
}

vec3 ggx_anisotropic_lobe(vec3 diffuse, vec3 specular, vec3 shape, vec3 light, vec3 view) {
  vec2 widths = exp(shape.xy);
  vec4 h = half_and_cosine(light, view);
  vec2 narrow = along_axis(h.xy, shape.z) / widths;
  float slope = dot(narrow, narrow) + h.z * h.z;
  float visible = divide(light.z, twice_smith(light, widths, shape.z)) / twice_smith(view, widths, shape.z);
  return diffuse * light.z + fresnel_of(specular, h.w) * (divide(1.0, slope * slope) * visible / (widths.x * widths.y));
}

vec3 ggx_lobe(vec3 diffuse, vec3 specular, vec3 shape, vec3 light, vec3 view) {
  return ggx_anisotropic_lobe(diffuse, specular, vec3(shape.xx, 0.0), light, view);
}
