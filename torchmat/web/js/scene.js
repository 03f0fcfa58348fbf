// A material on an object: one draw, each light shaded in the tangent frame of every pixel, as torchmat/rendering does.

import { MOST_IN_ALL, forShader } from "./lights.js";

// Names begin with "scene_" apart from those that a material's source may not know: it comes first in the same shader.
const VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 position; layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 uv; layout(location = 3) in vec4 tangent;
uniform mat4 scene_projection; uniform vec3 scene_origin;
out vec3 scene_place; out vec3 scene_normal; out vec2 scene_uv; out vec4 scene_tangent;
void main() {
  scene_place = position - scene_origin; scene_normal = normal; scene_uv = uv; scene_tangent = tangent;
  gl_Position = scene_projection * vec4(position, 1.0);
}`;

const FRAGMENT = `
in vec3 scene_place; in vec3 scene_normal; in vec2 scene_uv; in vec4 scene_tangent;
uniform vec4 scene_eye; uniform vec2 scene_pixel; uniform float scene_texels, scene_repeat, scene_exposure, scene_flattest;
uniform vec3 scene_background; uniform int scene_lights;
uniform vec4 scene_light[${MOST_IN_ALL}]; uniform vec3 scene_shine[${MOST_IN_ALL}];
out vec4 scene_shown;

vec3 scene_encoded(vec3 linear) {
  vec3 value = clamp(linear, 0.0, 1.0);
  return mix(12.92 * value, 1.055 * pow(max(value, 0.0031308), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, value));
}

mat3 scene_frame() {
  vec3 normal = normalize(scene_normal);
  vec3 tangent = scene_tangent.xyz - normal * dot(scene_tangent.xyz, normal);
  // Between corners whose tangents are opposite there is none.
  vec3 other = cross(normal, abs(normal.x) < 0.9 ? vec3(1, 0, 0) : vec3(0, 1, 0));
  tangent = normalize(dot(tangent, tangent) > 1e-12 ? tangent : other);
  return mat3(tangent, cross(normal, tangent) * (scene_tangent.w < 0.0 ? -1.0 : 1.0), normal);
}

// Which copy of the material has texels as wide as a pixel covers: textures along a length go by the areas on a triangle.
float scene_level(vec3 away, float facing) {
  vec3 right = dFdx(scene_place), down = dFdy(scene_place);
  vec2 uvRight = dFdx(scene_uv), uvDown = dFdy(scene_uv);
  float area = length(cross(right, down)), covered = abs(uvRight.x * uvDown.y - uvRight.y * uvDown.x);
  float perLength = area > 0.0 ? sqrt(covered / area) : 0.0;
  float width = scene_pixel.x + scene_pixel.y * length(away);
  return max(log2(max(width * perLength * scene_repeat / max(facing, 0.05) * scene_texels, 1e-30)), 0.0);
}

vec3 scene_lit(int k, vec2 seen, int level, vec3 view, mat3 frame) {
  vec3 way = scene_light[k].xyz - scene_light[k].w * scene_place;
  float squared = dot(way, way);
  vec3 light = squared > 0.0 ? (way * inversesqrt(squared)) * frame : vec3(0.0);
  if (light.z <= 0.0) return vec3(0.0);
  // Models that stay bright up to the horizon end there in a hard arc: they fade over the last ten degrees.
  float fade = scene_flattest > 0.0 ? min(light.z / scene_flattest, 1.0) : 1.0;
  return shade_seen(seen, level, light, view) * scene_shine[k] * (fade / (scene_light[k].w > 0.0 ? squared : 1.0));
}

void main() {
  mat3 frame = scene_frame();
  vec3 away = scene_eye.xyz - scene_eye.w * scene_place;
  vec3 view = normalize(away) * frame;
  vec2 uv = scene_uv * scene_repeat;
  float level = scene_level(away, view.z);
  vec3 sum = vec3(0.0);
  if (view.z > 0.0) {
    // As the material's shade, but that what is seen through the relief is found once for all lights.
    float most = min(level, float(LEVELS - 1)), lower = floor(most);
    for (int upper = 0; upper < (most > lower ? 2 : 1); upper += 1) {
      int at = int(lower) + upper;
      vec2 seen = seen_at(placed(uv), at, view);
      float share = upper == 0 ? 1.0 - (most - lower) : most - lower;
      for (int k = 0; k < scene_lights; k += 1) sum += share * scene_lit(k, seen, at, view, frame);
    }
  }
  float opaque = view.z > 0.0 ? cover(uv, level) : 1.0;
  scene_shown = vec4(scene_encoded(sum * scene_exposure + scene_background * (1.0 - opaque)), 1.0);
}`;

const FLATTEST = Math.cos(80 * Math.PI / 180);
const ATTRIBUTES = [["position", 3], ["normal", 3], ["uv", 2], ["tangent", 4]];

/** Draws a Material on a mesh. */
export class Scene {
  /**
   * @param {{gl: WebGL2RenderingContext}} context of gl.js
   * @param {object} material of material.js
   */
  constructor(context, material) {
    this.context = context;
    this.gl = context.gl;
    this.material = material;
    this.mesh = null;
    this.forget = context.onRestore(() => this.restore());
    this.samples = Math.min(4, this.gl.getParameter(this.gl.MAX_SAMPLES));
    this.drawn = 0;
  }

  /** @param {object} material of material.js; its shader is built when it is first drawn */
  setMaterial(material) {
    this.material = material;
  }

  /** What a context that was lost had is made anew. */
  restore() {
    const { mesh } = this;
    Object.assign(this, { vertices: null, many: null, mesh: null });
    if (mesh) this.setMesh(mesh);
  }

  /** @param {import("./meshes.js").Mesh} mesh */
  setMesh(mesh) {
    if (mesh === this.mesh) return;
    const { gl } = this;
    this.dropMesh();
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffers = ATTRIBUTES.map(([name, size], place) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, mesh[name], gl.STATIC_DRAW);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, gl.FLOAT, false, 0, 0);
      return buffer;
    });
    const faces = gl.createBuffer();
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, faces);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.faces, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    this.vertices = { array, buffers: [...buffers, faces] };
    this.mesh = mesh;
  }

  dropMesh() {
    this.vertices?.buffers.forEach((buffer) => this.gl.deleteBuffer(buffer));
    if (this.vertices) this.gl.deleteVertexArray(this.vertices.array);
    this.vertices = null;
  }

  dispose() {
    this.forget();
    this.dropMesh();
    this.dropSmooth();
  }

  /**
   * Draw a picture of `columns` x `rows` pixels into the canvas, or into a frame buffer.
   * @param {{camera: import("./camera.js").Camera, lights: import("./lights.js").Light[], environment: string,
   *   repeat: number, exposure: number, background: number[], soften: boolean}} view exposure in stops; background linear RGB
   * @param {number} columns
   * @param {number} rows
   * @param {WebGLFramebuffer|null} target
   */
  draw(view, columns, rows, target = null) {
    const { gl } = this;
    const many = target === null && this.samples > 1;
    gl.bindFramebuffer(gl.FRAMEBUFFER, many ? this.smooth(columns, rows) : target);
    gl.viewport(0, 0, columns, rows);
    const [r, g, b] = view.background.map(encoded);
    gl.clearColor(r, g, b, 1);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.drawObject(view, columns, rows);
    if (many) this.resolve(columns, rows);
    this.drawn += 1;
  }

  drawObject(view, columns, rows) {
    const { gl, mesh } = this;
    const made = this.context.program(VERTEX, `#version 300 es\n${this.material.glsl}${FRAGMENT}`);
    const at = (name) => made.at(`scene_${name}`);
    gl.useProgram(made.program);
    const { projection, eye, pixel } = view.camera.look(mesh, columns, rows);
    const { description } = this.material;
    const lights = forShader(view.lights, view.environment, mesh);
    // Places count from the object's centre: far away from 0 they would have few digits left.
    const near = (place, k) => (k % 4 < 3 && lights.place[k - (k % 4) + 3] ? place - mesh.centre[k % 4] : place);
    gl.uniformMatrix4fv(at("projection"), false, projection);
    gl.uniform3fv(at("origin"), mesh.centre);
    gl.uniform4fv(at("eye"), eye.map((one, k) => (k < 3 && eye[3] ? one - mesh.centre[k] : one)));
    gl.uniform2fv(at("pixel"), pixel);
    gl.uniform1f(at("texels"), Math.max(...(description.whole_size ?? description.size)));
    gl.uniform1f(at("repeat"), view.repeat);
    gl.uniform1f(at("exposure"), 2 ** view.exposure);
    gl.uniform1f(at("flattest"), view.soften ? FLATTEST : 0);
    gl.uniform3fv(at("background"), view.background);
    gl.uniform1i(at("lights"), lights.count);
    gl.uniform4fv(at("light[0]"), lights.place.map(near));
    gl.uniform3fv(at("shine[0]"), lights.colour);
    this.material.bind(made, 0);
    gl.bindVertexArray(this.vertices.array);
    gl.drawElements(gl.TRIANGLES, mesh.faces.length, gl.UNSIGNED_INT, 0);
    gl.bindVertexArray(null);
  }

  // Edges are smoothed in a frame buffer of several samples a pixel, made anew when the size changes.
  smooth(columns, rows) {
    const { gl, many } = this;
    if (many?.columns === columns && many.rows === rows) return many.frame;
    this.dropSmooth();
    const frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    const format = gl.getContextAttributes().alpha ? gl.RGBA8 : gl.RGB8; // a copy of samples asks for the very same
    const parts = [[format, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]].map(([kind, place]) => {
      const part = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, part);
      gl.renderbufferStorageMultisample(gl.RENDERBUFFER, this.samples, kind, columns, rows);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, part);
      return part;
    });
    this.many = { frame, parts, columns, rows };
    return frame;
  }

  resolve(columns, rows) {
    const { gl } = this;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.many.frame);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
    gl.blitFramebuffer(0, 0, columns, rows, 0, 0, columns, rows, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  dropSmooth() {
    if (!this.many) return;
    this.many.parts.forEach((part) => this.gl.deleteRenderbuffer(part));
    this.gl.deleteFramebuffer(this.many.frame);
    this.many = null;
  }

  /**
   * Draw into a frame buffer without smoothing and return what it holds.
   * @returns {Uint8Array} RGBA, rows from the top
   */
  picture(view, columns, rows) {
    const { gl } = this;
    const frame = gl.createFramebuffer();
    const [colour, depth] = [gl.createRenderbuffer(), gl.createRenderbuffer()];
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    for (const [part, format, place] of [[colour, gl.RGBA8, gl.COLOR_ATTACHMENT0], [depth, gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]]) {
      gl.bindRenderbuffer(gl.RENDERBUFFER, part);
      gl.renderbufferStorage(gl.RENDERBUFFER, format, columns, rows);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, part);
    }
    this.draw(view, columns, rows, frame);
    const bottomUp = new Uint8Array(4 * columns * rows);
    gl.readPixels(0, 0, columns, rows, gl.RGBA, gl.UNSIGNED_BYTE, bottomUp);
    gl.deleteFramebuffer(frame);
    [colour, depth].forEach((part) => gl.deleteRenderbuffer(part));
    const found = new Uint8Array(bottomUp.length);
    const line = 4 * columns;
    for (let row = 0; row < rows; row += 1) found.set(bottomUp.subarray(line * row, line * (row + 1)), line * (rows - 1 - row));
    return found;
  }
}

/** @param {number} value linear, 0 to 1 @returns {number} as sRGB encodes it */
export function encoded(value) {
  return value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055;
}
