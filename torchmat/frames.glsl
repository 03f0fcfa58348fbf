// Twins of frames.py: directions and frames of the tangent space.
#include "safe.glsl"

vec3 half_vector(vec3 light, vec3 view) {
  return normalise(light + view);
}

// Columns tangent, bitangent and normal: the shortest rotation from +z to the normal.
mat3 tangent_frame(vec3 normal) {
  float shared_part = divide(1.0, 1.0 + normal.z);
  vec3 tangent = vec3(1.0 - normal.x * normal.x * shared_part, -normal.x * normal.y * shared_part, -normal.x);
  vec3 bitangent = vec3(-normal.x * normal.y * shared_part, 1.0 - normal.y * normal.y * shared_part, -normal.y);
  return mat3(tangent, bitangent, normal);
}

// The frame turned about its normal by a cosine and a sine.
mat3 turned_frame(mat3 frame, vec2 turn) {
  return mat3(turn.x * frame[0] + turn.y * frame[1], turn.x * frame[1] - turn.y * frame[0], frame[2]);
}

// From 0 to 2 pi; 0 at the pole.
float azimuth_of(vec2 direction) {
  if (max(abs(direction.x), abs(direction.y)) < TINY) return 0.0;
  float azimuth = arc_tangent(direction.y, direction.x);
  azimuth = azimuth < 0.0 ? azimuth + 2.0 * PI : azimuth;
  return azimuth >= 2.0 * PI ? 0.0 : azimuth;
}
