// One map of a material on the graphics card, in full size and in ever smaller copies.

import { decoded } from "./codes.js";
import { resampled } from "./resample.js";

/** Halves are rounded up: 5 texels become 3, 2, 1. @returns {[number, number]} */
export const sizeAt = ([height, width], level) => [Math.ceil(height / 2 ** level), Math.ceil(width / 2 ** level)];

/** @returns {number} how many levels a material of that size has */
export const levelsOf = (size) => Math.ceil(Math.log2(Math.max(...size))) + 1;

/** @returns {number} texels of a texture whose levels, halves rounded down, have room for those of a map, rounded up */
export const padded = (side) => 2 ** Math.ceil(Math.log2(side));

/** A texture of a map; its codes are decoded here, for no pass over targets of 32 bits works on every phone. */
export class TexelMap {
  /**
   * @param {import("./gl.js").Context} context
   * @param {object} entry the description's, of this map
   * @param {ArrayBuffer} buffer its codes
   * @param {[number, number]} size height and width of the material; tables keep their own
   * @param {boolean} tiles
   * @param {{kept?: boolean, hidden?: boolean}} how kept: the first layer of every level stays at hand in `values`;
   *   hidden: no shader reads it, so it has no texture
   */
  constructor(context, entry, buffer, size, tiles, { kept = false, hidden = false } = {}) {
    this.context = context;
    this.size = entry.per_texel ? size : [entry.height, entry.width];
    this.tiles = tiles;
    this.kept = kept;
    this.hidden = hidden;
    this.texture = null;
    this.count = entry.per_texel ? levelsOf(size) : 1;
    this.fill(entry, buffer);
  }

  /** Takes other codes of the map, of any size. */
  fill(entry, buffer) {
    const { context, tiles } = this;
    let { layers, channels } = decoded(entry, buffer);
    let size = [entry.height, entry.width];
    if (!entry.per_texel) this.size = size;
    if (!this.hidden) this.make(channels, layers.length, entry);
    this.values = [];
    for (let level = 0; level < this.count; level += 1) {
      const [from, to] = [size, sizeAt(this.size, level)];
      const wraps = level === 0 ? entry.wraps ?? tiles : tiles;
      if (from[0] !== to[0] || from[1] !== to[1]) layers = layers.map((values) => resampled(entry, values, from, channels, to, wraps));
      if (this.texture) context.upload(this.texture, layers, to, channels, level);
      if (this.kept) this.values.push(layers[0]);
      size = to;
    }
  }

  make(channels, layers, entry) {
    const shape = [...this.size, channels, layers].join();
    if (shape === this.shape) return;
    this.dispose();
    const [height, width] = entry.per_texel ? this.size.map(padded) : this.size;
    // Halves would show as steps in a height.
    this.texture = this.context.texture(width, height, channels, layers, this.count, entry.name === "height");
    this.shape = shape;
  }

  dispose() {
    if (this.texture) this.context.gl.deleteTexture(this.texture);
  }
}
