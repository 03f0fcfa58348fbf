// Twin of colour.srgb_to_linear (IEC 61966-2-1), for codes from 0 on; above 1 the curve goes on.
vec3 srgb_to_linear(vec3 code) {
  vec3 curve = pow((code + 0.055) / 1.055, vec3(2.4));
  return mix(code / 12.92, curve, greaterThan(code, vec3(0.04045)));
}
