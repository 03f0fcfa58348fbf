// Small pictures of maps, from their codes.

import { encoded } from "./scene.js";

const SIDE = 64;
const LARGEST = { u8: 255, u16: 65535 };

/** @param {number} code of a half float @returns {number} */
export function halfFloat(code) {
  const sign = code & 0x8000 ? -1 : 1;
  const [exponent, part] = [(code >> 10) & 31, code & 1023];
  if (exponent === 0) return sign * part * 2 ** -24;
  if (exponent === 31) return part ? NaN : sign * Infinity;
  return sign * (1 + part / 1024) * 2 ** (exponent - 15);
}

function reader(entry, buffer) {
  const array = { u8: Uint8Array, u16: Uint16Array, f16: Uint16Array, f32: Float32Array }[entry.type];
  const codes = new array(buffer);
  if (entry.type === "f16") return (at) => halfFloat(codes[at]);
  const largest = LARGEST[entry.type] ?? 1;
  return (at) => codes[at] / largest;
}

/**
 * Return a picture of a map's first layer: colours as they are seen, other maps from their least to their largest value.
 * @param {{type: string, colour: boolean, layers: number, channels: number, height: number, width: number, transfer: string}} entry
 * @param {ArrayBuffer} buffer its codes, [layer][row][column][channel]
 * @returns {HTMLCanvasElement}
 */
export function thumbnail(entry, buffer) {
  const { height, width, channels } = entry;
  const canvas = document.createElement("canvas");
  const scale = Math.min(1, SIDE / Math.max(height, width));
  canvas.width = Math.max(1, Math.round(width * scale));
  canvas.height = Math.max(1, Math.round(height * scale));
  const read = reader(entry, buffer);
  const planes = channels >= 3 ? [0, 1, 2] : [0, 0, 0];
  const values = new Float32Array(3 * canvas.width * canvas.height);
  for (let y = 0; y < canvas.height; y += 1) {
    for (let x = 0; x < canvas.width; x += 1) {
      const [row, column] = [Math.floor((y + 0.5) * height / canvas.height), Math.floor((x + 0.5) * width / canvas.width)];
      planes.forEach((plane, k) => {
        values[3 * (y * canvas.width + x) + k] = read((row * width + column) * channels + plane);
      });
    }
  }
  canvas.getContext("2d").putImageData(painted(entry, values, canvas), 0, 0);
  return canvas;
}

function painted(entry, values, { width, height }) {
  const colour = entry.colour;
  let [low, high] = [0, 1];
  if (!colour || entry.type.startsWith("f")) {
    const finite = values.filter(Number.isFinite);
    low = colour ? 0 : finite.reduce((one, other) => Math.min(one, other), Infinity);
    high = finite.reduce((one, other) => Math.max(one, other), colour ? 1 : -Infinity);
  }
  const pixels = new ImageData(width, height);
  for (let at = 0; at < width * height; at += 1) {
    for (let k = 0; k < 3; k += 1) {
      const share = high > low ? Math.min(1, Math.max(0, (values[3 * at + k] - low) / (high - low))) : 0.5;
      const shown = colour && entry.transfer !== "srgb" ? encoded(share) : share;
      pixels.data[4 * at + k] = 255 * shown;
    }
    pixels.data[4 * at + 3] = 255;
  }
  return pixels;
}
