// Codes of a map, as textures hold them, to its values.

export const ARRAYS = { u8: Uint8Array, u16: Uint16Array, f16: Uint16Array, f32: Float32Array };
const CODES = { u8: 256, u16: 65536 };
let halves = null;

// The value of every code of a half float.
function halfFloats() {
  halves ??= Float32Array.from({ length: 65536 }, (_, code) => {
    const sign = code & 0x8000 ? -1 : 1;
    const [exponent, part] = [(code >> 10) & 31, code & 1023];
    if (exponent === 31) return part ? NaN : sign * Infinity;
    return exponent === 0 ? sign * part * 2 ** -24 : sign * (1 + part / 1024) * 2 ** (exponent - 15);
  });
  return halves;
}

/** @param {number} code 0 to 1, as sRGB encodes it @returns {number} linear */
export function linear(code) {
  return code > 0.04045 ? ((code + 0.055) / 1.055) ** 2.4 : code / 12.92;
}

/**
 * What each code of a channel, counted through all layers, stands for; floats of 32 bits stand for themselves.
 * @returns {Float32Array|null}
 */
export function tableOf({ type, transfer, low, high }, channel) {
  if (type === "f32") return null;
  if (type === "f16") return halfFloats();
  const count = CODES[type];
  if (!low.length) return Float32Array.from({ length: count }, (_, code) => code); // whole numbers
  const [least, most] = [low[channel], high[channel]];
  const share = transfer === "srgb" ? (code) => linear(code / (count - 1)) : (code) => code / (count - 1);
  return Float32Array.from({ length: count }, (_, code) => least + share(code) * (most - least));
}

/**
 * Return the values of a map as the graphics card has them: each layer of `together` layers of one channel each, or of one of several.
 * Throws an Error where codes are missing or too many.
 * @param {object} entry of the description
 * @param {ArrayBuffer} buffer its codes, [layer][row][column][channel]
 * @returns {{layers: Float32Array[], channels: number}} rows from the top, channels side by side
 */
export function decoded(entry, buffer) {
  const { name, height, width, layers, channels, type } = entry;
  const [texels, bytes] = [height * width, ARRAYS[type].BYTES_PER_ELEMENT];
  const wanted = texels * layers * channels * bytes;
  if (buffer.byteLength !== wanted) throw new Error(`${name} must have ${wanted} bytes of codes; ${buffer.byteLength} came. Save it again.`);
  const codes = new ARRAYS[type](buffer);
  if (entry.transfer === "hue") return { layers: [directions(codes, texels, CODES[type] - 1)], channels: 2 };
  const many = channels === 1 ? Math.min(4, layers) : channels;
  const found = Array.from({ length: Math.ceil((layers * channels) / many) }, () => new Float32Array(texels * many));
  for (let place = 0; place < layers * channels; place += 1) {
    const [layer, channel] = [Math.floor(place / channels), place % channels];
    const table = tableOf(entry, place);
    take(codes.subarray(layer * texels * channels + channel), channels, table, found[Math.floor(place / many)].subarray(place % many), many);
  }
  return { layers: found, channels: many };
}

// What every `step`-th code stands for, as every `stride`-th of what is found.
function take(codes, step, table, found, stride) {
  if (table) for (let from = 0, to = 0; to < found.length; from += step, to += stride) found[to] = table[codes[from]];
  else for (let from = 0, to = 0; to < found.length; from += step, to += stride) found[to] = codes[from];
}

// Cosine and sine of hues; +x where there is none (models/hue.py).
function directions(codes, texels, top) {
  const found = new Float32Array(2 * texels);
  for (let texel = 0; texel < texels; texel += 1) {
    const [r, g, b] = [codes[3 * texel] / top, codes[3 * texel + 1] / top, codes[3 * texel + 2] / top];
    const most = Math.max(r, g, b);
    const chroma = most - Math.min(r, g, b);
    let hue = 0;
    if (chroma > 1e-3 * most) hue = most === r ? (g - b) / chroma : most === g ? 2 + (b - r) / chroma : 4 + (r - g) / chroma;
    found[2 * texel] = Math.cos(hue * Math.PI / 3);
    found[2 * texel + 1] = Math.sin(hue * Math.PI / 3);
  }
  return found;
}
