/** One map of a material on the graphics card: its codes decoded, in full size, and in ever smaller copies. */

/** Halves are rounded up: 5 texels become 3, 2, 1. */
export const sizeAt = ([height, width], level) => [height, width].map((side) => Math.ceil(side / 2 ** level));

/** How many levels a material has. */
export const levelsOf = (size) => Math.ceil(Math.log2(Math.max(...size))) + 1;

/** Texels of a texture whose levels, halves rounded down, hold those of a map, rounded up. */
const padded = (side) => 2 ** Math.ceil(Math.log2(side));

export const HEADER = `precision highp float;
precision highp int;
precision highp sampler2DArray;
precision highp usampler2DArray;
`;

const DECODE = (integer) => `${HEADER}
uniform highp ${integer ? "usampler2DArray" : "sampler2DArray"} codes;
uniform int first, count, transfer;
uniform float top;
uniform vec4 low, high;
uniform bool splits;
out vec4 value;

vec3 linear_of(vec3 code) {
  return mix(code / 12.92, pow((code + 0.055) / 1.055, vec3(2.4)), greaterThan(code, vec3(0.04045)));
}

const float PI = 3.14159265358979;
// As safe.glsl has it: the built-in ones may be off by 5e-4.
vec2 turn_of(float angle) {
  float quarter = floor(angle / (PI / 2.0) + 0.5), x = angle - quarter * (PI / 2.0), s = x * x;
  float sine = x * (1.0 - s / 6.0 * (1.0 - s / 20.0 * (1.0 - s / 42.0 * (1.0 - s / 72.0))));
  float cosine = 1.0 - s / 2.0 * (1.0 - s / 12.0 * (1.0 - s / 30.0 * (1.0 - s / 56.0 * (1.0 - s / 90.0))));
  int side = int(quarter - 4.0 * floor(quarter / 4.0));
  return side == 0 ? vec2(cosine, sine) : side == 1 ? vec2(-sine, cosine) : side == 2 ? vec2(-cosine, -sine) : vec2(sine, -cosine);
}

// Of a hue the cosine and the sine; +x where there is none (models/hue.py).
vec2 direction_of(vec3 code) {
  float most = max(max(code.r, code.g), code.b), least = min(min(code.r, code.g), code.b), chroma = most - least;
  if (chroma <= 1e-3 * most) return vec2(1.0, 0.0);
  float hue = most == code.r ? (code.g - code.b) / chroma : most == code.g ? 2.0 + (code.b - code.r) / chroma : 4.0 + (code.r - code.g) / chroma;
  return turn_of(hue * PI / 3.0);
}

void main() {
  ivec2 texel = ivec2(gl_FragCoord.xy);
  vec4 code = vec4(texelFetch(codes, ivec3(texel, first), 0));
  for (int layer = 1; layer < count; layer++) code[layer] = float(texelFetch(codes, ivec3(texel, first + layer), 0).r);
  code /= top;
  if (transfer == 1) code.rgb = linear_of(code.rgb);
  value = low + code * (high - low);
  if (transfer == 2) value = vec4(direction_of(code.rgb), 0.0, 0.0);
  if (splits) value = vec4(unpackHalf2x16(packHalf2x16(value.xx)).x, value.x - unpackHalf2x16(packHalf2x16(value.xx)).x, 0.0, 0.0);
}`;

/** A level from another: bilinear, its triangle as wide as what it shrinks by, as torch filters with antialiasing. */
const RESAMPLE = `${HEADER}
uniform highp sampler2DArray source;
uniform ivec2 from, to;
uniform int layer, directions;
uniform bool tiles, nearest, splits;
out vec4 value;

vec4 fetch(ivec2 texel) {
  return texelFetch(source, ivec3(tiles ? (texel + 4 * from) % from : clamp(texel, ivec2(0), from - 1), layer), 0);
}

void main() {
  vec2 scale = vec2(from) / vec2(to), centre = (floor(gl_FragCoord.xy) + 0.5) * scale, wide = max(scale, 1.0);
  vec4 middle = fetch(ivec2(centre));
  value = middle;
  if (nearest) return;
  ivec2 low = ivec2(floor(centre - wide + 0.5)), high = ivec2(floor(centre + wide + 0.5));
  if (!tiles) { low = max(low, ivec2(0)); high = min(high, from); }
  vec4 total = vec4(0.0);
  float weights = 0.0;
  for (int y = low.y; y < high.y; y++) {
    for (int x = low.x; x < high.x; x++) {
      vec2 share = max(1.0 - abs((vec2(x, y) - centre + 0.5) / wide), 0.0);
      weights += share.x * share.y;
      total += share.x * share.y * fetch(ivec2(x, y));
    }
  }
  value = total / weights;
  if (directions > 0) {
    vec3 used = vec3(1.0, 1.0, directions == 3 ? 1.0 : 0.0), direction = value.xyz * used;
    direction = length(direction) < 1e-3 ? middle.xyz * used : direction;
    value = vec4(direction / max(length(direction), 1e-30), 0.0);
  }
  if (splits) { float whole = value.x + value.y, most = unpackHalf2x16(packHalf2x16(vec2(whole))).x; value = vec4(most, whole - most, 0.0, 0.0); }
}`;

const ARRAYS = { u8: Uint8Array, u16: Uint16Array, f16: Uint16Array, f32: Float32Array };
const TRANSFERS = { linear: 0, srgb: 1, hue: 2 };

export class TexelMap {
  /**
   * @param {import("./gl.js").Context} context
   * @param {object} entry the description's, of this map
   * @param {ArrayBuffer} buffer its codes
   * @param {[number, number]} size height and width of the material; tables keep their own
   * @param {boolean} tiles
   */
  constructor(context, entry, buffer, size, tiles) {
    this.context = context;
    this.size = entry.per_texel ? size : [entry.height, entry.width];
    this.tiles = tiles;
    this.levels = entry.per_texel ? levelsOf(size) : 1;
    this.splits = entry.name === "height" && !context.caps.float;  // a half alone would show as steps
    this.shape(entry);
    const [height, width] = entry.per_texel ? this.size.map(padded) : this.size;
    this.texture = context.texture(width, height, this.channels, this.count, this.levels);
    this.update(entry, buffer);
  }

  /** How layers of the map lie in those of the texture: four of one channel share one. */
  shape(entry) {
    this.together = entry.channels === 1 ? 4 : 1;
    this.count = Math.ceil(entry.layers / this.together);
    const used = entry.transfer === "hue" ? 2 : entry.channels === 1 ? Math.min(entry.layers, 4) : entry.channels;
    this.channels = this.splits ? 2 : used === 3 ? 4 : used;
  }

  /** Whether other codes can be put into the same texture. */
  fits(entry) {
    const same = entry.per_texel || (entry.height === this.size[0] && entry.width === this.size[1]);
    return same && (entry.layers === this.entry.layers || entry.transfer === "hue" || this.entry.transfer === "hue");
  }

  /** Uploads other codes, of any size. */
  update(entry, buffer) {
    const { context, size } = this;
    const own = [entry.height, entry.width];
    const codes = this.upload(entry, buffer);
    const full = own[0] === size[0] && own[1] === size[1];
    const target = full ? this.texture : context.texture(own[1], own[0], this.channels, this.count);
    for (let layer = 0; layer < this.count; layer++) this.decode(entry, codes, target, layer);
    if (!full) {
      this.resample(entry, target, own, 0, entry.wraps ?? this.tiles);
      context.gl.deleteTexture(target);
    }
    context.gl.deleteTexture(codes);
    for (let level = 1; level < this.levels; level++) this.resample(entry, this.texture, sizeAt(size, level - 1), level, this.tiles);
    this.entry = entry;
  }

  upload(entry, buffer) {
    const { gl } = this.context;
    const { height, width, layers, channels, type } = entry;
    const values = new ARRAYS[type](buffer);
    if (values.length !== height * width * layers * channels) {
      throw new Error(`${entry.name}: ${values.length} codes came where the description says ${height} x ${width} x ${layers} x ${channels}.`);
    }
    const integer = type[0] === "u";
    const bits = type === "u8" ? "8UI" : type === "u16" ? "16UI" : type === "f16" ? "16F" : "32F";
    const suffix = integer ? "_INTEGER" : "";
    const format = gl[channels === 1 ? `RED${suffix}` : `${["RG", "RGB", "RGBA"][channels - 2]}${suffix}`];
    const kind = { u8: gl.UNSIGNED_BYTE, u16: gl.UNSIGNED_SHORT, f16: gl.HALF_FLOAT, f32: gl.FLOAT }[type];
    const codes = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, codes);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl[["R", "RG", "RGB", "RGBA"][channels - 1] + bits], width, height, layers, 0, format, kind, values);
    return codes;
  }

  decode(entry, codes, target, layer) {
    const { context, together } = this;
    const { gl } = context;
    const integer = entry.type[0] === "u";
    const first = layer * together;
    const count = Math.min(together, entry.layers - first);
    const span = entry.low.slice(first * entry.channels, (first + count) * entry.channels);
    const most = entry.high.slice(first * entry.channels, (first + count) * entry.channels);
    const coded = integer && span.length > 0;
    context.pass(DECODE(integer), [{ texture: target, layer }], [entry.width, entry.height], (made) => {
      context.sample(made, "codes", codes, 0);
      gl.uniform1i(made.at("first"), first);
      gl.uniform1i(made.at("count"), count);
      gl.uniform1i(made.at("transfer"), TRANSFERS[entry.transfer]);
      gl.uniform1f(made.at("top"), coded ? { u8: 255, u16: 65535 }[entry.type] : 1);
      gl.uniform4f(made.at("low"), ...[0, 1, 2, 3].map((channel) => (coded ? span[channel] ?? 0 : 0)));
      gl.uniform4f(made.at("high"), ...[0, 1, 2, 3].map((channel) => (coded ? most[channel] ?? 1 : 1)));
      gl.uniform1i(made.at("splits"), this.splits ? 1 : 0);
    });
  }

  /** Makes a level of the texture from the whole of another texture, or from its own level before. */
  resample(entry, source, from, level, tiles) {
    const { context } = this;
    const { gl } = context;
    const to = sizeAt(this.size, level);
    for (let layer = 0; layer < this.count; layer++) {
      context.pass(RESAMPLE, [{ texture: this.texture, layer, level }], [to[1], to[0]], (made) => {
        context.sample(made, "source", source, 0);
        if (level > 0) limit(gl, level - 1, level - 1);  // what is read must not be what is drawn
        gl.uniform2i(made.at("from"), from[1], from[0]);
        gl.uniform2i(made.at("to"), to[1], to[0]);
        gl.uniform1i(made.at("layer"), layer);
        gl.uniform1i(made.at("directions"), { normal: 3, rotation: 2 }[entry.name] ?? 0);
        for (const [name, on] of [["tiles", tiles], ["nearest", entry.index], ["splits", this.splits]]) gl.uniform1i(made.at(name), on ? 1 : 0);
      });
      if (level > 0) limit(gl, 0, this.levels - 1);
    }
  }

  dispose() {
    this.context.gl.deleteTexture(this.texture);
  }
}

function limit(gl, base, most) {
  gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_BASE_LEVEL, base);
  gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAX_LEVEL, most);
}
