// What a relief's height says by itself, at each level: normals, the finer height that rays may follow, and its range.

import { padded, sizeAt } from "./maps.js";
import { doubled, filtered } from "./resample.js";

const LEAST_UP = Math.cos(84 * Math.PI / 180); // of a normal: what is steeper counts as that steep

/**
 * Unit normals of Sobel's slopes, to which those of a normal map are added (geometry/normals.py).
 * @param {Float32Array} height
 * @param {Float32Array|null} refinement normals
 * @returns {Float32Array} 3 a texel
 */
export function normalsOf(height, [rows, columns], tiles, refinement) {
  const found = new Float32Array(3 * rows * columns);
  const neighbour = (place, size) => (tiles ? (place + size) % size : Math.min(Math.max(place, 0), size - 1));
  const lefts = Int32Array.from({ length: columns }, (_, column) => neighbour(column - 1, columns));
  const rights = Int32Array.from({ length: columns }, (_, column) => neighbour(column + 1, columns));
  const scale = columns / 8;
  for (let row = 0, at = 0; row < rows; row += 1) {
    const above = neighbour(row - 1, rows) * columns;
    const here = row * columns;
    const below = neighbour(row + 1, rows) * columns;
    for (let column = 0; column < columns; column += 1, at += 3) {
      const left = lefts[column];
      const right = rights[column];
      // What one diagonal and the other rise by.
      const first = height[above + right] - height[below + left];
      const second = height[above + left] - height[below + right];
      let x = scale * (first - second + 2 * (height[here + right] - height[here + left]));
      let y = scale * (first + second + 2 * (height[above + column] - height[below + column]));
      if (refinement !== null) {
        const nx = refinement[at];
        const ny = refinement[at + 1];
        const nz = refinement[at + 2];
        const up = Math.max(nz, LEAST_UP * (Math.sqrt(nx * nx + ny * ny + nz * nz) || 1));
        x -= nx / up;
        y -= ny / up;
      }
      const shrink = 1 / Math.sqrt(x * x + y * y + 1);
      found[at] = -x * shrink;
      found[at + 1] = -y * shrink;
      found[at + 2] = shrink;
    }
  }
  return found;
}

function spanOf(values) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return [low, high];
}

/** What follows from the height of a material. `range` holds the least and the greatest height of each level, `textures` all else. */
export class Relief {
  /**
   * @param {import("./gl.js").Context} context
   * @param {object} description the material's
   * @param {Map<string, import("./maps.js").TexelMap>} maps the material's
   */
  constructor(context, { size, tiles, relief, derives_normal: derivesNormal }, maps) {
    Object.assign(this, { context, size, tiles, maps, derivesNormal, fine: relief === "fine" });
    this.count = maps.get("height").count;
    this.range = new Float32Array(2 * this.count);
    this.textures = new Map();
    const [height, width] = size.map(padded);
    if (derivesNormal) this.textures.set("map_normal", context.texture(width, height, 3, 1, this.count));
    // Two texels at least in every level, where one is as small as a level of the material gets.
    const side = 2 ** this.count;
    if (this.fine) this.textures.set("map_fine_height", context.texture(side, side, 1, 1, this.count, true));
    this.update();
  }

  /** Whether a change of that map changes what is kept here. */
  follows(name) {
    return name === "height" || (this.derivesNormal && name === "normal");
  }

  update() {
    const { context, tiles, textures } = this;
    for (let level = 0; level < this.count; level += 1) {
      const size = sizeAt(this.size, level);
      let height = this.maps.get("height").values[level];
      const refinement = this.maps.get("normal")?.values[level] ?? null;
      if (this.derivesNormal) context.upload(textures.get("map_normal"), [normalsOf(height, size, tiles, refinement)], size, 3, level);
      if (this.fine) {
        height = filtered(height, size, 1, doubled(size[0], tiles), doubled(size[1], tiles));
        context.upload(textures.get("map_fine_height"), [height], size.map((side) => 2 * side), 1, level);
      }
      this.range.set(spanOf(height), 2 * level);
    }
  }

  dispose() {
    for (const texture of this.textures.values()) this.context.gl.deleteTexture(texture);
  }
}
