// Twins of sphere_geometry.py: where a surface point stands on a lit sphere.
#include "../frames.glsl"

const float SHORTENED = 0.995;  // filtering near the rim must not reach outside the disc
const float TURN_BEYOND = 0.75;
const float CLOSE = 3.4526698e-4;  // the root of float32's epsilon

// The angle between light and view, and the normal's x, y, z in the view's frame.
vec4 place_on_sphere(vec3 light, vec3 view) {
  vec3 w = cross(light, view);  // keeps digits that an arc cosine of nearly parallel directions loses
  float sine = sqrt(max(dot(w, w), 1e-36)), across = view.x * w.y - view.y * w.x, up = -w.z;
  float angle = arc_tangent(sine, dot(light, view));
  if (sine >= CLOSE) return vec4(angle, across / sine, up / sine, view.z);
  // Where both coincide the frame may turn about the view: X is put under the normal.
  vec2 frame = normalise(vec2(across, up));
  frame.x = frame == vec2(0.0) ? 1.0 : frame.x;
  return vec4(angle, frame * length(view.xy), view.z);
}

// The signed sine between the half vector and (n_x, 0, n_z), positive toward the light.
float sine_to_half(vec4 place) {
  vec2 h = turn_of(place.x / 2.0);
  return (place.y * h.x - place.w * h.y) * inversesqrt(max(place.w * place.w + place.y * place.y, 1e-24));
}

// x and y, shortened, of the normal turned about Y; at the rim where it turns away.
vec2 turned_on_sphere(vec4 place, float angle) {
  vec2 turn = turn_of(angle);
  float x = place.y * turn.x + place.w * turn.y;
  bool behind = place.w * turn.x - place.y * turn.y < 0.0;
  return vec2(x, place.z) * (behind ? SHORTENED * inversesqrt(max(place.z * place.z + x * x, 1e-12)) : SHORTENED);
}
