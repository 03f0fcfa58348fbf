// Small pictures of maps, from their codes.

import { ARRAYS, tableOf } from "./codes.js";
import { encoded } from "./scene.js";

const SIDE = 64;
const MOST_ACROSS = 3; // layers side by side
const SAMPLES = 3; // along each side of a pixel, at most

/**
 * Return a picture of a map as one sees it in a paint program: colours encoded, normals as colours, rotations as hues, all else from
 * the map's least to its largest value; of several layers the first nine.
 * @param {object} entry of the description
 * @param {ArrayBuffer} buffer its codes
 * @param {number} side its longer side in pixels, at most
 * @returns {HTMLCanvasElement}
 */
export function thumbnail(entry, buffer, side = SIDE) {
  const { height, width, transfer, kind } = entry;
  const canvas = document.createElement("canvas");
  const layers = kind === "rotation" ? 1 : Math.min(entry.layers, MOST_ACROSS ** 2);
  const across = Math.ceil(Math.sqrt(layers));
  const scale = Math.min(1, side / across / Math.max(height, width));
  const columns = Math.max(1, Math.round(width * scale));
  const rows = height === 1 && width > 1 ? SIDE / 4 : Math.max(1, Math.round(height * scale)); // a curve is a strip
  canvas.width = across * columns;
  canvas.height = Math.ceil(layers / across) * rows;
  const pixels = new ImageData(canvas.width, canvas.height);
  const read = reader(entry, buffer);
  const shown = transfer === "hue" ? (at) => [0, 1, 2].map((channel) => read(0, channel, at)) : painter(entry, read);
  const downs = Array.from({ length: rows }, (_, y) => places(y, rows, height));
  const acrosses = Array.from({ length: columns }, (_, x) => places(x, columns, width));
  for (let layer = 0; layer < layers; layer += 1) {
    for (let y = 0; y < rows; y += 1) {
      for (let x = 0; x < columns; x += 1) {
        const colour = meanOf(downs[y], acrosses[x], (row, column) => shown(row * width + column, layer));
        const at = (Math.floor(layer / across) * rows + y) * canvas.width + (layer % across) * columns + x;
        pixels.data.set([...colour.map((one) => 255 * one + 0.5), 255], 4 * at);
      }
    }
  }
  canvas.getContext("2d").putImageData(pixels, 0, 0);
  return canvas;
}

// The value of a layer's channel at a texel; of hues the code itself, which is what one sees.
function reader(entry, buffer) {
  const { height, width, channels, transfer, type } = entry;
  const codes = new ARRAYS[type](buffer);
  const tables = Array.from({ length: entry.layers * channels }, (_, place) => (transfer === "hue" ? null : tableOf(entry, place)));
  const top = transfer === "hue" ? { u8: 255, u16: 65535 }[type] : 1;
  return (layer, channel, texel) => {
    const code = codes[(layer * height * width + texel) * channels + channel];
    return tables[layer * channels + channel]?.[code] ?? code / top;
  };
}

function painter({ channels, colour, kind, range: [low, high] }, read) {
  if (kind === "rotation") return (at) => hue(Math.atan2(read(1, 0, at), read(0, 0, at)));
  if (kind === "normal") return (at, layer) => [0, 1, 2].map((channel) => (read(layer, channel, at) + 1) / 2);
  const share = (value) => (high > low ? (value - low) / (high - low) : 0.5);
  const brightest = Math.max(1, high);
  const one = colour ? (value) => encoded(Math.min(Math.max(value / brightest, 0), 1)) : share;
  return (at, layer) => [0, 1, 2].map((channel) => one(read(layer, channels === 1 ? 0 : Math.min(channel, channels - 1), at)));
}

function hue(angle) {
  const turn = (angle / (2 * Math.PI) + 1) % 1;
  return [0, 2 / 3, 1 / 3].map((start) => Math.min(Math.max(Math.abs(((turn + start) % 1) * 6 - 3) - 1, 0), 1));
}

function places(pixel, pixels, texels) {
  const samples = Math.min(SAMPLES, Math.max(1, Math.ceil(texels / pixels)));
  return Array.from({ length: samples }, (_, k) => Math.floor((pixel + (k + 0.5) / samples) * texels / pixels));
}

function meanOf(rows, columns, shown) {
  const sum = [0, 0, 0];
  for (const row of rows) for (const column of columns) shown(row, column).forEach((one, k) => { sum[k] += one; });
  return sum.map((one) => one / (rows.length * columns.length));
}
