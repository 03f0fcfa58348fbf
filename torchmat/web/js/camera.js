// Directions by angles, and the camera that looks at an object from one, as torchmat/rendering/camera.py has it.

const DEGREE = Math.PI / 180;
const MARGIN = 1.02; // a framed object's bounding sphere fills all but so much of the picture
const NEAREST = 0.05;
const FARTHEST = 8;

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const unit = (v) => {
  const length = Math.hypot(v[0], v[1], v[2]);
  return v.map((one) => one / length);
};

/**
 * Angles of a direction of the scene: theta from +z, toward the default camera; phi about z, from x toward y.
 * @typedef {{theta: number, phi: number}} Angles degrees: theta -180..180, phi 0..360
 */

/** @param {Angles} angles @returns {number[]} the unit direction x, y, z */
export function directionOf({ theta, phi }) {
  const sine = Math.sin(theta * DEGREE);
  return [sine * Math.cos(phi * DEGREE), sine * Math.sin(phi * DEGREE), Math.cos(theta * DEGREE)];
}

const wrapped = (value, turn) => ((value % turn) + turn) % turn;

/**
 * Return the angles of a direction; of the two pairs that name it, the one nearer to `before`.
 * @param {number[]} direction unit
 * @param {Angles} before
 * @returns {Angles}
 */
export function anglesOf(direction, before) {
  const flat = Math.hypot(direction[0], direction[1]);
  const theta = Math.atan2(flat, direction[2]) / DEGREE;
  const phi = flat > 1e-9 ? wrapped(Math.atan2(direction[1], direction[0]) / DEGREE, 360) : before.phi;
  const away = (one) => Math.abs(wrapped(one - before.phi + 180, 360) - 180);
  if (away(phi) <= away(phi + 180)) return { theta, phi };
  return { theta: -theta, phi: wrapped(phi + 180, 360) };
}

/** @param {Angles} angles @returns {Angles} the same within -180..180 and 0..360 */
export function normalised({ theta, phi }) {
  return {
    theta: Math.abs(theta) <= 180 ? theta : wrapped(theta + 180, 360) - 180,
    phi: phi >= 0 && phi <= 360 ? phi : wrapped(phi, 360),
  };
}

/**
 * Turn a direction as a drag does: round the vertical axis, and up or down.
 * @param {Angles} angles
 * @param {number} right degrees round y, toward +x
 * @param {number} up degrees
 * @returns {Angles}
 */
export function orbited(angles, right, up) {
  const [x, y, z] = directionOf(angles);
  const azimuth = Math.atan2(x, z) + right * DEGREE;
  const most = 89.9 * DEGREE;
  const height = Math.min(most, Math.max(-most, Math.asin(Math.max(-1, Math.min(1, y))) + up * DEGREE));
  return anglesOf([Math.cos(height) * Math.sin(azimuth), Math.sin(height), Math.cos(height) * Math.cos(azimuth)], angles);
}

/** A camera that frames a sphere from a direction. */
export class Camera {
  /** @param {Partial<{theta: number, phi: number, zoom: number, perspective: boolean, fieldOfView: number}>} given */
  constructor(given = {}) {
    this.theta = given.theta ?? 0;
    this.phi = given.phi ?? 0;
    this.zoom = given.zoom ?? 1; // 1 frames the object; above it is nearer
    this.perspective = given.perspective ?? false;
    this.fieldOfView = given.fieldOfView ?? 30; // degrees that the shorter side of the picture spans
  }

  /** @param {number} factor above 1 comes nearer */
  zoomBy(factor) {
    this.zoom = Math.min(FARTHEST, Math.max(NEAREST, this.zoom * factor));
  }

  /** @returns {number[][]} right, up and backward (toward the camera), unit */
  axes() {
    const back = directionOf(this);
    let right = cross([0, 1, 0], back);
    if (Math.hypot(...right) < 1e-6) {
      const axis = Math.abs(back[0]) < 0.9 ? [1, 0, 0] : [0, 0, 1];
      right = axis.map((one, k) => one - back[k] * dot(axis, back));
    }
    right = unit(right);
    return [right, cross(back, right), back];
  }

  /**
   * What a picture of `columns` x `rows` pixels of an object needs.
   * @param {{centre: number[], radius: number}} object
   * @param {number} columns
   * @param {number} rows
   * @returns {{projection: Float32Array, eye: number[], pixel: number[]}} a matrix by columns; the place (w 1) or the
   * direction (w 0) of the camera; how wide a pixel is: a + b * distance
   */
  look({ centre, radius }, columns, rows) {
    const [right, up, back] = this.axes();
    const shorter = Math.min(columns, rows);
    const [wide, high] = [columns / shorter, rows / shorter];
    const row = (axis, scale) => [axis[0] * scale, axis[1] * scale, axis[2] * scale, -dot(axis, centre) * scale];
    if (!this.perspective) {
      const half = MARGIN * radius / this.zoom;
      const depth = row(back, -1 / (1.1 * radius));
      const matrix = [row(right, 1 / (half * wide)), row(up, 1 / (half * high)), depth, [0, 0, 0, 1]];
      return { projection: byColumns(matrix), eye: [...back, 0], pixel: [2 * half / shorter, 0] };
    }
    const half = Math.tan(this.fieldOfView * DEGREE / 2);
    const distance = MARGIN * radius / Math.sin(this.fieldOfView * DEGREE / 2) / this.zoom;
    const [near, far] = [Math.max(distance - 1.1 * radius, 0.01 * radius), distance + 1.1 * radius];
    const away = row(back, -1); // the distance along the line of sight, less that of the centre
    away[3] += distance;
    const scale = (far + near) / (far - near);
    const depth = away.map((one, k) => one * scale - (k === 3 ? 2 * far * near / (far - near) : 0));
    const matrix = [row(right, 1 / (half * wide)), row(up, 1 / (half * high)), depth, away];
    return {
      projection: byColumns(matrix), eye: [...centre.map((one, k) => one + back[k] * distance), 1],
      pixel: [0, 2 * half / shorter],
    };
  }
}

function byColumns(rows) {
  return Float32Array.from({ length: 16 }, (_, k) => rows[k % 4][Math.floor(k / 4)]);
}
