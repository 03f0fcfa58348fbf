// WebGL2 as the other modules use it: a context that outlives its loss, programs, textures, and passes over all pixels of one.

/** Where pages can draw no material: show pictures instead. */
export class NoWebGL2 extends Error {}

const FORMATS = { 1: "R", 2: "RG", 3: "RGB", 4: "RGBA" };

const VERTEX = `#version 300 es
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);  // one triangle that covers all
  gl_Position = vec4(corner * 4.0 - 1.0, 0.0, 1.0);
}`;

/**
 * Opens a canvas; throws NoWebGL2 where that cannot be.
 * @param {HTMLCanvasElement | OffscreenCanvas} canvas
 * @param {{half?: boolean, [name: string]: any}} options `half` asks for targets of 16 bits, as some phones have; others are getContext's
 * @returns {Context}
 */
export function openContext(canvas, { half = false, ...attributes } = {}) {
  const gl = canvas.getContext("webgl2", attributes);
  if (!gl) throw new NoWebGL2("This browser has no WebGL2, or it is switched off.");
  return new Context(canvas, gl, half);
}

export class Context {
  constructor(canvas, gl, half) {
    this.canvas = canvas;
    this.gl = gl;
    this.lost = false;
    this.half = half;
    this.waiting = new Set();
    this.begin();
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();  // else it never comes back
      this.lost = true;
    });
    canvas.addEventListener("webglcontextrestored", () => {
      this.lost = false;
      this.begin();
      for (const restore of this.waiting) restore();
    });
  }

  /** What a new context, or one that came back, has. */
  begin() {
    const { gl } = this;
    const float = !this.half && gl.getExtension("EXT_color_buffer_float") !== null;
    const targets = float || gl.getExtension("EXT_color_buffer_half_float") !== null || gl.getExtension("EXT_color_buffer_float") !== null;
    this.caps = {
      float,
      targets,
      units: gl.getParameter(gl.MAX_TEXTURE_IMAGE_UNITS),
      size: gl.getParameter(gl.MAX_TEXTURE_SIZE),
      layers: gl.getParameter(gl.MAX_ARRAY_TEXTURE_LAYERS),
    };
    this.programs = new Map();
    this.empty = gl.createVertexArray();
    this.frame = gl.createFramebuffer();
  }

  /**
   * Calls `restore` whenever a lost context is back, in which all textures, buffers and programs are gone.
   * @returns {() => void} ends that
   */
  onRestore(restore) {
    this.waiting.add(restore);
    return () => this.waiting.delete(restore);
  }

  /**
   * The program of two sources, made when it is first asked for. Throws an Error with the compiler's words and the line that it means.
   * @returns {{program: WebGLProgram, at: (name: string) => WebGLUniformLocation | null}}
   */
  program(vertex, fragment) {
    const { gl } = this;
    const key = vertex + fragment;
    if (!this.programs.has(key)) {
      const program = gl.createProgram();
      const shaders = [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]].map(([kind, source]) => {
        const shader = gl.createShader(kind);
        gl.shaderSource(shader, source);
        gl.compileShader(shader);
        gl.attachShader(program, shader);
        return [shader, source];
      });
      gl.linkProgram(program);
      if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
        const said = shaders.map(([shader, source]) => explained(gl.getShaderInfoLog(shader) ?? "", source)).join("");
        throw new Error(`The shader does not compile: ${said || gl.getProgramInfoLog(program)}`);
      }
      for (const [shader] of shaders) gl.deleteShader(shader);
      const places = new Map();
      const at = (name) => {
        if (!places.has(name)) places.set(name, gl.getUniformLocation(program, name));
        return places.get(name);
      };
      this.programs.set(key, { program, at });
    }
    return this.programs.get(key);
  }

  /**
   * A texture of `layers` pictures of 1 to 4 channels for texelFetch; with 1, 2 or 4 channels a target too.
   * @param {number} levels of half the size each; more than one only for powers of two
   * @param {boolean} exact whether it has 32 bits even where targets have 16 at most: such a texture may be no target
   */
  texture(width, height, channels, layers = 1, levels = 1, exact = false) {
    const { gl, caps } = this;
    if (Math.max(width, height) > caps.size || layers > caps.layers) {
      const most = `${caps.size} x ${caps.size} texels and ${caps.layers} layers`;
      throw new Error(`The maps must fit this browser's ${most}; one is ${width} x ${height} with ${layers}. Make the material smaller.`);
    }
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, levels, gl[`${FORMATS[channels]}${caps.float || exact ? 32 : 16}F`], width, height, layers);
    for (const [name, how] of [
      [gl.TEXTURE_MIN_FILTER, levels > 1 ? gl.NEAREST_MIPMAP_NEAREST : gl.NEAREST], [gl.TEXTURE_MAG_FILTER, gl.NEAREST],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
    ]) gl.texParameteri(gl.TEXTURE_2D_ARRAY, name, how);
    return texture;
  }

  /** Puts values [row][column][channel] of each layer into a level of a texture, from its first texel on. */
  upload(texture, layers, [height, width], channels, level = 0) {
    const { gl } = this;
    const format = gl[channels === 1 ? "RED" : FORMATS[channels]];
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
    layers.forEach((values, layer) => {
      gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, level, 0, 0, layer, width, height, 1, format, gl.FLOAT, values);
    });
  }

  /**
   * Draws a fragment source over all pixels of targets, row 0 first.
   * @param {string} source after #version; its outputs in order are the targets
   * @param {WebGLTexture[]} targets of one size
   * @param {[number, number]} size width and height
   * @param {(program: {program: WebGLProgram, at: Function}) => void} set sets uniforms and textures
   */
  pass(source, targets, [width, height], set) {
    const { gl } = this;
    const made = this.program(VERTEX, `#version 300 es\n${source}`);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    targets.forEach((texture, index) => gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + index, texture, 0, 0));
    gl.drawBuffers(targets.map((_, index) => gl.COLOR_ATTACHMENT0 + index));
    for (const state of [gl.BLEND, gl.DEPTH_TEST, gl.CULL_FACE, gl.SCISSOR_TEST]) gl.disable(state);
    gl.viewport(0, 0, width, height);
    gl.useProgram(made.program);
    set(made);
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    targets.slice(1).forEach((_, index) => {
      gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT1 + index, null, 0, 0);
    });
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  /** Binds a texture of layers to a unit and to a sampler of the program in use. */
  sample(made, name, texture, unit) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
    gl.uniform1i(made.at(name), unit);
  }

  /** Reads a target back: 4 numbers a pixel, row 0 first. */
  read(texture, [width, height]) {
    const { gl } = this;
    const found = new Float32Array(width * height * 4);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, texture, 0, 0);
    gl.readBuffer(gl.COLOR_ATTACHMENT0);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, found);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return found;
  }
}

/** The compiler's words with the line of the source that they are about. */
function explained(log, source) {
  const lines = source.split("\n");
  return log.replace(/\0/g, "").replace(/^ERROR: \d+:(\d+):.*$/gm, (words, number) => `${words}\n    ${lines[number - 1]?.trim() ?? ""}`);
}
