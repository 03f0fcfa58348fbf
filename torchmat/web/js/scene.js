// A material on an object: one draw, each light shaded in the tangent frame of every pixel, as torchmat/rendering does.

import { MOST_IN_ALL, forShader } from "./lights.js";

const VERTEX = `#version 300 es
precision highp float;
in vec3 position; in vec3 normal; in vec2 uv; in vec4 tangent;
uniform mat4 projection; uniform vec3 origin;
out vec3 place; out vec3 across; out vec2 textured; out vec4 along;
void main() {
  place = position - origin; across = normal; textured = uv; along = tangent;
  gl_Position = projection * vec4(position, 1.0);
}`;

const HEAD = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D; precision highp sampler2DArray;
`;

const FRAGMENT = `
in vec3 place; in vec3 across; in vec2 textured; in vec4 along;
uniform vec4 eye; uniform vec2 pixel; uniform float texels; uniform float repeat; uniform float exposure; uniform float flattest;
uniform vec3 background; uniform int lightCount;
uniform vec4 lightPlace[${MOST_IN_ALL}]; uniform vec3 lightColour[${MOST_IN_ALL}];
out vec4 shown;

vec3 encoded(vec3 linear) {
  vec3 value = clamp(linear, 0.0, 1.0);
  return mix(12.92 * value, 1.055 * pow(max(value, 0.0031308), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, value));
}

mat3 frameOf() {
  vec3 normal = normalize(across);
  vec3 tangent = along.xyz - normal * dot(along.xyz, normal);
  // Between corners whose tangents are opposite there is none.
  tangent = dot(tangent, tangent) > 1e-12 ? normalize(tangent) : normalize(cross(normal, abs(normal.x) < 0.9 ? vec3(1, 0, 0) : vec3(0, 1, 0)));
  return mat3(tangent, cross(normal, tangent) * (along.w < 0.0 ? -1.0 : 1.0), normal);
}

// Which copy of the material has texels as wide as a pixel covers: textures along a length go by the areas on a triangle.
float levelOf(vec3 away, float facing) {
  vec3 right = dFdx(place), down = dFdy(place);
  vec2 uvRight = dFdx(textured), uvDown = dFdy(textured);
  float area = length(cross(right, down)), covered = abs(uvRight.x * uvDown.y - uvRight.y * uvDown.x);
  float perLength = area > 0.0 ? sqrt(covered / area) : 0.0;
  float width = pixel.x + pixel.y * length(away);
  return max(log2(max(width * perLength * repeat / max(facing, 0.05) * texels, 1e-30)), 0.0);
}

void main() {
  mat3 frame = frameOf();
  vec3 away = eye.xyz - eye.w * place;
  vec3 view = normalize(away) * frame;
  vec2 uv = textured * repeat;
  float level = levelOf(away, view.z);
  vec3 sum = vec3(0.0);
  for (int k = 0; k < lightCount; k += 1) {
    vec3 way = lightPlace[k].xyz - lightPlace[k].w * place;
    float squared = dot(way, way);
    vec3 light = squared > 0.0 ? (way * inversesqrt(squared)) * frame : vec3(0.0);
    if (light.z <= 0.0 || view.z <= 0.0) continue;
    // Models that stay bright up to the horizon end there in a hard arc: they fade over the last ten degrees.
    float fade = flattest > 0.0 ? min(light.z / flattest, 1.0) : 1.0;
    sum += shade(uv, level, light, view) * lightColour[k] * (fade / (lightPlace[k].w > 0.0 ? squared : 1.0));
  }
  float opaque = view.z > 0.0 ? cover(uv, level) : 1.0;
  shown = vec4(encoded(sum * exposure + background * (1.0 - opaque)), 1.0);
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
    this.gl = context.gl;
    this.material = material;
    this.mesh = null;
    this.samples = Math.min(4, this.gl.getParameter(this.gl.MAX_SAMPLES));
    this.drawn = 0;
  }

  /** @param {object} material of material.js; its shader is built when it is first drawn */
  setMaterial(material) {
    this.material = material;
  }

  /** @param {import("./meshes.js").Mesh} mesh */
  setMesh(mesh) {
    if (mesh === this.mesh) return;
    const { gl } = this;
    this.vertices?.buffers.forEach((buffer) => gl.deleteBuffer(buffer));
    if (this.vertices) gl.deleteVertexArray(this.vertices.array);
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

  /** @returns {WebGLProgram} that of the material's shader, built when that has changed */
  program() {
    const source = this.material.glsl;
    if (this.built?.source === source) return this.built;
    const { gl } = this;
    if (this.built) gl.deleteProgram(this.built.program);
    const program = gl.createProgram();
    const parts = [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, HEAD + withoutVersion(source) + FRAGMENT]];
    for (const [kind, text] of parts) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      gl.deleteShader(shader);
    }
    ATTRIBUTES.forEach(([name], place) => gl.bindAttribLocation(program, place, name));
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
      const said = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader)).join("\n");
      throw new Error(`The material's shader was refused: ${said || gl.getProgramInfoLog(program)}`);
    }
    const place = new Map();
    this.built = { source, program, at: (name) => place.get(name) ?? remember(place, name, gl.getUniformLocation(program, name)) };
    return this.built;
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
    const { program, at } = this.program();
    gl.useProgram(program);
    const { projection, eye, pixel } = view.camera.look(mesh, columns, rows);
    const lights = forShader(view.lights, view.environment, mesh);
    // Places count from the object's centre: far away from 0 they would have few digits left.
    const near = (place, k) => (k % 4 < 3 && lights.place[k - (k % 4) + 3] ? place - mesh.centre[k % 4] : place);
    gl.uniformMatrix4fv(at("projection"), false, projection);
    gl.uniform3fv(at("origin"), mesh.centre);
    gl.uniform4fv(at("eye"), eye.map((one, k) => (k < 3 && eye[3] ? one - mesh.centre[k] : one)));
    gl.uniform2fv(at("pixel"), pixel);
    gl.uniform1f(at("texels"), Math.max(...this.material.size));
    gl.uniform1f(at("repeat"), view.repeat);
    gl.uniform1f(at("exposure"), 2 ** view.exposure);
    gl.uniform1f(at("flattest"), view.soften ? FLATTEST : 0);
    gl.uniform3fv(at("background"), view.background);
    gl.uniform1i(at("lightCount"), lights.count);
    gl.uniform4fv(at("lightPlace"), lights.place.map(near));
    gl.uniform3fv(at("lightColour"), lights.colour);
    this.material.bind(program, 0);
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
    for (let row = 0; row < rows; row += 1) found.set(bottomUp.subarray(4 * columns * row, 4 * columns * (row + 1)), 4 * columns * (rows - 1 - row));
    return found;
  }
}

function remember(places, name, place) {
  places.set(name, place);
  return place;
}

function withoutVersion(source) {
  return source.replace(/^\s*#version[^\n]*\n/, "");
}

/** @param {number} value linear, 0 to 1 @returns {number} as sRGB encodes it */
export function encoded(value) {
  return value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055;
}
