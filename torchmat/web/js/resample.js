// Pictures in another size, filtered as torch does: rows first, then columns.

const SHORTEST = 1e-3; // a shorter mean of unit vectors says nothing of the direction in between

/**
 * Which samples a filter takes for each new one, and how much of them; by fours, which is twice as fast as one by one.
 * @typedef {{count: number, places: Int32Array, weights: Float64Array}} Filter `count` of each for every new sample
 */

/**
 * A triangle as wide as what it shrinks by, as torch filters with antialiasing.
 * @param {boolean} tiles whether it goes on around the corner; else it is cut off at the border
 * @returns {Filter}
 */
export function triangle(from, to, tiles) {
  const scale = from / to;
  const wide = Math.max(scale, 1);
  const count = 4 * Math.ceil((Number.isInteger(wide) ? 2 * wide : 2 * wide + 1) / 4);
  const [places, weights] = [new Int32Array(to * count), new Float64Array(to * count)];
  for (let k = 0; k < to; k += 1) {
    const centre = (k + 0.5) * scale;
    const first = Math.floor(centre - wide + 0.5);
    let total = 0;
    for (let tap = 0; tap < count; tap += 1) {
      const place = first + tap;
      const inside = tiles || (place >= 0 && place < from);
      places[k * count + tap] = wrapped(place, from, tiles);
      weights[k * count + tap] = inside ? Math.max(0, 1 - Math.abs(place - centre + 0.5) / wide) : 0;
      total += weights[k * count + tap];
    }
    for (let tap = 0; tap < count; tap += 1) weights[k * count + tap] /= total;
  }
  return { count, places, weights };
}

/** Twice the samples, cubic between them: Catmull and Rom's, which keeps slopes (models/fine_relief.py). @returns {Filter} */
export function doubled(from, tiles) {
  const kernels = [[-6, 58, 222, -18].map((w) => w / 256), [-18, 222, 58, -6].map((w) => w / 256)];
  const [places, weights] = [new Int32Array(8 * from), new Float64Array(8 * from)];
  for (let k = 0; k < 2 * from; k += 1) {
    const first = Math.floor((k - 1) / 2) - 1;
    for (let tap = 0; tap < 4; tap += 1) {
      places[4 * k + tap] = wrapped(first + tap, from, tiles);
      weights[4 * k + tap] = kernels[k % 2][tap];
    }
  }
  return { count: 4, places, weights };
}

function wrapped(place, size, tiles) {
  return tiles ? ((place % size) + size) % size : Math.min(Math.max(place, 0), size - 1);
}

/**
 * @param {Float32Array} values [row][column][channel]
 * @param {[number, number]} size height and width
 * @param {Filter} down
 * @param {Filter} across
 * @returns {Float32Array}
 */
export function filtered(values, [height, width], channels, down, across) {
  const [rows, columns] = [down.places.length / down.count, across.places.length / across.count];
  const line = width * channels;
  const found = new Float32Array(rows * columns * channels);
  const sum = new Float64Array(line);
  const { count, places, weights } = down;
  for (let row = 0; row < rows; row += 1) {
    sum.fill(0);
    for (let tap = row * count; tap < (row + 1) * count; tap += 4) {
      addLines(sum, values, places.subarray(tap, tap + 4), weights.subarray(tap, tap + 4));
    }
    alongLine(sum, channels, across, found.subarray(row * columns * channels, (row + 1) * columns * channels));
  }
  return found;
}

function addLines(sum, values, [a, b, c, d], [p, q, r, s]) {
  const line = sum.length;
  for (let at = 0; at < line; at += 1) {
    sum[at] += p * values[a * line + at] + q * values[b * line + at] + r * values[c * line + at] + s * values[d * line + at];
  }
}

// Sums are of 64 bits: rounding would make a relief of a height that is the same everywhere.
function alongLine(line, channels, { count, places, weights }, found) {
  for (let at = 0, first = 0; at < found.length; first += count) {
    for (let channel = 0; channel < channels; channel += 1, at += 1) {
      let sum = 0;
      for (let tap = first; tap < first + count; tap += 4) {
        sum += weights[tap] * line[places[tap] * channels + channel] + weights[tap + 1] * line[places[tap + 1] * channels + channel]
          + weights[tap + 2] * line[places[tap + 2] * channels + channel] + weights[tap + 3] * line[places[tap + 3] * channels + channel];
      }
      found[at] = sum;
    }
  }
}

/** The nearest texel, which invents no value. */
export function nearest(values, [height, width], channels, [rows, columns]) {
  const found = new Float32Array(rows * columns * channels);
  for (let row = 0; row < rows; row += 1) {
    for (let column = 0; column < columns; column += 1) {
      const from = (Math.floor((row + 0.5) * height / rows) * width + Math.floor((column + 0.5) * width / columns)) * channels;
      found.set(values.subarray(from, from + channels), (row * columns + column) * channels);
    }
  }
  return found;
}

/**
 * A map in another size, as what it is: directions stay unit vectors, whole numbers take the nearest.
 * @param {{index: boolean, kind: string}} entry
 * @returns {Float32Array}
 */
export function resampled(entry, values, size, channels, to, tiles) {
  if (entry.index) return nearest(values, size, channels, to);
  const found = filtered(values, size, channels, triangle(size[0], to[0], tiles), triangle(size[1], to[1], tiles));
  if (entry.kind === "normal" || entry.kind === "rotation") unit(found, channels, () => nearest(values, size, channels, to));
  return found;
}

// Math.hypot would take ten times as long.
function unit(vectors, channels, instead) {
  let other = null;
  const length = (at) => {
    let sum = 0;
    for (let k = at; k < at + channels; k += 1) sum += vectors[k] * vectors[k];
    return Math.sqrt(sum);
  };
  for (let at = 0; at < vectors.length; at += channels) {
    let whole = length(at);
    if (whole < SHORTEST) {
      other ??= instead();
      for (let k = at; k < at + channels; k += 1) vectors[k] = other[k];
      whole = length(at) || 1;
    }
    for (let k = at; k < at + channels; k += 1) vectors[k] /= whole;
  }
}
