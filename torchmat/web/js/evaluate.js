// A material's value at every texel under one light and view: the exact twin of Python's `material.shade`.

import { NoWebGL2 } from "./gl.js";

const UNIFORMS = `
uniform vec3 light, view;
out vec4 seen;
`;

const FLAT = `${UNIFORMS}
void main() {
  Place here = at_texel(ivec2(gl_FragCoord.xy));
  seen = vec4(shade_flat(here, light, view) * opacity_at(here), 1.0);
}`;

/** What texels send under all their light, and what they send in shadow as well; in the fast way the sum of both in their shadow. */
const SENT = `
uniform vec3 light, view;
layout(location = 0) out vec4 shaded;
layout(location = 1) out vec4 sent;
void main() {
  Place here = at_texel(ivec2(gl_FragCoord.xy));
  float opacity = opacity_at(here);
  shaded = vec4(shade_flat(here, light, view) * opacity, 1.0);
  sent = vec4(sent_at(here, light) * opacity, 1.0);
#ifndef FINE
  vec2 centre = (gl_FragCoord.xy) / vec2(SIZE);
  shaded.rgb = shaded.rgb * soft_shadow(vec2(centre.x, 1.0 - centre.y), 0, light) + sent.rgb;
#endif
}`;

/** By how much the light's rays clear the finer height. */
const FREE = `${UNIFORMS}
void main() {
  vec2 centre = gl_FragCoord.xy / vec2(2 * SIZE);
  seen = vec4(clearance(vec2(centre.x, 1.0 - centre.y), 0, light, -1e38));
}`;

/** How much of the light there is: an edge of a shadow is half a texel wide at least (models/fine_relief.py). */
const LIT = `
uniform highp sampler2DArray free;
out vec4 seen;
float free_at(ivec2 texel) {
  return texelFetch(free, ivec3(wrapped(texel, 2 * SIZE), 0), 0).r;
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  float across = free_at(at + ivec2(1, 0)) - free_at(at - ivec2(1, 0)), down = free_at(at + ivec2(0, 1)) - free_at(at - ivec2(0, 1));
  seen = vec4(clamp(free_at(at) / max(0.25 * (abs(across) + abs(down)), SOFTNESS) + 0.5, 0.0, 1.0));
}`;

/** The mean of what four rays of a texel see, cubic between texels as torch is. */
const SEEN = `${UNIFORMS}
uniform highp sampler2DArray shaded, sent, lit;

vec4 weights_of(float t) {
  const float a = -0.75;
  vec4 x = vec4(1.0 + t, t, 1.0 - t, 2.0 - t);
  vec4 inner = ((a + 2.0) * x - (a + 3.0)) * x * x + 1.0, outer = ((x - 5.0) * x + 8.0) * x * a - 4.0 * a;
  return vec4(outer.x, inner.y, inner.z, outer.w);
}

vec3 cubic(highp sampler2DArray picture, vec2 uv) {
  vec2 texel = texels_of(uv, SIZE), below = floor(texel);
  vec4 across = weights_of(texel.x - below.x), down = weights_of(texel.y - below.y);
  vec3 total = vec3(0.0);
  for (int y = 0; y < 4; y++) {
    for (int x = 0; x < 4; x++) {
      total += across[x] * down[y] * texelFetch(picture, ivec3(wrapped(ivec2(below) + ivec2(x, y) - 1, SIZE), 0), 0).rgb;
    }
  }
  return total;
}

void main() {
  vec3 total = vec3(0.0);
  for (int ray = 0; ray < 4; ray++) {
    vec2 offset = (vec2(ray & 1, ray >> 1) - 0.5) / 2.0 / vec2(SIZE);
    vec2 start = vec2(gl_FragCoord.x / float(SIZE.x), 1.0 - gl_FragCoord.y / float(SIZE.y)) + offset;
    vec2 end = trace_view(start, 0, view);
#ifdef FINE
    total += cubic(shaded, end - offset) * read(lit, around(end, 2 * SIZE, 0), 0).r + cubic(sent, end - offset);
#else
    total += cubic(shaded, end - offset);
#endif
  }
  seen = vec4(max(total / 4.0, 0.0), 1.0);
}`;

/**
 * Returns the values, linear, 4 numbers a texel, rows from the top; 0 where light or view is not above the horizon.
 * @param {import("./gl.js").Context} context
 * @param {import("./material.js").Material} material
 * @param {[number, number, number]} light a unit vector in the plane's frame
 * @param {[number, number, number]} view
 * @returns {Float32Array}
 */
export function evaluate(context, material, light, view) {
  if (!context.caps.targets) throw new NoWebGL2("This browser's WebGL2 has no floating-point targets: what it draws has no numbers to read.");
  const [height, width] = material.description.size;
  const size = [width, height];
  if (!(light[2] > 0 && view[2] > 0)) return new Float32Array(4 * width * height);
  const kept = [];
  const target = (scale = 1) => {
    const texture = context.texture(scale * width, scale * height, 4);
    kept.push(texture);
    return texture;
  };
  const draw = (source, targets, inputs = {}, scale = 1) => {
    context.pass(`${material.glsl}\n${source}`, targets, size.map((side) => scale * side), (made) => {
      let unit = material.bind(made);
      context.gl.uniform3fv(made.at("light"), light);
      context.gl.uniform3fv(made.at("view"), view);
      for (const [name, texture] of Object.entries(inputs)) context.sample(made, name, texture, unit++);
    });
  };
  const seen = target();
  if (!material.relief) {
    draw(FLAT, [seen]);
  } else {
    const [shaded, sent] = [target(), target()];
    draw(SENT, [shaded, sent]);
    const inputs = { shaded, sent };
    if (material.relief.fine) {
      const free = target(2);
      inputs.lit = target(2);
      draw(FREE, [free], {}, 2);
      draw(LIT, [inputs.lit], { free }, 2);
    }
    draw(SEEN, [seen], inputs);
  }
  const found = context.read(seen, size);
  for (const texture of kept) context.gl.deleteTexture(texture);
  return found;
}
