// Newell's teapot, as torchmat/rendering/teapot.py has it: bodies of revolution by their profiles, handle and spout by
// one half; the other patches are these turned or mirrored.

// Four rows of [radius, its share of the inner control points, height], z up.
const PROFILES = [
  [[1.4, 0.784, 2.4], [1.3375, 0.749, 2.53125], [1.4375, 0.805, 2.53125], [1.5, 0.84, 2.4]],
  [[1.5, 0.84, 2.4], [1.75, 0.98, 1.875], [2.0, 1.12, 1.35], [2.0, 1.12, 0.9]],
  [[2.0, 1.12, 0.9], [2.0, 1.12, 0.45], [1.5, 0.84, 0.225], [1.5, 0.84, 0.15]],
  [[0.0, 0.0, 3.15], [0.8, 0.45, 3.15], [0.0, 0.0, 2.85], [0.2, 0.112, 2.7]],
  [[0.2, 0.112, 2.7], [0.4, 0.224, 2.55], [1.3, 0.728, 2.55], [1.3, 0.728, 2.4]],
  [[0.0, 0.0, 0.0], [1.425, 0.798, 0.0], [1.5, 0.84, 0.075], [1.5, 0.84, 0.15]],
];
const BOTTOM = 5; // its patches go round the other way, as it looks down

// Four rows of [x, z of the first column, x, z of the last, y of the two between].
const TUBES = [
  [[-1.6, 2.025, -1.5, 2.25, 0.3], [-2.3, 2.025, -2.5, 2.25, 0.3], [-2.7, 2.025, -3.0, 2.25, 0.3], [-2.7, 1.8, -3.0, 1.8, 0.3]],
  [[-2.7, 1.8, -3.0, 1.8, 0.3], [-2.7, 1.575, -3.0, 1.35, 0.3], [-2.5, 1.125, -2.65, 0.9375, 0.3], [-2.0, 0.9, -1.9, 0.6, 0.3]],
  [[1.7, 1.425, 1.7, 0.6, 0.66], [2.6, 1.425, 3.1, 0.825, 0.66], [2.3, 2.1, 2.4, 2.025, 0.25], [2.7, 2.4, 3.3, 2.4, 0.25]],
  [[2.7, 2.4, 3.3, 2.4, 0.25], [2.8, 2.475, 3.525, 2.49375, 0.25], [2.9, 2.475, 3.45, 2.5125, 0.15], [2.8, 2.4, 3.2, 2.4, 0.15]],
];

// What the surface fills, y up.
const LOW = [-3.0, 0.0, -2.0];
const HIGH = [3.4340751254711077, 3.15, 2.0];

/** Patches whose first row is a single point: of the knob and of the bottom. */
export const WITH_POLE = new Set([12, 13, 14, 15, 20, 21, 22, 23]);

function revolved(profile, clockwise) {
  const quarters = [profile.map(([radius, inner, height]) => [
    [radius, 0, height], [radius, inner, height], [inner, radius, height], [0, radius, height],
  ])];
  for (let turn = 1; turn < 4; turn += 1) {
    quarters.push(quarters[turn - 1].map((row) => row.map(([x, y, z]) => [-y, x, z])));
  }
  return clockwise ? quarters.map((patch) => patch.map((row) => row.map(([x, y, z]) => [x, -y, z]))) : quarters;
}

function halves(rows) {
  const near = rows.map(([x0, z0, x1, z1, y]) => [[x0, 0, z0], [x0, -y, z0], [x1, -y, z1], [x1, 0, z1]]);
  const far = near.map((row) => row.slice().reverse().map(([x, y, z]) => [x, -y, z]));
  return [near, far];
}

/** @returns {number[][][][]} control points [32][row][column][xyz], z up. */
export function controlPoints() {
  return [
    ...PROFILES.flatMap((profile, number) => revolved(profile, number !== BOTTOM)),
    ...TUBES.flatMap(halves),
  ];
}

function bernstein(t) {
  const back = 1 - t;
  const inner = 3 * back * (back - 2 * t);
  const mirrored = 3 * t * (t - 2 * back);
  return {
    weight: [back ** 3, 3 * t * back * back, 3 * back * t * t, t ** 3],
    slope: [-3 * back * back, inner, -mirrored, 3 * t * t],
  };
}

const DIMENSIONS = [0, 1, 2];

const summed = (w, a, b, c, d) => DIMENSIONS.map((k) => w[0] * a[k] + w[1] * b[k] + w[2] * c[k] + w[3] * d[k]);

/** The sums over columns of a patch's points, [row][xyz], for the weights of one place along them. */
const across = (points, weights) => points.map((row) => summed(weights, ...row));
const down = (rows, weights) => summed(weights, ...rows);

const unit = (v) => {
  const length = Math.hypot(v[0], v[1], v[2]);
  return [v[0] / length, v[1] / length, v[2] / length];
};
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const toScene = ([x, y, z]) => [x, z, -y];
const SCALE = 2 / (HIGH[0] - LOW[0]);
const MIDDLE = DIMENSIONS.map((k) => (LOW[k] + HIGH[k]) / 2);

/**
 * The vertices of one patch, row by row: v = 0 first, and u to the right seen from outside.
 * @param {number[][][]} points control points of the patch
 * @param {boolean} pole whether its first row is a single point
 * @param {number} segments steps along each side
 * @param {(position: number[], normal: number[], uv: number[], tangent: number[]) => void} add takes each vertex
 */
export function patchGrid(points, pole, segments, add) {
  const curve = Array.from({ length: segments + 1 }, (_, k) => bernstein(k / segments));
  // Rows and columns are read from the far end: so v rises on the body and u runs to the right.
  const columns = curve.map(({ weight, slope }) => [across(points, weight), across(points, slope)]).reverse();
  for (let row = segments; row >= 0; row -= 1) {
    const { weight, slope } = curve[row];
    const atPole = pole && row === 0;
    let before = null;
    columns.forEach(([values, slopes], step) => {
      // Where a row is a single point the direction along it has length 0; its limit is how it starts to grow.
      const along = down(slopes, atPole ? slope : weight);
      const place = toScene(atPole ? points[0][0] : down(values, weight));
      const own = toScene(unit([-along[0], -along[1], -along[2]]));
      let [tangent, u] = [own, step / segments];
      if (atPole && before) {
        // The one triangle of each column that meets a pole has its last corner there; it belongs in the column's middle.
        tangent = unit([own[0] + before[0], own[1] + before[1], own[2] + before[2]]);
        u -= 0.5 / segments;
      }
      before = own;
      const normal = toScene(unit(cross(along, down(values, slope))));
      add(DIMENSIONS.map((k) => (place[k] - MIDDLE[k]) * SCALE), normal, [u, 1 - row / segments], tangent);
    });
  }
}
