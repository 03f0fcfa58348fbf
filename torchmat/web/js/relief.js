/** What a relief's height says by itself, for each level: normals, the finer height that rays may follow, and its range. */

import { HEADER, sizeAt } from "./maps.js";

const READ = `${HEADER}
uniform highp sampler2DArray height;
uniform ivec2 size;
uniform int level;
uniform bool tiles, half_only;

ivec2 wrapped(ivec2 texel) {
  return tiles ? (texel + 4 * size) % size : clamp(texel, ivec2(0), size - 1);
}

float height_at(ivec2 texel) {
  vec2 found = texelFetch(height, ivec3(wrapped(texel), 0), level).rg;
  return found.x + found.y;
}

// As the sum of two halves, where targets hold no more.
vec2 split(float whole) {
  float most = half_only ? unpackHalf2x16(packHalf2x16(vec2(whole))).x : whole;
  return vec2(most, whole - most);
}
`;

/** Normals of Sobel's slopes; a normal map refines them: slopes add up (geometry/normals.py). */
const NORMAL = `${READ}
uniform highp sampler2DArray refinement;
uniform bool refines;
out vec4 value;

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec2 slope = vec2(0.0);  // y runs up, rows run down
  for (int side = -1; side <= 1; side++) {
    float weight = side == 0 ? 2.0 : 1.0;
    slope.x += weight * (height_at(at + ivec2(1, side)) - height_at(at + ivec2(-1, side)));
    slope.y += weight * (height_at(at + ivec2(side, -1)) - height_at(at + ivec2(side, 1)));
  }
  slope *= float(size.x) / 8.0;
  if (refines) {
    vec3 normal = normalize(texelFetch(refinement, ivec3(at, 0), level).xyz);
    slope -= normal.xy / max(normal.z, 0.10452846);  // 84 degrees at most
  }
  value = vec4(normalize(vec3(-slope, 1.0)), 0.0);
}`;

/** Twice the texels, cubic between them: Catmull and Rom's, which keeps slopes (models/fine_relief.py). */
const FINE = `${READ}
out vec4 value;

vec4 cubic(float t) {
  return vec4(((-0.5 * t + 1.0) * t - 0.5) * t, (1.5 * t - 2.5) * t * t + 1.0, ((-1.5 * t + 2.0) * t + 0.5) * t, (0.5 * t - 0.5) * t * t);
}

void main() {
  vec2 place = (floor(gl_FragCoord.xy) + 0.5) / 2.0 - 0.5, below = floor(place);
  vec4 across = cubic(place.x - below.x), down = cubic(place.y - below.y);
  float total = 0.0, low = height_at(ivec2(below)), high = low;
  for (int y = 0; y < 4; y++) {
    for (int x = 0; x < 4; x++) {
      float here = height_at(ivec2(below) + ivec2(x, y) - 1);
      total += across[x] * down[y] * here;
      low = min(low, here);
      high = max(high, here);
    }
  }
  value = vec4(split(low == high ? low : total), 0.0, 0.0);  // rounding would make a relief of a plain
}`;

/** The least and the greatest of blocks of 16 x 16: of heights at first, then of what that gave. */
const RANGE = `${READ}
uniform bool first;
uniform int column;
out vec4 value;

void main() {
  ivec2 corner = 16 * (ivec2(gl_FragCoord.xy) - ivec2(column, 0)), end = min(corner + 16, size);
  float low = 1e38, high = -1e38;
  for (int y = corner.y; y < end.y; y++) {
    for (int x = corner.x; x < end.x; x++) {
      vec4 found = texelFetch(height, ivec3(x, y, 0), level);
      low = min(low, found.x + found.y);
      high = max(high, first ? found.x + found.y : found.z + found.w);
    }
  }
  value = vec4(split(low), split(high));
}`;

export class Relief {
  /**
   * @param {import("./gl.js").Context} context
   * @param {object} description the material's
   * @param {Map<string, import("./maps.js").TexelMap>} maps the material's
   */
  constructor(context, { size, tiles, relief, derives_normal: derivesNormal }, maps) {
    Object.assign(this, { context, size, tiles, maps, fine: relief === "fine", derivesNormal });
    const { levels } = maps.get("height");
    const [height, width] = size.map((side) => 2 ** Math.ceil(Math.log2(side)));
    this.levels = levels;
    this.range = context.texture(levels, 1, 4);
    this.normal = derivesNormal ? context.texture(width, height, 4, 1, levels) : null;
    this.fineHeight = this.fine ? context.texture(2 * width, 2 * height, context.caps.float ? 1 : 2, 1, levels) : null;
    this.update();
  }

  /** Whether a change of that map changes what is kept here. */
  follows(name) {
    return name === "height" || (this.derivesNormal && name === "normal");
  }

  update() {
    const { maps } = this;
    const { texture } = maps.get("height");
    for (let level = 0; level < this.levels; level++) {
      const size = sizeAt(this.size, level);
      if (this.normal) {
        const refinement = maps.get("normal")?.texture;
        this.pass(NORMAL, texture, { texture: this.normal, level }, size, level, size, (made) => {
          this.context.gl.uniform1i(made.at("refines"), refinement ? 1 : 0);
          this.context.sample(made, "refinement", refinement ?? texture, 1);
        });
      }
      const finer = size.map((side) => 2 * side);
      if (this.fineHeight) this.pass(FINE, texture, { texture: this.fineHeight, level }, size, level, finer);
      if (this.fineHeight) this.findRange(this.fineHeight, finer, level);
      else this.findRange(texture, size, level);
    }
  }

  findRange(texture, size, level) {
    const { context } = this;
    let [source, from, at] = [texture, size, level];
    for (let first = true; ; first = false) {
      const to = from.map((side) => Math.ceil(side / 16));
      const done = to[0] === 1 && to[1] === 1;
      const target = done ? this.range : context.texture(to[1], to[0], 4);
      const column = done ? level : 0;
      this.pass(RANGE, source, { texture: target }, from, at, to, (made) => {
        context.gl.uniform1i(made.at("first"), first ? 1 : 0);
        context.gl.uniform1i(made.at("column"), column);
      }, column);
      if (!first) context.gl.deleteTexture(source);
      if (done) return;
      [source, from, at] = [target, to, 0];
    }
  }

  pass(source, height, target, size, level, to, set = () => {}, column = 0) {
    const { context } = this;
    const { gl } = context;
    context.pass(source, [target], [to[1], to[0]], (made) => {
      context.sample(made, "height", height, 0);
      gl.uniform2i(made.at("size"), size[1], size[0]);
      gl.uniform1i(made.at("level"), level);
      gl.uniform1i(made.at("tiles"), this.tiles ? 1 : 0);
      gl.uniform1i(made.at("half_only"), context.caps.float ? 0 : 1);
      set(made);
    }, column);
  }

  dispose() {
    for (const texture of [this.range, this.normal, this.fineHeight]) this.context.gl.deleteTexture(texture);
  }
}
