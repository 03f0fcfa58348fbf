// Triangles that show a material: the shapes of torchmat/rendering/shapes.py, or a mesh that the page holds.

import { WITH_POLE, controlPoints, patchGrid } from "./teapot.js";

/**
 * @typedef {object} Mesh
 * @property {string} name
 * @property {Float32Array} position three numbers a vertex
 * @property {Float32Array} normal three, unit
 * @property {Float32Array} uv two: u right, v up, one texture spans 0..1
 * @property {Float32Array} tangent four: along +u, and the handedness
 * @property {Uint32Array} faces three vertices a triangle
 * @property {number[]} centre of the bounding box
 * @property {number} radius of the sphere about the centre that holds all vertices
 */

/** Names of the shapes that need no data. */
export const SHAPES = ["quad", "cube", "sphere", "torus", "teapot"];

class Builder {
  constructor(vertices, quads) {
    this.position = new Float32Array(3 * vertices);
    this.normal = new Float32Array(3 * vertices);
    this.uv = new Float32Array(2 * vertices);
    this.tangent = new Float32Array(4 * vertices);
    this.faces = new Uint32Array(6 * quads);
    this.vertices = 0;
    this.corners = 0;
  }

  vertex(position, normal, uv, tangent) {
    const at = this.vertices;
    this.position.set(position, 3 * at);
    this.normal.set(normal, 3 * at);
    this.uv.set(uv, 2 * at);
    this.tangent.set(tangent, 4 * at);
    this.tangent[4 * at + 3] = 1;
    this.vertices += 1;
  }

  triangle(a, b, c) {
    this.faces.set([a, b, c], this.corners);
    this.corners += 3;
  }

  grid(rows, columns, closedTop = false, closedBottom = false) {
    const first = this.vertices - (rows + 1) * (columns + 1);
    for (let row = 0; row < rows; row += 1) {
      for (let column = 0; column < columns; column += 1) {
        const corner = first + row * (columns + 1) + column;
        if (!(closedBottom && row === 0)) this.triangle(corner, corner + 1, corner + columns + 2);
        if (!(closedTop && row === rows - 1)) this.triangle(corner, corner + columns + 2, corner + columns + 1);
      }
    }
  }

  mesh(name) {
    const { position, normal, uv, tangent } = this;
    return finished(name, { position, normal, uv, tangent, faces: this.faces.slice(0, this.corners) });
  }
}

function finished(name, parts) {
  const { position } = parts;
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let at = 0; at < position.length; at += 1) {
    const k = at % 3;
    if (position[at] < low[k]) low[k] = position[at];
    if (position[at] > high[k]) high[k] = position[at];
  }
  const centre = low.map((value, k) => (value + high[k]) / 2);
  let squared = 0;
  for (let at = 0; at < position.length; at += 3) {
    const [x, y, z] = [position[at] - centre[0], position[at + 1] - centre[1], position[at + 2] - centre[2]];
    squared = Math.max(squared, x * x + y * y + z * z);
  }
  return { name, ...parts, centre, radius: Math.sqrt(squared) };
}

function quad() {
  const built = new Builder(4, 1);
  for (const [u, v] of [[0, 0], [1, 0], [0, 1], [1, 1]]) built.vertex([u - 0.5, v - 0.5, 0], [0, 0, 1], [u, v], [1, 0, 0]);
  built.grid(1, 1);
  return built.mesh("quad");
}

function cube() {
  const built = new Builder(24, 6);
  // Tangent, bitangent and normal of +z, +x, -z, -x, +y, -y.
  const sides = [
    [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 0, -1], [0, 1, 0], [1, 0, 0]], [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
    [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
  ];
  for (const [tangent, bitangent, normal] of sides) {
    for (const [u, v] of [[0, 0], [1, 0], [0, 1], [1, 1]]) {
      const place = normal.map((one, k) => one / 2 + tangent[k] * (u - 0.5) + bitangent[k] * (v - 0.5));
      built.vertex(place, normal, [u, v], tangent);
    }
    built.grid(1, 1);
  }
  return built.mesh("cube");
}

// The last of a whole turn equals the first to the bit: the seam has no crack.
const turned = (step, steps) => [Math.cos((step % steps) / steps * 2 * Math.PI), Math.sin((step % steps) / steps * 2 * Math.PI)];

function sphere(segments = 256) {
  const rows = segments / 2;
  const built = new Builder((rows + 1) * (segments + 1), rows * segments);
  for (let row = 0; row <= rows; row += 1) {
    const latitude = (row / rows - 0.5) * Math.PI;
    const pole = row === 0 || row === rows;
    const ring = pole ? 0 : Math.cos(latitude);
    for (let column = 0; column <= segments; column += 1) {
      const [cosine, sine] = turned(column, segments);
      // A triangle that meets a pole has a corner of its own there, in the middle of its column.
      const u = 4 * column / segments + (row === 0 ? 2 / segments : row === rows ? -2 / segments : 0);
      const place = [ring * sine, Math.sin(latitude), ring * cosine];
      built.vertex(place, place, [u, 2 * row / rows], [Math.cos(u * Math.PI / 2), 0, -Math.sin(u * Math.PI / 2)]);
    }
  }
  built.grid(rows, segments, true, true);
  return built.mesh("sphere");
}

function torus(segments = 240) {
  const rows = segments / 3;
  const built = new Builder((rows + 1) * (segments + 1), rows * segments);
  for (let row = 0; row <= rows; row += 1) {
    const angle = 2 * Math.PI * ((row % rows) / rows - 0.5);
    const [out, up] = [Math.cos(angle), row % rows === 0 ? 0 : Math.sin(angle)];
    const ring = 0.75 + 0.25 * out;
    for (let column = 0; column <= segments; column += 1) {
      const [cosine, sine] = turned(column, segments);
      const place = [ring * sine, 0.25 * up, ring * cosine];
      built.vertex(place, [out * sine, up, out * cosine], [3 * column / segments, row / rows], [cosine, 0, -sine]);
    }
  }
  built.grid(rows, segments);
  return built.mesh("torus");
}

function teapot(segments = 32) {
  const patches = controlPoints();
  const built = new Builder(patches.length * (segments + 1) ** 2, patches.length * segments ** 2);
  const add = (...vertex) => built.vertex(...vertex);
  patches.forEach((points, number) => {
    const pole = WITH_POLE.has(number);
    patchGrid(points, pole, segments, add);
    built.grid(segments, segments, pole);
  });
  return built.mesh("teapot");
}

const MAKERS = { quad, cube, sphere, torus, teapot };
const made = new Map();

/**
 * Return a shape, made once.
 * @param {string} name one of SHAPES
 * @returns {Mesh}
 */
export function makeMesh(name) {
  if (!made.has(name)) made.set(name, MAKERS[name]());
  return made.get(name);
}

function octahedral(x, y) {
  const z = 1 - Math.abs(x) - Math.abs(y);
  const [a, b] = z >= 0 ? [x, y] : [(1 - Math.abs(y)) * (x < 0 ? -1 : 1), (1 - Math.abs(x)) * (y < 0 ? -1 : 1)];
  const length = Math.hypot(a, b, z);
  return [a / length, b / length, z / length];
}

/**
 * Return a mesh that the page holds, as torchmat/web/mesh_data.py packs it.
 * @param {{name: string, vertices: number, triangles: number, low: number[], high: number[]}} entry
 * @param {Record<string, ArrayBuffer>} buffers those of the page, the mesh's under "mesh:..."
 * @returns {Mesh}
 */
export function storedMesh(entry, buffers) {
  const codes = new Uint16Array(buffers["mesh:position"]);
  const [normals, tangents] = ["normal", "tangent"].map((part) => new Int16Array(buffers[`mesh:${part}`]));
  const hands = new Int8Array(buffers["mesh:handedness"]);
  const position = Float32Array.from(codes, (code, at) => entry.low[at % 3] + code / 65535 * (entry.high[at % 3] - entry.low[at % 3]));
  const normal = new Float32Array(3 * entry.vertices);
  const tangent = new Float32Array(4 * entry.vertices);
  for (let k = 0; k < entry.vertices; k += 1) {
    normal.set(octahedral(normals[2 * k] / 32767, normals[2 * k + 1] / 32767), 3 * k);
    tangent.set(octahedral(tangents[2 * k] / 32767, tangents[2 * k + 1] / 32767), 4 * k);
    tangent[4 * k + 3] = hands[k];
  }
  const uv = new Float32Array(buffers["mesh:uv"]);
  const faces = entry.vertices > 65536 ? new Uint32Array(buffers["mesh:faces"]) : Uint32Array.from(new Uint16Array(buffers["mesh:faces"]));
  return finished(entry.name, { position, normal, uv, tangent, faces });
}
